"""The current gmsh model: opened and closed, its groups and elements, written to a file."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import gmsh
import numpy as np

from piezomat.forms.arrays import Array, Integers

# Meshes are the same from run to run: one thread, and no settings from the user's files.
_OPTIONS = {
    "General.Terminal": 0,
    "General.NumThreads": 1,
    "General.AbortOnError": 0,
    "Mesh.Algorithm3D": 10,  # HXT, several times as fast as the default
    "Mesh.Binary": 1,
    "Mesh.MshFileVersion": 4.1,
    "Mesh.SaveAll": 0,
    "Mesh.SecondOrderIncomplete": 0,
}

# gmsh's number of an element type: name, order. Incomplete second order (8-node quadrilaterals) is not here.
CELLS: dict[int, tuple[str, int]] = {
    1: ("interval", 1),
    2: ("triangle", 1),
    3: ("quadrilateral", 1),
    4: ("tetrahedron", 1),
    5: ("hexahedron", 1),
    8: ("interval", 2),
    9: ("triangle", 2),
    10: ("quadrilateral", 2),
    11: ("tetrahedron", 2),
    12: ("hexahedron", 2),
}


GEOMETRY = "geometry"


class MeshError(ValueError):
    """Mesh that cannot be built, read or used; `key` is the key of the scene that is wrong."""

    def __init__(self, message: str, key: str = GEOMETRY) -> None:
        super().__init__(message, key)
        self.key = key

    def __str__(self) -> str:
        return self.args[0]


@dataclass(frozen=True)
class Elements:
    """Elements of one type in one entity: gmsh type, element tags (n,), node tags (n, nodes)."""

    type: int
    tags: Integers
    nodes: Integers


@dataclass(frozen=True)
class Group:
    """A physical group: its name (its tag where unnamed) and its entities."""

    tag: int
    name: str
    entities: tuple[int, ...]


@contextmanager
def session(name: str = "piezomat") -> Iterator[None]:
    """Empty, silent gmsh model that is removed at the end, also after an error.

    If the caller has opened gmsh, it stays open with the caller's model and options.
    """
    opened = not gmsh.isInitialized()
    if opened:
        _initialize()
    before = "" if opened else gmsh.model.getCurrent()
    options = {option: gmsh.option.getNumber(option) for option in _OPTIONS}
    for option, value in _OPTIONS.items():
        gmsh.option.setNumber(option, value)
    gmsh.model.add(name)
    try:
        yield
    finally:
        if opened:
            gmsh.finalize()
        else:
            gmsh.model.remove()
            gmsh.model.setCurrent(before)
            for option, value in options.items():
                gmsh.option.setNumber(option, value)


def _initialize() -> None:
    """Open gmsh and keep Python's signal handlers, which gmsh replaces by the system's defaults the first time."""
    handlers = {number: signal.getsignal(number) for number in signal.valid_signals()}
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    if threading.current_thread() is not threading.main_thread():
        return  # Python sets handlers in the main thread only
    for number, handler in handlers.items():
        if handler is not None and handler != signal.SIG_DFL:
            signal.signal(number, handler)


def add_groups(dim: int, groups: dict[str, list[int]]) -> None:
    """Name groups of entities of one dimension."""
    for name, tags in groups.items():
        gmsh.model.addPhysicalGroup(dim, tags, name=name)


def groups(dim: int) -> list[Group]:
    """Physical groups of a dimension in the order of their tags."""
    found = []
    for _, tag in sorted(gmsh.model.getPhysicalGroups(dim)):
        name = gmsh.model.getPhysicalName(dim, tag) or str(tag)
        entities = gmsh.model.getEntitiesForPhysicalGroup(dim, tag)
        found.append(Group(int(tag), name, tuple(int(e) for e in entities)))
    return found


def elements(dim: int, entity: int) -> list[Elements]:
    """Elements of an entity, one item for each type."""
    found = []
    for kind, tags, nodes in zip(*gmsh.model.mesh.getElements(dim, entity), strict=True):
        shape = (len(tags), -1)
        found.append(Elements(int(kind), tags.astype(np.int64), nodes.astype(np.int64).reshape(shape)))
    return found


def nodes() -> tuple[Integers, Array]:
    """Tags (n,) and coordinates (n, 3) of all nodes."""
    tags, x, _ = gmsh.model.mesh.getNodes()
    return tags.astype(np.int64), x.reshape(-1, 3)


def cell_dimension() -> int:
    """Dimension of the cells of the current gmsh model, 2 or 3. Raises MeshError."""
    for dim in (3, 2):
        if any(elements(dim, entity) for _, entity in gmsh.model.getEntities(dim)):
            return dim
    raise MeshError("it has no cells (neither volumes nor surfaces are meshed)")


def body_and_facet_groups(dim: int) -> tuple[list[Group], list[Group]]:
    """Physical groups of cells and of facets. Raises MeshError."""
    bodies, facets = groups(dim), groups(dim - 1)
    if not bodies:
        what = "volumes" if dim == 3 else "surfaces"
        raise MeshError(f"it has no physical {what}: give each body a physical group")
    return bodies, facets


def type_name(kind: int) -> str:
    """gmsh's name of an element type, such as "Hexahedron 20"."""
    return gmsh.model.mesh.getElementProperties(kind)[0]


def write(path: Path | str) -> None:
    """Write the current model as binary MSH 4.1; the file appears complete or not at all. Raises OSError.

    gmsh reports nothing where the disk is full, so the end of its file is checked. Others cannot reach the file while
    gmsh writes it: it lies in a folder of ours.
    """
    path = Path(path)
    private = path.with_name(f".mesh.{secrets.token_hex(8)}.part")
    private.mkdir(0o700)  # gmsh would not give the reason of a failure
    try:
        temporary = private / "mesh.msh"
        gmsh.write(str(temporary))
        with temporary.open("rb+") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - 64))
            if not file.read().rstrip().endswith((b"$EndElements", b"$EndPeriodic")):
                raise OSError(errno.ENOSPC, "only a part of the mesh could be written: the disk or a quota is full")
            os.fsync(file.fileno())
        temporary.replace(path)
    except Exception as error:
        # gmsh raises Exception itself
        raise error if isinstance(error, OSError) else OSError(str(error)) from None
    finally:
        shutil.rmtree(private, ignore_errors=True)
