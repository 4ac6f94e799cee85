"""The JSON schema of a scene file, read by paths of its data: what is allowed where, in words; which keys there are."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from piezomat.scene.errors import shown

Path = tuple[str | int, ...]


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
    return describe(node_at(path, data, schema), schema)


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


def all_keys(node: dict[str, Any], schema: dict[str, Any], path: Path = ()) -> Iterator[Path]:
    """The paths of all keys of the schema that lie in no list and under no name of the user's choice."""
    for name, inner in resolved(node, schema).get("properties", {}).items():
        yield (*path, name)
        for branch in branches(inner) or [inner]:
            yield from all_keys(branch, schema, (*path, name))


def node_at(path: Path, data: Any, schema: dict[str, Any]) -> dict[str, Any]:
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
