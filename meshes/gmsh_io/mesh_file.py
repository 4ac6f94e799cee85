"""A gmsh mesh file as geometry: read into the gmsh model, with errors that name the file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import gmsh
import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from piezomat.meshes.gmsh_io import model as gmsh_model
from piezomat.meshes.gmsh_io import msh_reader as msh
from piezomat.meshes.gmsh_io.model import GEOMETRY, MeshError

KEY = f"{GEOMETRY}.file"


class MeshFile(BaseModel):
    """A gmsh mesh (MSH 2.2 or 4.1, text or binary): physical volumes are bodies, surfaces facet groups.

    A 2D mesh lies in a plane of x and y and has physical surfaces and curves. The name of a group without a name is its
    number. Groups of lower dimensions are ignored.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    file: Path = Field(description="path of the mesh; relative to the scene file")


def load(path: Path) -> None:
    """Read a mesh file into the current gmsh model: its cells and the elements one dimension below.

    Raises MeshError.
    """
    file = msh.read(path)
    used, order = np.unique(file.tags, return_index=True)
    if len(used) < len(file.tags):
        raise MeshError("two nodes have the same number")
    cells = max((block.dim for block in file.blocks if len(block.nodes)), default=0)
    if cells < 2:
        raise MeshError("it has no cells (neither volumes nor surfaces are meshed)")
    entities: dict[tuple[int, int], int] = {}
    for dim in (cells, cells - 1):
        for d, entity in dict.fromkeys([*file.groups, *((b.dim, b.entity) for b in file.blocks)]):
            if d == dim:
                entities[d, entity] = gmsh.model.addDiscreteEntity(d)
    tags = np.arange(1, len(used) + 1)
    gmsh.model.mesh.addNodes(cells, next(iter(entities.values())), tags, file.x[order].ravel())
    for block in file.blocks:
        if (block.dim, block.entity) in entities:
            number = np.minimum(np.searchsorted(used, block.nodes), len(used) - 1)
            missing = used[number] != block.nodes
            if missing.any():
                raise MeshError(f"an element has the node {block.nodes[missing][0]}, which does not exist")
            entity = entities[block.dim, block.entity]
            gmsh.model.mesh.addElementsByType(entity, block.type, [], tags[number].ravel())
    _name_groups(file, entities)


def _name_groups(file: msh.Contents, entities: dict[tuple[int, int], int]) -> None:
    """Add physical groups to `entities`: (dim, entity) of the file -> tag in gmsh. Raises MeshError."""
    groups: dict[tuple[int, int], list[int]] = {}
    for key, tag in entities.items():
        for group in file.groups.get(key, []):
            groups.setdefault((key[0], group), []).append(tag)
    names = {key: file.names.get(key) or str(key[1]) for key in groups}
    for (dim, name), count in Counter((dim, names[dim, group]) for dim, group in groups).items():
        if count > 1:
            what = ("points", "curves", "surfaces", "volumes")[dim]
            raise MeshError(f"two physical groups of {what} have the same name, {name!r}")
    for (dim, group), members in groups.items():
        gmsh.model.addPhysicalGroup(dim, members, group, names[dim, group])


@contextmanager
def blaming(path: Path) -> Iterator[None]:
    """Name the file and its key in errors of the geometry."""
    try:
        yield
    except MeshError as error:
        if error.key != GEOMETRY:
            raise
        raise MeshError(f"{path}: {error}", KEY) from None


def read_groups(path: Path) -> tuple[int, tuple[str, ...], tuple[str, ...]]:
    """Dimension, names of bodies and names of facet groups of a file. Not collective. Raises MeshError."""
    with blaming(path), gmsh_model.session():
        load(path)
        dim = gmsh_model.cell_dimension()
        bodies, facets = gmsh_model.body_and_facet_groups(dim)
        return dim, tuple(body.name for body in bodies), tuple(group.name for group in facets)
