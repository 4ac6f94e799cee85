"""One line for every way in which a scene can be wrong: the key, what was found, what is allowed.

The allowed values are read off the JSON schema of the scene, so that message and schema cannot disagree.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterator, Sequence
from typing import Any

from pydantic import ValidationError

from piezomat.meshes.gmsh_io.model import MeshError

Path = tuple[str | int, ...]


class SceneError(ValueError):
    """A wrong scene: the full path of the key, what is there and what may be.

    A `found` that is no string is shown as TOML would write it. `file` is added by whoever read the file.
    """

    def __init__(self, key: str, found: Any, allowed: str) -> None:
        super().__init__(key, found, allowed)
        self.key = key
        self.found = found if isinstance(found, str) else shown(found)
        self.allowed = allowed
        self.file: str = ""

    def in_file(self, file: object) -> SceneError:
        """This error with the name of the file in front of its message, unless it names one already."""
        self.file = self.file or str(file)
        return self

    def __str__(self) -> str:
        parts = [part for part in (self.file, self.key) if part]
        message = ": ".join([*parts, f"found {self.found}; allowed: {self.allowed}"])
        return " ".join(message.split())


def shown(value: Any, width: int = 72) -> str:
    """The value as TOML would write it on one line, shortened in the middle to `width` characters."""
    if value is None:
        return "nothing"
    if isinstance(value, dict):
        text = "{ " + ", ".join(f"{key} = {shown(item)}" for key, item in value.items()) + " }"
    elif isinstance(value, (list, tuple)):
        text = "[" + ", ".join(shown(item) for item in value) + "]"
    elif isinstance(value, (str, bool)):
        text = json.dumps(value, ensure_ascii=False)
    else:
        text = str(value)
    return text if len(text) <= width else f"{text[: width - 25]} ... {text[-20:]}"


def dotted(path: Sequence[str | int]) -> str:
    """The path as it is written in messages: `boundaries[1].displacement`."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def named(names: Sequence[str]) -> str:
    """The names for a message, `a, b, c`; of very many the first ones."""
    more = f", ... ({len(names)} in all)" if len(names) > 30 else ""
    return ", ".join(names[:30]) + more if names else "none"


def near(name: object, known: Sequence[str]) -> str:
    """' (did you mean "x"?)' for the known name that is nearest, or nothing."""
    close = difflib.get_close_matches(str(name), list(known), n=1, cutoff=0.6)
    return f' (did you mean "{close[0]}"?)' if close else ""


def unknown_name(key: str, name: object, what: str, known: Sequence[str]) -> SceneError:
    """The error for a name that names none of the known things."""
    return SceneError(key, shown(name), f"{what}: {named(known)}{near(name, known)}")


def scene_error(error: ValidationError, data: Any, schema: dict[str, Any]) -> SceneError:
    """The error to report for `data` that failed: unknown keys first, since they explain missing ones."""
    details = error.errors(include_url=False)
    first = min(details, key=lambda detail: detail["type"] != "extra_forbidden")
    path = data_path(first["loc"], data)
    if first["type"] == "extra_forbidden":
        return _unknown_key(path, data, schema)
    if first["type"] == "missing":
        path = (*path, first["loc"][-1])
    if first["type"] == "finite_number":
        return SceneError(dotted(path), value_at(path, data), "a finite number")
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, SceneError):
        return SceneError(dotted((*path, cause.key)) if cause.key else dotted(path), cause.found, cause.allowed)
    found = value_at(path, data)
    if isinstance(cause, Exception):
        # A table's own check names the key in front of its words: "divisions: each row needs 2 numbers".
        key, colon, words = str(cause).partition(": ")
        if colon and isinstance(found, dict) and key in found:
            return SceneError(dotted((*path, key)), shown(found[key]), words)
        return SceneError(dotted(path), shown(found), str(cause))
    return SceneError(dotted(path), shown(found), allowed_at(path, data, schema) or first["msg"])


def mesh_error(error: MeshError) -> SceneError:
    """A MeshError as an error of the scene, under the key that is to blame."""
    words = {"geometry.file": "a file of the geometry that can be used", "out": "a file that can be written"}
    key = "--out" if error.key == "out" else error.key
    return SceneError(key, str(error), words.get(error.key, "dimensions and sizes that can be meshed"))


def data_path(loc: Path, data: Any) -> Path:
    """The part of a pydantic location that is a path in the data: names of union branches are dropped."""
    path: Path = ()
    for part in loc:
        if value_at((*path, part), data) is not None:
            path = (*path, part)
    return path


def value_at(path: Path, data: Any) -> Any:
    """The value at the path, None where there is none."""
    for part in path:
        try:
            data = data[part] if isinstance(data, (dict, list)) else None
        except (KeyError, IndexError, TypeError):
            return None
    return data


def allowed_at(path: Path, data: Any, schema: dict[str, Any]) -> str:
    """What the schema allows at the path, in words; empty where it says nothing."""
    return describe(_node(path, data, schema), schema)


def describe(node: dict[str, Any], schema: dict[str, Any]) -> str:
    """What a node of a JSON schema allows, in words."""
    node = resolved(node, schema)
    if "const" in node:
        return shown(node["const"])
    if "enum" in node:
        return " or ".join(shown(value) for value in node["enum"])
    described = [describe(branch, schema) for branch in branches(node) if branch.get("type") != "null"]
    choices = list(dict.fromkeys(described))
    if choices:
        enclosed = [f"({choice})" if ", " in choice else choice for choice in choices]
        return " or ".join(enclosed) if len(choices) > 1 else choices[0]
    kind = node.get("type")
    if kind in ("number", "integer"):
        word = "a number" if kind == "number" else "an integer"
        limits = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
        bounds = [f"{sign} {node[name]:g}" for name, sign in limits.items() if name in node]
        return f"{word} {' and '.join(bounds)}".strip()
    if kind == "array":
        fewest, most = node.get("minItems", 0), node.get("maxItems")
        count = f"{fewest}" if fewest == most else f"{fewest} to {most}" if most else f"{fewest} or more"
        return f"a list{f' of {count}' if fewest else ''}, each {describe(node.get('items', {}), schema)}"
    if kind == "object":
        return "a table"
    return {"string": "a string", "boolean": "true or false"}.get(kind or "", "")


def _unknown_key(path: Path, data: Any, schema: dict[str, Any]) -> SceneError:
    """The error for an unknown key, with the nearest one of this table, else one of this name anywhere."""
    name = str(path[-1])
    known = list(_node(path[:-1], data, schema).get("properties", {}))
    hint = near(name, known)
    if not hint:
        elsewhere = [dotted(other) for other in _all_keys(schema, schema) if other[-1] == name]
        hint = f' (did you mean "{elsewhere[0]}"?)' if elsewhere else ""
    return SceneError(dotted(path), "an unknown key", f"{named(known)}{hint}")


def _all_keys(node: dict[str, Any], schema: dict[str, Any], path: Path = ()) -> Iterator[Path]:
    """The paths of all keys of the schema that lie in no list and under no name of the user's choice."""
    for name, inner in resolved(node, schema).get("properties", {}).items():
        yield (*path, name)
        for branch in branches(inner) or [inner]:
            yield from _all_keys(branch, schema, (*path, name))


def _node(path: Path, data: Any, schema: dict[str, Any]) -> dict[str, Any]:
    """The node of the schema that describes the value at the path of the data."""
    node = _matching(schema, data, schema)
    for depth, part in enumerate(path, start=1):
        if isinstance(part, int):
            inner = node.get("items", {})
        else:
            inner = node.get("properties", {}).get(part, node.get("additionalProperties"))
        node = _matching(inner if isinstance(inner, dict) else {}, value_at(path[:depth], data), schema)
    return node


def _matching(node: dict[str, Any], data: Any, schema: dict[str, Any]) -> dict[str, Any]:
    """The node itself, or the branch of a choice that the data means: the most keys in common."""
    leaves = list(_leaves(node, schema))
    if isinstance(data, dict):
        tables = [leaf for leaf in leaves if leaf.get("type") == "object" and not _contradicts(leaf, data)]
        return max(
            tables,
            key=lambda leaf: len(data.keys() & leaf.get("properties", {})),
            default=resolved(node, schema),
        )
    lists = [leaf for leaf in leaves if leaf.get("type") == "array"]
    return lists[0] if isinstance(data, list) and len(lists) == 1 else resolved(node, schema)


def _contradicts(table: dict[str, Any], data: dict[str, Any]) -> bool:
    """Whether a constant of the table differs from the data."""
    return any("const" in node and data.get(key) != node["const"] for key, node in table.get("properties", {}).items())


def _leaves(node: dict[str, Any], schema: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The alternatives of a node, itself where it has none."""
    node = resolved(node, schema)
    choices = branches(node)
    if not choices:
        yield node
    for branch in choices:
        yield from _leaves(branch, schema)


def branches(node: dict[str, Any]) -> list[dict[str, Any]]:
    """The alternatives that a node names, none where it names none."""
    return node.get("anyOf") or node.get("oneOf") or []


def resolved(node: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any]:
    """The node with its reference followed."""
    reference = node.get("$ref")
    return schema["$defs"][reference.rsplit("/", 1)[-1]] if reference else node
