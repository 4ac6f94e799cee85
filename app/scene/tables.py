"""What a scene may hold, as tables in Markdown: keys of the sections, shapes, units.

They are read off the JSON schema and the shapes themselves, so that a README that shows them cannot be out of date.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, get_args

from piezomat.meshes.shapes import Shape
from piezomat.scene.data import Shapes
from piezomat.scene.errors import shown
from piezomat.scene.json_schema import branches, describe, resolved
from piezomat.scene.scene import schema

# What is measured in which unit. They are one consistent set: no number needs a conversion factor.
UNITS = (
    ("length", "um", ""),
    ("area", "um2", ""),
    ("force", "uN", ""),
    ("stress, pressure, stiffness", "MPa", "= uN/um2"),
    ("potential", "V", ""),
    ("electric field", "V/um", "= MV/m"),
    ("charge", "pC", ""),
    ("capacitance", "pC/V", "= pF"),
    ("energy", "pJ", "= uN um = pC V"),
    ("permittivity", "pC/(V um)", "= 1e-6 F/m; vacuum: 8.854e-6"),
    ("piezoelectric stress constants", "pC/um2", "= C/m2"),
    ("charge density", "pC/um2", "= C/m2"),
    ("adhesion energy", "pJ/um2", "= J/m2"),
    ("time", "s", "of the computer: nothing depends on time"),
)
# Keys that make a shape three-dimensional where they are absent by default.
THIRD_DIMENSION = ("length", "depth", "width")


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', '/') for cell in line)} |" for line in lines)


def units_table() -> str:
    """Units by quantity."""
    return markdown(("quantity", "unit", "remark"), UNITS)


def keys_table() -> str:
    """The keys of each section but the geometry: allowed values, default, meaning with unit."""
    parts = []
    for title, node in _sections("", schema()):
        rows = [
            (f"`{name}`", describe(key, schema()), _default(name, node), key.get("description", ""))
            for name, key in node["properties"].items()
            if not list(_tables(name, key)) or name == "geometry"
        ]
        if rows:
            purpose = node.get("description", "").partition("\n")[0].partition("]: ")
            heading = f"**`{title}`** {purpose[2] or purpose[0]}" if title else "**At the top of the file**"
            parts.append(f"{heading}\n\n{markdown(('key', 'value', 'default', 'meaning'), rows)}")
    return "\n\n".join(parts)


def _sections(title: str, node: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Each table of the file with its title as TOML writes it, an outer one before those in it."""
    yield title, node
    for name, key in node["properties"].items():
        if name != "geometry":
            for inner, table in _tables(f"{title.strip('[]')}.{name}".strip("."), key):
                yield from _sections(inner, table)


def _tables(path: str, key: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """The tables with known keys that a key may hold, itself or by the name or number of an entry."""
    for branch in branches(key) or [key]:
        node = resolved(branch, schema())
        if "properties" in node:
            yield f"[{path}]", node
        elif node.get("type") == "array" and "properties" in resolved(node["items"], schema()):
            yield f"[[{path}]]", resolved(node["items"], schema())
        elif isinstance(node.get("additionalProperties"), dict):
            inner = resolved(node["additionalProperties"], schema())
            if "properties" in inner:
                yield f"[{path}.NAME]", inner


def _default(name: str, table: dict[str, Any]) -> str:
    if name in table.get("required", ()):
        return "required"
    default = table["properties"][name].get("default")
    return "" if default is None or default == {} else f"`{shown(default)}`"


def shapes_table() -> str:
    """The shapes: what each is, keys with defaults, bodies, facet groups."""
    rows = []
    for shape in get_args(get_args(Shapes)[0]):
        table = schema()["$defs"][shape.__name__]
        keys = [
            f"`{name}`{_given(_default(name, table))}: {key.get('description') or describe(key, schema())}"
            for name, key in table["properties"].items()
            if name != "shape"
        ]
        what = table["description"].partition("\n\n")[0].replace("\n", " ")
        rows.append((f"`{table['properties']['shape']['const']}`", what, "<br>".join(keys), *_bodies_and_groups(shape)))
    return markdown(
        ("`shape`", "what it is", "keys and defaults", "bodies, by default", "facet groups, by default"), rows
    )


def _given(default: str) -> str:
    return {"": "", "required": " (required)"}.get(default, f" = {default}")


def _bodies_and_groups(shape: type[Shape]) -> tuple[str, str]:
    """Names of bodies and facet groups of a shape with its defaults, and the groups that it has in 3D alone."""
    fields = shape.model_fields
    if any(field.is_required() for field in fields.values()):
        return "as in the file", "`surfaces`, `ends`"
    given = shape()
    names, groups = given.bodies(), _groups(given)
    bodies = ", ".join(f"`{name}`" for name in (names if len(names) < 3 else names[:1]))
    absent = [name for name in THIRD_DIMENSION if name in fields and fields[name].default is None]
    if given.dimension == 2 and absent:
        added = [name for name in _groups(shape(**{absent[0]: 1.0})) if name not in groups]
        groups[-1] += f"; 3D: {added[0]}"
        groups += added[1:]
    return bodies + ", ..." * (len(names) > 2), ", ".join(groups)


def _groups(shape: Shape) -> list[str]:
    """Facet groups in code, `<body>` for the name of each body."""
    names = []
    for group in shape.facet_groups():
        body = next((body for body in shape.bodies() if group.startswith(f"{body}_")), None)
        names.append(f"`{group}`" if body is None else f"`<body>{group.removeprefix(body)}`")
    return list(dict.fromkeys(names))
