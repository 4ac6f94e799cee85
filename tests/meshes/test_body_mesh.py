"""Meshes distributed to DOLFINx: the same on any number of ranks, saved and read back."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import gmsh
import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dolfinx_mesh
from mpi4py import MPI

from piezomat.forms import fenicsx
from piezomat.meshes.body_mesh import BodyMesh, arrays_of, create
from piezomat.meshes.gmsh_io.mesh_file import MeshFile, read_groups
from piezomat.meshes.gmsh_io.model import MeshError
from piezomat.meshes.mesh_entities import exterior_facets
from piezomat.meshes.shapes import (
    Cantilever,
    CrossedFibers,
    MeshSizes,
    ParallelFibers,
    Shape,
    StackedBlocks,
)

# Shapes whose measures are known exactly, one for each type of cell, in both orders.
BLOCKS = StackedBlocks(height=[0.5, 0.25], divisions=[[4, 2], [3, 1]], distortion=0.2)
BLOCKS_3D = StackedBlocks(height=[0.5, 0.25], depth=0.5, divisions=[[4, 2, 2], [3, 2, 1]], distortion=0.2)
BEAM = Cantilever(length=4, width=0.5, divisions=[5, 2, 1])
CASES: list[tuple[Shape, str, int]] = [
    (BLOCKS, "simplex", 1),
    (BLOCKS, "tensor", 2),
    (BLOCKS_3D, "simplex", 2),
    (BLOCKS_3D, "tensor", 1),
    (BEAM, "simplex", 1),
    (BEAM, "tensor", 2),
]
EXACT = {
    BLOCKS.dimension: {"lower": 0.5, "upper": 0.25, "left": 0.75, "bottom": 1.0, "upper_contact": 1.0},
    BLOCKS_3D.dimension: {"lower": 0.25, "upper": 0.125, "left": 0.375, "front": 0.75, "upper_contact": 0.5},
}
EXACT_BEAM = {"layer_1": 1.0, "layer_2": 1.0, "root": 0.5, "front": 4.0, "bottom": 2.0, "interface_1": 2.0}


def integrate(body: BodyMesh, kind: str, entities: np.ndarray) -> float:
    """Measure of cells (dx), exterior (ds) or interior (dS) facets over all ranks."""
    mesh = body.mesh
    dim = mesh.topology.dim - (kind != "dx")
    entities = np.sort(entities).astype(np.int32)
    tags = dolfinx_mesh.meshtags(mesh, dim, entities, np.ones(len(entities), np.int32))
    measure = ufl.Measure(kind, domain=mesh, subdomain_data=tags, subdomain_id=1)
    one = fem.Constant(mesh, 1.0)
    return mesh.comm.allreduce(fem.assemble_scalar(fem.form((one("+") if kind == "dS" else one) * measure)))


def counts(body: BodyMesh) -> list[int]:
    """Numbers of vertices, cells and geometry nodes, and of exterior facets, over all ranks."""
    mesh = body.mesh
    maps = mesh.topology.index_map(0), mesh.topology.index_map(mesh.topology.dim), mesh.geometry.index_map()
    return [m.size_global for m in maps] + [mesh.comm.allreduce(len(exterior_facets(mesh)))]


def stripes(centroids: np.ndarray, bodies: np.ndarray, ranks: int) -> np.ndarray:
    """A partition that cuts every body into as many stripes along x as there are ranks."""
    x = centroids[:, 0]
    return np.minimum(ranks * (x - x.min()) / np.ptp(x), ranks - 1).astype(np.int32)


def all_on_the_last(centroids: np.ndarray, bodies: np.ndarray, ranks: int) -> np.ndarray:
    """A partition that leaves all ranks but one without cells."""
    return np.full(len(bodies), ranks - 1, np.int32)


@pytest.mark.mpi
@pytest.mark.parametrize("partition", [None, stripes, all_on_the_last], ids=["bodies", "stripes", "last"])
@pytest.mark.parametrize(("shape", "cells", "order"), CASES)
def test_measures_and_parts_are_the_same_on_any_number_of_ranks(
    comm: MPI.Comm, shape: Shape, cells: str, order: int, partition: Callable | None
) -> None:
    body = create(comm, shape, MeshSizes(1.0, 1.0, order, cells), partition=partition)
    counted = counts(body)
    alone = counts(create(MPI.COMM_SELF, shape, MeshSizes(1.0, 1.0, order, cells)))
    assert counted == alone
    local = body.mesh.topology.index_map(shape.dimension).size_local
    assert len(body.cell_body) == len(body.cell_part) == local
    assert body.bodies == shape.bodies() and tuple(body.facets) == shape.facet_groups()
    assert body.order == order
    bonded = shape is BEAM
    assert body.part_bodies == ([[0, 1]] if bonded else [[0], [1]])
    np.testing.assert_array_equal(body.cell_part, 0 * body.cell_body if bonded else body.cell_body)
    for name, value in (EXACT_BEAM if bonded else EXACT[shape.dimension]).items():
        if name in body.bodies:
            found = integrate(body, "dx", np.flatnonzero(body.cell_body == body.bodies.index(name)))
        elif name != "interface_1":
            found = integrate(body, "ds", body.facets[name])
            assert np.isin(body.facets[name], exterior_facets(body.mesh)).all()
        elif comm.size == 1:
            found = integrate(body, "dS", body.facets[name])
        else:
            # Without ghost cells no rank integrates over a facet between two: count facets instead.
            owned = body.mesh.topology.index_map(shape.dimension - 1).size_local
            count = comm.allreduce(int((body.facets[name] < owned).sum()))
            found = 2.0 * count / (5 * (1 if cells == "tensor" else 2))
        assert found == pytest.approx(value, rel=1e-12), name


@pytest.mark.mpi
def test_a_forced_partition_is_kept(comm: MPI.Comm) -> None:
    body = create(comm, BLOCKS, MeshSizes(1.0, 1.0), partition=stripes)
    x = body.mesh.geometry.x[fenicsx.geometry_dofmap(body.mesh)].mean(axis=1)[:, 0]
    low, high = comm.allreduce(x.min(), MPI.MIN), comm.allreduce(x.max(), MPI.MAX)
    width = (high - low) / comm.size
    assert x.min() > low + comm.rank * width - 1e-12 and x.max() < low + (comm.rank + 1) * width + 1e-12
    assert set(body.cell_body.tolist()) == {0, 1}


@pytest.mark.mpi
@pytest.mark.parametrize("cells", ["simplex", "tensor"])
def test_a_saved_mesh_reads_back_the_same(comm: MPI.Comm, shared_tmp_path: Path, cells: str) -> None:
    path = shared_tmp_path / "fibers.msh"
    shape, sizes = CrossedFibers(), MeshSizes(0.6, 0.4, 2, cells)
    built = create(comm, shape, sizes, save=path)
    read = create(comm, MeshFile(file=path), sizes)
    assert read.bodies == built.bodies and read.part_bodies == built.part_bodies
    assert set(read.facets) == set(built.facets)
    for name in ("lower", "upper"):
        number = built.bodies.index(name)
        volumes = [integrate(b, "dx", np.flatnonzero(b.cell_body == number)) for b in (built, read)]
        assert volumes[0] == pytest.approx(volumes[1], rel=1e-13)
    for name in built.facets:
        areas = [integrate(b, "ds", b.facets[name]) for b in (built, read)]
        assert areas[0] == pytest.approx(areas[1], rel=1e-13) and areas[0] > 0.5
    if comm.rank == 0:
        assert [p.name for p in shared_tmp_path.iterdir()] == ["fibers.msh"]
        assert read_groups(path) == (3, shape.bodies(), shape.facet_groups())


@pytest.mark.mpi
def test_errors_of_rank_0_are_raised_on_all(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="No such file") as caught:
        create(comm, MeshFile(file=shared_tmp_path / "none.msh"), MeshSizes(1.0, 1.0))
    assert caught.value.key == "geometry.file"
    with pytest.raises(MeshError, match=r"out\.msh") as caught:
        create(comm, BLOCKS, MeshSizes(1.0, 1.0), save=shared_tmp_path / "nowhere" / "out.msh")
    assert caught.value.key == "out"
    assert not gmsh.isInitialized()


def test_a_mesh_is_the_same_from_run_to_run() -> None:
    first, second = (arrays_of(CrossedFibers(), MeshSizes(0.4, 0.2)) for _ in range(2))
    np.testing.assert_array_equal(first.x, second.x)
    np.testing.assert_array_equal(first.cells, second.cells)


def test_parts_are_numbered_by_their_first_cells() -> None:
    body = create(MPI.COMM_SELF, ParallelFibers(count=4), MeshSizes(0.6, 0.4))
    assert body.part_bodies == [[0], [1], [2], [3]]
