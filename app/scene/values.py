"""What the values of a scene may be before any key is looked at: text on one line, numbers of 64 bits, few levels.

Python's own readers raise errors of their own for the rest, or none. `check_values` does not recurse.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from piezomat.meshes.names import breaking_character
from piezomat.scene.errors import SceneError, dotted, shown

MOST_LEVELS = 12  # a matrix of a material is on the fifth
TEXT = "text on one line, without control characters"
KINDS = "text, numbers, true, false, lists and tables"
LARGEST = 2**63  # TOML's integers


def check_values(data: Any, path: tuple[str | int, ...] = ()) -> None:
    """Raise SceneError for the first key or value that no scene can hold. `path`: that of `data` itself."""
    stack: list[tuple[tuple[str | int, ...], Any]] = [(path, data)]
    while stack:
        path, value = stack.pop()
        if len(path) > MOST_LEVELS:
            raise SceneError(dotted(path[:MOST_LEVELS]), f"values nested {MOST_LEVELS} deep or more", "TOML of a scene")
        if isinstance(value, dict):
            for key in value:
                broken = breaking_character(key) if isinstance(key, str) else "no text"
                if broken is not None:
                    raise SceneError(dotted(path), f"a key with {broken}: {shown(str(key))}", f"keys that are {TEXT}")
            stack += [((*path, key), item) for key, item in reversed(value.items())]
        elif isinstance(value, list):
            stack += [((*path, index), item) for index, item in reversed(list(enumerate(value)))]
        elif isinstance(value, str):
            broken = breaking_character(value)
            if broken is not None and (path != ("geometry", "file") or "\0" in value):
                raise SceneError(dotted(path), f"{shown(value)} with {broken}", TEXT)
        elif isinstance(value, int) and not -LARGEST <= value < LARGEST:
            raise SceneError(dotted(path), shown(value), "integers of 64 bits")
        elif value is not None and not isinstance(value, (bool, int, float)):
            raise SceneError(dotted(path), f"{value} ({type(value).__name__})", KINDS)


def plain(value: Any) -> Any:
    """Models, tuples, arrays and paths given in Python as a TOML file would give them."""
    if isinstance(value, BaseModel):
        return plain(value.model_dump(mode="json", exclude_none=True))
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    return str(value.absolute()) if isinstance(value, Path) else value
