"""Mesh of bodies, built or read from a file and distributed over the ranks, with body numbers and facet groups."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.meshes.builders.sizes import MeshSizes
from piezomat.meshes.cell_ranks import cell_ranks
from piezomat.meshes.gmsh_io import extract
from piezomat.meshes.gmsh_io import model as gmsh_model
from piezomat.meshes.gmsh_io.extract import Arrays, not_facets
from piezomat.meshes.gmsh_io.mesh_file import MeshFile, blaming, load
from piezomat.meshes.gmsh_io.model import MeshError
from piezomat.meshes.joints import Joint
from piezomat.meshes.parallel import only_on_root
from piezomat.meshes.shapes.base import Shape

Partition = Callable[[Array, NDArray[np.int32], int], NDArray[np.int32]]


@dataclass(frozen=True)
class BodyMesh:
    """Distributed mesh. Arrays over cells and facets are those of this rank.

    comm: the communicator it was made on; that of `mesh` is a duplicate, which ends with the mesh.
    cell_body (cells,): number of the body; cell_part (cells,): number of the connected part, cells that share nodes;
    part_bodies: bodies of each part; facets: local indices of each group, exterior or interior. An interior facet
    between two ranks is on both. joints: the doubtful ones, on all ranks.
    """

    comm: MPI.Comm
    mesh: Any
    bodies: tuple[str, ...]
    cell_body: NDArray[np.int32]
    cell_part: NDArray[np.int32]
    part_bodies: list[list[int]]
    facets: dict[str, NDArray[np.int32]]
    order: int
    joints: tuple[Joint, ...]


def create(
    comm: MPI.Comm,
    geometry: Shape | MeshFile,
    sizes: MeshSizes,
    *,
    save: Path | None = None,
    partition: Partition | None = None,
) -> BodyMesh:
    """Build or read a mesh on rank 0 and distribute it. Collective.

    `save` writes it as MSH 4.1 too. `partition(centroids, bodies, ranks)` is called on rank 0 with arrays
    (cells, dim) and (cells,) and returns the rank of each cell, by default `cell_ranks`.
    Raises MeshError on all ranks.
    """
    with blaming(geometry.file) if isinstance(geometry, MeshFile) else nullcontext():
        arrays = only_on_root(comm, lambda: arrays_of(geometry, sizes, save))
        return distribute(comm, arrays, partition)


def write(comm: MPI.Comm, geometry: Shape | MeshFile, sizes: MeshSizes, path: Path) -> None:
    """Build or read a mesh on rank 0 and write it as MSH 4.1. Collective. Raises MeshError on all ranks."""
    with blaming(geometry.file) if isinstance(geometry, MeshFile) else nullcontext():
        only_on_root(comm, lambda: arrays_of(geometry, sizes, path))


def arrays_of(geometry: Shape | MeshFile, sizes: MeshSizes, save: Path | None = None) -> Arrays:
    """Mesh of a geometry as arrays. Not collective. Raises MeshError."""
    with gmsh_model.session():
        if isinstance(geometry, MeshFile):
            load(geometry.file)
        else:
            _build(geometry, sizes)
        arrays = extract.mesh_arrays(sizes.order)
        if save is not None:
            try:
                gmsh_model.write(save)
            except OSError as error:
                raise MeshError(f"{save}: {error.strerror or error}", "out") from None
    return arrays


def _build(shape: Shape, sizes: MeshSizes) -> None:
    try:
        shape.build(sizes)
    except Exception as error:
        # gmsh raises Exception itself; its message may have several lines.
        raise MeshError(f"gmsh cannot mesh it: {' '.join(str(error).split())}") from error


def distribute(comm: MPI.Comm, arrays: Arrays | None, partition: Partition | None = None) -> BodyMesh:
    """Distribute a mesh given on rank 0. Collective. Raises MeshError on all ranks."""
    head = comm.bcast(arrays.head() if comm.rank == 0 else None)
    mine = arrays if comm.rank == 0 else head
    dim = head.dimension

    destinations = None
    if comm.rank == 0:
        centroids = mine.x[mine.cells].mean(axis=1)
        destinations = np.asarray((partition or cell_ranks)(centroids, mine.cell_body, comm.size), np.int32)
    mesh = fenicsx.create_mesh(comm, mine.cells, mine.x, head.cell_type, head.order, destinations)

    # Rank 0 sends each rank the data of its cells, so that no rank needs memory for all.
    wanted = comm.gather(fenicsx.original_cells(mesh))
    data, part_bodies = None, None
    if comm.rank == 0:
        parts = np.arange(mine.cell_part.max() + 1)
        pairs = np.unique(np.stack([mine.cell_part, mine.cell_body]), axis=1)
        part_bodies = [bodies.tolist() for bodies in np.split(pairs[1], np.searchsorted(pairs[0], parts)[1:])]
        data = [np.stack([mine.cell_body[cells], mine.cell_part[cells]]) for cells in wanted]
    cell_body, cell_part = comm.scatter(data)

    indices, values = fenicsx.entities_from_nodes(mesh, dim - 1, mine.facets, mine.facet_values)
    owned = indices < mesh.topology.index_map(dim - 1).size_local
    facets = {}
    for number, name in enumerate(head.facet_groups):
        having = [value for value, groups in enumerate(head.combinations) if number in groups]
        of_group = np.isin(values, having)
        facets[name] = np.sort(indices[of_group]).astype(np.int32)
        missing = np.isin(mine.facet_values, having).sum() - (of_group & owned).sum()
        if comm.allreduce(int(missing)) != 0:
            raise not_facets(name)
    part_bodies = comm.bcast(part_bodies)
    return BodyMesh(comm, mesh, head.bodies, cell_body, cell_part, part_bodies, facets, head.order, head.joints)
