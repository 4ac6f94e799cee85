"""Reader of gmsh's mesh files (MSH 2.2 and 4.1, text and binary) that raises an error for any damaged file.

gmsh itself ends the process on some of them. Format: gmsh reference manual, section "MSH file format".
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import gmsh
import numpy as np

from piezomat.forms.arrays import Array, Integers
from piezomat.meshes.gmsh_io.model import MeshError
from piezomat.meshes.names import breaking_character

VERSIONS = ("2.2", "4.1")
BINARY = {"i": "<i4", "z": "<u8", "d": "<f8"}


@dataclass(frozen=True)
class Block:
    """Elements (n, nodes) of one gmsh type in one entity, as tags of their nodes."""

    dim: int
    entity: int
    type: int
    nodes: Integers


@dataclass
class Contents:
    """Contents of a file: nodes, elements, physical groups of entities (dim, tag) and names of groups."""

    tags: Integers
    x: Array
    blocks: list[Block]
    groups: dict[tuple[int, int], list[int]] = field(default_factory=dict)
    names: dict[tuple[int, int], str] = field(default_factory=dict)


def read(path: Path) -> Contents:
    """Contents of a mesh file, checked to be complete. Raises MeshError."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise MeshError(error.strerror or str(error)) from None
    if not data:
        raise MeshError("the file is empty")
    sections = dict(_sections(data))
    version, binary = _format(sections.get("MeshFormat", b""))
    for name in ("Nodes", "Elements"):
        if name not in sections:
            raise MeshError(f"it has no section ${name}")
    contents = (_parse_2 if version == "2.2" else _parse_4)(sections, binary)
    contents.names |= _names(sections.get("PhysicalNames", b""))
    return contents


def _format(data: bytes) -> tuple[str, bool]:
    """Version of the format, and whether it is binary."""
    version, kind, size, one = (*data.split(maxsplit=3), b"", b"", b"", b"")[:4]
    said = version.decode("ascii", "replace")
    said = f"{said}.0" if said.isdigit() else said  # gmsh writes 4.0 as 4
    if said not in VERSIONS:
        raise MeshError(f"MSH version {said!r}; allowed: {' or '.join(VERSIONS)}")
    if kind not in (b"0", b"1") or size != b"8":
        raise MeshError("its header is damaged")
    if kind == b"1" and one[:4] != b"\x01\x00\x00\x00":
        raise MeshError("it was written by a machine with another order of bytes; save it as text")
    return said, kind == b"1"


def _sections(data: bytes) -> Iterator[tuple[str, bytes]]:
    """Name and inside of each section; before MeshFormat there may be comments alone."""
    at = _end_of_comments(data)
    if not data.startswith(b"$MeshFormat", at):
        raise MeshError("this is not a gmsh mesh (MSH) file")
    while (at := data.find(b"$", at)) >= 0:
        start = data.find(b"\n", at) + 1
        name = data[at + 1 : start].strip()
        # At the start of a line, unless the last line of binary data has no end: a name may hold the same words.
        end = data.find(b"\n$End" + name, start - 1) + 1 if start > 0 else 0
        end = end or data.find(b"$End" + name, start)
        if start == 0 or end < 0:
            raise MeshError("the file ends too early: it is truncated")
        yield name.decode("ascii", "replace"), data[start:end]
        at = end + len(name) + 4


def _end_of_comments(data: bytes) -> int:
    """Where the first section begins that is not $Comments."""
    at = 0
    while (found := re.compile(rb"\s*(\$Comments\b.*?\n\$EndComments[^\S\n]*(\n|$))?", re.DOTALL).match(data, at))[1]:
        at = found.end()
    return found.end()


class _Numbers:
    """Sequential reader of the numbers of a section, written as text or binary."""

    def __init__(self, data: bytes, name: str, binary: bool) -> None:
        self.name, self.binary, self.at = name, binary, 0
        self.data = data
        if not binary:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                try:
                    self.values = np.fromstring(data.decode("ascii"), sep=" ")
                except (ValueError, DeprecationWarning):
                    raise MeshError(f"section ${name} holds something that is not a number") from None

    def table(self, rows: int, kinds: str) -> Array:
        """The next rows (rows, columns), with a letter a column: i an int, z an unsigned long, d a double."""
        width = len(kinds)
        step = sum(int(BINARY[kind][-1]) for kind in kinds) if self.binary else width
        left = (len(self.data) if self.binary else len(self.values)) - self.at
        if not 0 <= rows * step <= left:
            raise MeshError(f"section ${self.name} is damaged: it has less than it announces")
        start, self.at = self.at, self.at + rows * step
        if not self.binary:
            return self.values[start : self.at].reshape(rows, width)
        if len(set(kinds)) == 1:
            found = np.frombuffer(self.data, BINARY[kinds[0]], rows * width, start)
            return found.astype(float).reshape(rows, width)
        fields = np.dtype([(str(i), BINARY[kind]) for i, kind in enumerate(kinds)])
        found = np.frombuffer(self.data, fields, rows, start)
        return np.stack([found[name].astype(float) for name in fields.names], axis=1).reshape(rows, width)

    def integers(self, rows: int, kinds: str) -> Integers:
        """The next rows (rows, columns) of whole numbers."""
        return self.whole(self.table(rows, kinds))

    def whole(self, found: Array) -> Integers:
        """These numbers as integers."""
        if not (np.abs(found) < 2.0**53).all() or (found != np.rint(found)).any():
            raise MeshError(f"section ${self.name} is damaged: a number in it is not whole or too large")
        return found.astype(np.int64)

    def row(self, kinds: str) -> list[int]:
        """The next whole numbers."""
        return self.integers(1, kinds)[0].tolist()

    def counted(self) -> list[int]:
        """The next whole numbers, after their count."""
        return self.integers(self.row("z")[0], "i")[:, 0].tolist()

    def announced(self) -> int:
        """The number on the first line of a section, which MSH 2.2 writes as text in binary files too."""
        if not self.binary:
            return self.row("z")[0]
        self.at = self.data.find(b"\n") + 1
        line = self.data[: self.at].strip()
        if not line.isdigit():
            raise MeshError(f"section ${self.name} is damaged: it does not begin with a number")
        return int(line)

    def left(self) -> int:
        """Number of values of a section in text that have not been read."""
        return len(self.values) - self.at


def _parse_4(sections: dict[str, bytes], binary: bool) -> Contents:
    """MSH 4.1: entities with their groups, then nodes and elements in blocks."""
    if "PartitionedEntities" in sections:
        raise MeshError("it is a partitioned mesh; save it whole")
    groups = {}
    entities = _Numbers(sections["Entities"], "Entities", binary) if "Entities" in sections else None
    for dim, count in enumerate(entities.row("zzzz") if entities else []):
        for _ in range(count):
            (tag,) = entities.row("i")
            entities.table(1, "ddd" if dim == 0 else "dddddd")
            groups[dim, tag] = [abs(group) for group in entities.counted()]
            if dim > 0:
                entities.counted()

    numbers = _Numbers(sections["Nodes"], "Nodes", binary)
    tags, x = [np.empty(0, np.int64)], [np.empty((0, 3))]
    count, total, _, _ = numbers.row("zzzz")
    for _ in range(count):
        dim, _, parametric, count = numbers.row("iiiz")
        tags.append(numbers.integers(count, "z")[:, 0])
        x.append(numbers.table(count, "ddd" + "d" * (dim if parametric == 1 and 0 < dim < 4 else 0))[:, :3])

    if sum(map(len, tags)) != total:
        raise MeshError(f"section $Nodes is damaged: it has {sum(map(len, tags))} nodes but announces {total}")

    numbers = _Numbers(sections["Elements"], "Elements", binary)
    blocks = []
    count, total, _, _ = numbers.row("zzzz")
    for _ in range(count):
        dim, entity, kind, count = numbers.row("iiiz")
        of_type, nodes = _properties(kind)
        if of_type != dim:
            raise MeshError(f"section $Elements is damaged: elements of type {kind} in an entity of dimension {dim}")
        blocks.append(Block(dim, entity, kind, numbers.integers(count, "z" * (1 + nodes))[:, 1:]))
    if (found := sum(len(block.nodes) for block in blocks)) != total:
        raise MeshError(f"section $Elements is damaged: it has {found} elements but announces {total}")
    return Contents(np.concatenate(tags), np.concatenate(x), blocks, groups)


def _parse_2(sections: dict[str, bytes], binary: bool) -> Contents:
    """MSH 2.2: each element has its physical group, which is taken as the entity."""
    numbers = _Numbers(sections["Nodes"], "Nodes", binary)
    nodes = numbers.table(numbers.announced(), "iddd")
    numbers = _Numbers(sections["Elements"], "Elements", binary)
    count = numbers.announced()
    blocks, groups, found = [], {}, 0
    while found < count:
        kind, rows, marks = numbers.row("iii") if binary else _run(numbers, count - found)
        dim, width = _properties(kind)
        if rows < 1 or not 0 <= marks < 100:
            raise MeshError("section $Elements is damaged: its counts make no sense")
        table = numbers.integers(rows, "i" * (1 + marks + width if binary else 3 + marks + width))
        found += rows
        first = 1 if binary else 3
        physical = np.abs(table[:, first]) if marks else np.zeros(rows, np.int64)
        for group in np.unique(physical).tolist():
            groups[dim, group] = [group] if group else []
            blocks.append(Block(dim, group, kind, table[physical == group, first + marks :]))
    return Contents(numbers.whole(nodes[:, 0]), nodes[:, 1:], blocks, groups)


def _run(numbers: _Numbers, most: int) -> tuple[int, int, int]:
    """Type, number and number of tags of the next elements in text that have both in common."""
    _, kind, marks = numbers.row("iii")
    numbers.at -= 3
    width = 3 + marks + _properties(kind)[1] if 0 <= marks < 100 else 3
    rows, window = 0, 64
    most = min(most, numbers.left() // width)
    while rows < most:
        end = min(rows + window, most)
        table = numbers.values[numbers.at + rows * width : numbers.at + end * width].reshape(-1, width)
        same = (table[:, 1] == kind) & (table[:, 2] == marks)
        if not same.all():
            return kind, rows + int(same.argmin()), marks
        rows, window = end, 4 * window
    return kind, rows, marks


def _properties(kind: int) -> tuple[int, int]:
    """Dimension and number of nodes of a gmsh type of element."""
    try:
        _, dim, _, nodes, _, _ = gmsh.model.mesh.getElementProperties(kind)
    except Exception:
        nodes = 0
    if nodes < 1:
        raise MeshError(f"section $Elements is damaged: there are no elements of type {kind}")
    return dim, nodes


def _names(data: bytes) -> dict[tuple[int, int], str]:
    """Names of physical groups."""
    found = {}
    for line in data.splitlines()[1:]:
        match = re.fullmatch(rb'\s*(\d+)\s+(\d+)\s+"(.*)"\s*', line)
        try:
            dim, tag, name = match.groups()
            key, text = (int(dim), int(tag)), name.decode("utf-8")
        except (AttributeError, ValueError):
            raise MeshError("section $PhysicalNames is damaged") from None
        if broken := breaking_character(text):
            raise MeshError(
                f"the name of physical group {key[1]} of dimension {key[0]} holds {broken}, which breaks or turns lines"
            )
        found[key] = text
    return found
