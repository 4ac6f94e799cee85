"""Scene files as TOML: finding one, reading it with overrides of the command line, writing it."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from piezomat.scene.errors import SceneError, dotted, named, near, shown

EXAMPLES = Path(__file__).parent.with_name("scenes")

# An override of one of these keys takes the place of the keys that exclude it.
RIVALS: dict[str, tuple[str, ...]] = {
    "normal_penalty": ("normal_penalty_factor",),
    "normal_penalty_factor": ("normal_penalty",),
    "electric_penalty": ("electric_penalty_factor",),
    "electric_penalty_factor": ("electric_penalty",),
    "energy": ("range",),
    "range": ("energy",),
    "stiffness": ("young", "poisson"),
    "young": ("stiffness",),
    "poisson": ("stiffness",),
    "potential": ("charge_density",),
    "charge_density": ("potential",),
}

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_PART = re.compile(r"""(?:^|\.)(?:(?P<bare>[A-Za-z0-9_-]+)|"(?P<quoted>[^"]*)")|\[(?P<index>\d+)\]""")


def examples() -> list[str]:
    """Names of the shipped examples."""
    return sorted(path.stem for path in EXAMPLES.glob("*.toml"))


def find(scene: str | Path) -> Path:
    """The file that SCENE means: a path, or the name of a shipped example. Raises SceneError for neither."""
    path = Path(scene)
    if path.is_file():
        return path
    shipped = EXAMPLES / f"{str(scene).removesuffix('.toml')}.toml"
    if path.parent == Path(".") and shipped.is_file():
        return shipped
    found = "a directory" if path.is_dir() else "no such file"
    known = examples()
    allowed = f"the path of a scene file or a shipped example: {named(known)}{near(path.stem, known)}"
    raise SceneError("", found, allowed).in_file(scene)


def read(path: Path, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """The tables of a scene file with the overrides KEY=VALUE in place, and paths in it made absolute.

    Raises SceneError for a file that cannot be read or is no TOML, and for an override that fits nowhere.
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SceneError("", f"a file that cannot be read ({error.strerror})", "a readable file") from None
    except UnicodeDecodeError as error:
        raise SceneError("", f"bytes that are no text ({error.reason})", "TOML in UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise SceneError("", f"text that is no TOML: {error}", "TOML") from None
    except RecursionError:
        raise SceneError("", "values nested too deeply", "TOML of a scene") from None
    for override in overrides:
        override_key(data, override)
    geometry = data.get("geometry")
    if isinstance(geometry, dict) and isinstance(geometry.get("file"), str):
        geometry["file"] = str(path.parent.absolute() / geometry["file"])
    return data


def override_key(data: dict[str, Any], override: str) -> None:
    """Put VALUE in place of the key's own, for an override KEY=VALUE: TOML, or a bare word as a string.

    The key is a dotted path with indices of lists, `boundaries.1.potential` or `boundaries[1].potential`.
    Missing tables are made; keys that exclude this one (a penalty and its factor, say) are taken out.
    """
    key, equals, text = (part.strip() for part in override.partition("="))
    parts = _parts(key)
    if not equals or not parts:
        raise SceneError("--set", shown(override), "KEY=VALUE, such as contact.method=node")
    table: Any = data
    for depth, part in enumerate(parts):
        if isinstance(table, list):
            if not isinstance(part, int) and not part.isdigit():
                raise SceneError(dotted(parts[:depth]), f'"{part}" in --set {override}', "an index of this list")
            parts[depth] = part = int(part)
            if part >= len(table):
                allowed = f"indices 0 to {len(table) - 1}" if table else "no index: the list is empty"
                raise SceneError(dotted(parts[: depth + 1]), "an index outside the list", allowed)
        elif not isinstance(table, dict) or isinstance(part, int):
            raise SceneError(dotted(parts[:depth]), f"{shown(table)} with --set {override}", "a value without keys")
        if depth == len(parts) - 1:
            table[part] = _value(text)
            for rival in RIVALS.get(part, ()) if isinstance(part, str) else ():
                table.pop(rival, None)
        else:
            table = table[part] if isinstance(table, list) else table.setdefault(part, {})


def _parts(key: str) -> list[str | int]:
    """The parts of a dotted path; none where it is no path."""
    parts: list[str | int] = []
    end = 0
    while match := _PART.match(key, end):
        end = match.end()
        index = match["index"]
        parts.append(int(index) if index is not None else match["bare"] or match["quoted"] or "")
    return parts if end == len(key) else []


def _value(text: str) -> Any:
    """The value of an override: what TOML reads, otherwise the text itself."""
    try:
        table = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    return table["value"] if len(table) == 1 else text


def to_toml(table: Mapping[str, Any], path: str = "") -> str:
    """TOML of nested tables, lists on one line; empty tables and None are left out."""
    lines, sections = [], []
    for key, value in table.items():
        name = key if _BARE.fullmatch(key) else _string(key)
        inner = f"{path}.{name}" if path else name
        if isinstance(value, Mapping):
            text = to_toml(value, inner)
            sections.append(f"\n[{inner}]\n{text}" if text and not text.startswith("\n") else text)
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            sections += [f"\n[[{inner}]]\n{to_toml(row, inner)}" for row in value]
        elif value is not None:
            lines.append(f"{name} = {_scalar(value)}\n")
    return "".join(lines + sections)


def _scalar(value: Any) -> str:
    """A value on one line."""
    if isinstance(value, list):
        return f"[{', '.join(map(_scalar, value))}]"
    if isinstance(value, str):
        return _string(value)
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _string(text: str) -> str:
    """A basic string: escapes as in JSON, and one more that TOML requires."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
