"""Scene files as TOML: finding one, reading it with overrides of the command line, writing it."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from piezomat.scene.errors import LONGEST, SceneError, dotted, named, near, shown
from piezomat.scene.values import check_values, plain

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

# Texts KEY=VALUE as on the command line, or values by key.
Overrides = Sequence[str] | Mapping[str, Any]

MOST_BYTES = 4_000_000  # of a scene file: 400,000 unknown keys take 6 s to refuse
MOST_PARTS = 32  # of a dotted key: tomllib takes 14 s for one of 20,000

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_DOTTED = re.compile(
    rf"""^[ \t]*\[{{0,2}}[ \t]*(?:(?:[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){{{MOST_PARTS}}}""", re.MULTILINE
)
_PART = re.compile(r"""(?:^|\.)(?:(?P<bare>[A-Za-z0-9_-]+)|"(?P<quoted>[^"]*)")|\[(?P<index>[0-9]+)\]""")


def examples() -> list[str]:
    """Names of the shipped examples."""
    return sorted(path.stem for path in EXAMPLES.glob("*.toml"))


def find(scene: str | Path) -> Path:
    """The file that SCENE means: a path, or the name of a shipped example. Raises SceneError for neither."""
    path = Path(scene)
    if is_file(path):
        return path
    shipped = EXAMPLES / f"{str(scene).removesuffix('.toml')}.toml"
    if path.parent == Path(".") and is_file(shipped):
        return shipped
    found = "a directory" if is_directory(path) and str(scene) else "no such file"
    known = examples()
    allowed = f"the path of a scene file or a shipped example: {named(known)}{near(path.stem, known)}"
    named_there = str(scene) and len(str(scene)) <= LONGEST
    raise SceneError("", found, allowed).in_file(scene if named_there else shown(str(scene)))


def is_file(path: Path) -> bool:
    """Whether there is a file of this name; False also for names that the system does not take."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def is_directory(path: Path) -> bool:
    """Whether there is a directory of this name; False also for names that the system does not take."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def read(path: Path, overrides: Overrides = ()) -> dict[str, Any]:
    """The tables of a scene file with the overrides in place, and paths in it made absolute.

    Raises SceneError for a file that cannot be read or is no TOML, and for an override that fits nowhere.
    """
    data = _tables(path)
    check_values(data)
    override(data, overrides)
    geometry = data.get("geometry")
    if isinstance(geometry, dict) and isinstance(geometry.get("file"), str):
        geometry["file"] = str(path.parent.absolute() / geometry["file"])
    return data


def _tables(path: Path) -> dict[str, Any]:
    """What the file holds. Raises SceneError."""
    try:
        size = path.stat().st_size
        if size > MOST_BYTES:
            raise SceneError("", f"a file of {size:,} bytes", f"a scene of at most {MOST_BYTES:,} bytes")
        text = path.read_text(encoding="utf-8-sig")  # editors of Windows write a byte-order mark
    except OSError as error:
        raise SceneError("", f"a file that cannot be read ({error.strerror})", "a readable file") from None
    except UnicodeDecodeError as error:
        raise SceneError("", f"bytes that are no text ({error.reason})", "TOML in UTF-8") from None
    deep = _DOTTED.search(text)
    if deep:
        line = text.count("\n", 0, deep.end()) + 1
        raise SceneError("", f"a key of {MOST_PARTS} parts or more in line {line}", "the keys of a scene")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SceneError("", f"text that is no TOML: {error}", "TOML") from None
    except RecursionError:
        raise SceneError("", "values nested too deeply", "TOML of a scene") from None
    except ValueError:
        raise SceneError("", "an integer of thousands of digits", "integers of 64 bits") from None


def override(data: dict[str, Any], overrides: Overrides) -> None:
    """Put values of keys in place of those in the tables of a scene: texts KEY=VALUE, or a dict of values by key.

    VALUE is TOML, or a bare word as a string. Raises SceneError.
    """
    if isinstance(overrides, Mapping):
        for key, value in overrides.items():
            value = plain(value)
            _put(data, str(key), value, f"{key} = {shown(value)}")
        return
    for text in overrides:
        key, equals, value = (part.strip() for part in text.partition("="))
        if not equals:
            raise SceneError("--set", shown(text), "KEY=VALUE, such as contact.method=node")
        _put(data, key, _value(key, value), f"--set {shown(text)}")


def _put(data: dict[str, Any], key: str, value: Any, given: str) -> None:
    """Put a value in place of the key's own; `given` says in an error what was to be put.

    The key is a dotted path with indices of lists, `boundaries.1.potential` or `boundaries[1].potential`.
    Missing tables are made; keys that exclude this one (a penalty and its factor, say) are taken out.
    """
    parts = _parts(key)
    if not parts or len(parts) > MOST_PARTS:
        where = "--set" if given.startswith("--set ") else "overrides"
        raise SceneError(where, given.removeprefix("--set "), "KEY=VALUE, such as contact.method=node")
    table: Any = data
    for depth, part in enumerate(parts):
        if isinstance(table, list):
            if not isinstance(part, int) and not re.fullmatch("[0-9]+", part):
                found = f"{shown(part)} in {given}"
                raise SceneError(dotted(parts[:depth]), found, "an index of this list")
            parts[depth] = part = _index(part)
            if part >= len(table):
                allowed = f"indices 0 to {len(table) - 1}" if table else "no index: the list is empty"
                raise SceneError(dotted(parts[: depth + 1]), "an index outside the list", allowed)
        elif not isinstance(table, dict) or isinstance(part, int):
            found = f"{shown(table)} with {given}"
            raise SceneError(dotted(parts[:depth]), found, "a value without keys")
        if depth == len(parts) - 1:
            check_values(value, tuple(parts))
            table[part] = value
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
        parts.append(_index(index) if index is not None else match["bare"] or match["quoted"] or "")
    return parts if end == len(key) else []


def _index(text: str | int) -> int:
    """An index of a list; one of ten digits or more is beyond any list, and Python does not read thousands of them."""
    return int(text) if isinstance(text, int) or len(text) < 10 else 10**9


def _value(key: str, text: str) -> Any:
    """The value of an override: what TOML reads, otherwise the text itself. SceneError: no scene holds such a value."""
    try:
        table = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    except RecursionError:
        raise SceneError(key[:LONGEST], "values nested too deeply", "TOML of a scene") from None
    except ValueError:
        raise SceneError(key[:LONGEST], "an integer of thousands of digits", "integers of 64 bits") from None
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
