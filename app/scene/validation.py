"""From an error of pydantic to a SceneError.

The allowed values are read off the JSON schema of the scene, so that message and schema cannot disagree.
"""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError

from piezomat.scene.errors import SceneError, dotted, named, near, shown
from piezomat.scene.json_schema import Path, all_keys, allowed_at, node_at, value_at


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


def data_path(loc: Path, data: Any) -> Path:
    """The part of a pydantic location that is a path in the data: names of union branches are dropped."""
    path: Path = ()
    for part in loc:
        if value_at((*path, part), data) is not None:
            path = (*path, part)
    return path


def _unknown_key(path: Path, data: Any, schema: dict[str, Any]) -> SceneError:
    """The error for an unknown key, with the nearest one of this table, else one of this name anywhere."""
    name = str(path[-1])
    known = list(node_at(path[:-1], data, schema).get("properties", {}))
    hint = near(name, known)
    if not hint:
        elsewhere = [dotted(other) for other in all_keys(schema, schema) if other[-1] == name]
        hint = f' (did you mean "{elsewhere[0]}"?)' if elsewhere else ""
    return SceneError(dotted(path), "an unknown key", f"{named(known)}{hint}")
