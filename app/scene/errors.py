"""SceneError, one line for a wrong scene: the key, what was found, what is allowed; and the words of such lines."""

from __future__ import annotations

import difflib
import json
from collections.abc import Sequence
from typing import Any

from piezomat.meshes.gmsh_io.model import MeshError

LONGEST = 100  # characters of a key in a message


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
        text = "{ " + ", ".join(f"{key} = {shown(item)}" for key, item in list(value.items())[:30]) + " }"
    elif isinstance(value, (list, tuple)):
        text = "[" + ", ".join(shown(item) for item in value[:60]) + "]"
    elif isinstance(value, (str, bool)):
        text = json.dumps(value, ensure_ascii=False)
    elif isinstance(value, int) and abs(value) >= 2**63:
        text = "an integer beyond 64 bits"
    else:
        text = str(value)
    return text if len(text) <= width else f"{text[: width - 25]} ... {text[-20:]}"


def dotted(path: Sequence[str | int]) -> str:
    """The path as it is written in messages: `boundaries[1].displacement`."""
    text = ""
    for part in path:
        name = part if isinstance(part, int) or len(part) <= LONGEST else f"{part[:LONGEST]}..."
        text += f"[{name}]" if isinstance(name, int) else f".{name}" if text else name
    return text


def named(names: Sequence[str]) -> str:
    """The names for a message, `a, b, c`; of very many the first ones."""
    more = f", ... ({len(names)} in all)" if len(names) > 30 else ""
    return ", ".join(names[:30]) + more if names else "none"


def near(name: object, known: Sequence[str]) -> str:
    """' (did you mean "x"?)' for the known name that is nearest, whatever its case, or nothing."""
    lower: dict[str, str] = {}
    for candidate in known:
        lower.setdefault(candidate.lower(), candidate)
    close = difflib.get_close_matches(str(name).lower(), list(lower), n=1, cutoff=0.6)
    return f' (did you mean "{lower[close[0]]}"?)' if close else ""


def unknown_name(key: str, name: object, what: str, known: Sequence[str]) -> SceneError:
    """The error for a name that names none of the known things."""
    return SceneError(key, shown(name), f"{what}: {named(known)}{near(name, known)}")


def mesh_error(error: MeshError) -> SceneError:
    """A MeshError as an error of the scene, under the key that is to blame."""
    words = {"geometry.file": "a file of the geometry that can be used", "out": "a file that can be written"}
    key = "--out" if error.key == "out" else error.key
    return SceneError(key, str(error), words.get(error.key, "dimensions and sizes that can be meshed"))
