"""Meshes distributed to DOLFINx: the same on any number of ranks, saved and read back, and broken files."""

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
from piezomat.meshes.gmsh_io import model as gmsh_model
from piezomat.meshes.gmsh_io.mesh_file import MeshFile, read_groups
from piezomat.meshes.gmsh_io.model import MeshError
from piezomat.meshes.mesh_entities import exterior_facets
from piezomat.meshes.shapes import (
    Cantilever,
    CrossedFibers,
    FacingHalves,
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
@pytest.mark.parametrize("partition", [None, stripes, all_on_the_last], ids=["graph", "stripes", "last"])
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


def write_mesh(path: Path, shape: Shape, version: float = 4.1, binary: int = 1, order: int = 1) -> Path:
    """Save a small mesh in any format of gmsh."""
    with gmsh_model.session():
        shape.build(MeshSizes(0.5, 0.3, order))
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", binary)
        gmsh.write(str(path))
    return path


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("version", [2.2, 4.1])
@pytest.mark.parametrize("order", [1, 2])
def test_every_format_gives_the_same_mesh(tmp_path: Path, version: float, binary: int, order: int) -> None:
    sizes = MeshSizes(0.5, 0.3)
    expected = arrays_of(FacingHalves(), sizes)
    path = write_mesh(tmp_path / "halves.msh", FacingHalves(), version, binary, order)
    # A mesh that is read gets the requested order.
    read = arrays_of(MeshFile(file=path), sizes)
    assert read.bodies == expected.bodies and read.facet_groups == expected.facet_groups
    np.testing.assert_array_equal(read.cell_body, expected.cell_body)
    np.testing.assert_allclose(read.x[read.cells], expected.x[expected.cells], atol=1e-14)
    assert len(read.facets) == len(expected.facets)
    curved = arrays_of(MeshFile(file=path), MeshSizes(0.5, 0.3, 2))
    assert curved.cells.shape == (len(expected.cells), 6)


def test_parameters_of_nodes_are_skipped(tmp_path: Path) -> None:
    with gmsh_model.session():
        FacingHalves().build(MeshSizes(0.5, 0.3))
        gmsh.option.setNumber("Mesh.SaveParametric", 1)
        gmsh.write(str(tmp_path / "binary.msh"))
        gmsh.option.setNumber("Mesh.Binary", 0)
        gmsh.write(str(tmp_path / "text.msh"))
    sizes = MeshSizes(0.5, 0.3)
    expected = arrays_of(FacingHalves(), sizes)
    for name in ("binary.msh", "text.msh"):
        read = arrays_of(MeshFile(file=tmp_path / name), sizes)
        np.testing.assert_allclose(read.x[read.cells], expected.x[expected.cells], atol=1e-14)


def square(z: float = 0.0, name: str = "body", unnamed: bool = False, recombine: bool = False) -> None:
    """A unit square with its groups, in the current gmsh model."""
    surface = gmsh.model.occ.addRectangle(0, 0, z, 1, 1)
    gmsh.model.occ.synchronize()
    curves = [tag for _, tag in gmsh.model.getBoundary([(2, surface)], oriented=False)]
    gmsh.model.addPhysicalGroup(2, [surface], 7, name="" if unnamed else name)
    gmsh.model.addPhysicalGroup(1, curves[:1], 3, name="" if unnamed else "bottom")
    gmsh.model.addPhysicalGroup(1, curves[:2], 9, name="" if unnamed else "held")
    gmsh.model.addPhysicalGroup(0, [1], 11, name="corner")
    gmsh.option.setNumber("Mesh.RecombineAll", int(recombine))
    gmsh.model.mesh.generate(2)


def saved(path: Path, draw: Callable[[], None]) -> MeshFile:
    """A file with what `draw` puts into a gmsh model."""
    with gmsh_model.session():
        draw()
        gmsh.write(str(path))
    return MeshFile(file=path)


def test_groups_without_a_name_have_their_number_and_points_are_left_out(tmp_path: Path) -> None:
    file = saved(tmp_path / "square.msh", lambda: square(unnamed=True))
    assert read_groups(file.file) == (2, ("7",), ("3", "9"))
    arrays = arrays_of(file, MeshSizes(1.0, 1.0))
    assert arrays.bodies == ("7",) and arrays.facet_groups == ("3", "9")


def test_a_facet_may_be_in_several_groups(tmp_path: Path) -> None:
    body = create(MPI.COMM_SELF, saved(tmp_path / "square.msh", square), MeshSizes(1.0, 1.0))
    assert integrate(body, "ds", body.facets["bottom"]) == pytest.approx(1)
    assert integrate(body, "ds", body.facets["held"]) == pytest.approx(2)
    assert np.isin(body.facets["bottom"], body.facets["held"]).all()


def test_a_2d_mesh_may_lie_in_any_plane_of_x_and_y_and_face_down(tmp_path: Path) -> None:
    def turned() -> None:
        square(z=2.0)
        gmsh.model.mesh.reverse()

    arrays = arrays_of(saved(tmp_path / "square.msh", turned), MeshSizes(1.0, 1.0))
    assert arrays.x.shape[1] == 2


def no_groups() -> None:
    square()
    gmsh.model.removePhysicalGroups()
    gmsh.option.setNumber("Mesh.SaveAll", 1)


def part_of_it_in_no_group() -> None:
    square()
    other = gmsh.model.occ.addRectangle(2, 0, 0, 1, 1)
    gmsh.model.occ.synchronize()
    gmsh.model.mesh.generate(2)
    gmsh.option.setNumber("Mesh.SaveAll", 1)
    assert other


def in_two_bodies() -> None:
    square()
    gmsh.model.addPhysicalGroup(2, [1], 8, name="also")


def mixed_cells() -> None:
    square()
    other = gmsh.model.occ.addRectangle(2, 0, 0, 1, 1)
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(2, [other], 8, name="other")
    gmsh.model.mesh.setRecombine(2, other)
    gmsh.model.mesh.generate(2)


def not_planar() -> None:
    square()
    gmsh.model.mesh.affineTransform([1, 0, 0, 0, 0, 1, 0, 0, 0.1, 0, 1, 0])


def moved_across(cells: str) -> Callable[[], None]:
    def draw() -> None:
        StackedBlocks(divisions=[[3, 3], [3, 3]]).build(MeshSizes(1, 1, cells=cells))
        inner = [t for t, x in zip(*gmsh_model.nodes(), strict=True) if 0.01 < x[0] < 0.4 and 0.01 < x[1] < 0.2]
        gmsh.model.mesh.setNode(inner[0], [0.9, 0.4, 0.0], [])

    return draw


def flat_tetrahedra() -> None:
    CrossedFibers().build(MeshSizes(0.8, 0.8))
    gmsh.model.mesh.affineTransform([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0])


def incomplete_cells() -> None:
    gmsh.option.setNumber("Mesh.SecondOrderIncomplete", 1)
    square(recombine=True)
    gmsh.model.mesh.setOrder(2)


def only_curves() -> None:
    square()
    gmsh.model.mesh.clear([(2, 1)])


def foreign_facets() -> None:
    square()
    gmsh.model.addDiscreteEntity(1, 50)
    gmsh.model.mesh.addElementsByType(50, 1, [], [1, 3])
    gmsh.model.addPhysicalGroup(1, [50], 50, name="diagonal")


@pytest.mark.parametrize(
    ("draw", "words"),
    [
        (no_groups, "no physical surfaces"),
        (part_of_it_in_no_group, "belong to no physical group"),
        (in_two_bodies, "cells in common"),
        (mixed_cells, "different types"),
        (not_planar, "plane"),
        (moved_across("simplex"), "inverted or degenerate"),
        (moved_across("tensor"), "inverted or degenerate"),
        (flat_tetrahedra, "inverted or degenerate"),
        (incomplete_cells, "Quadrilateral 8"),
        (only_curves, "no cells"),
        (foreign_facets, "'diagonal'"),
    ],
)
def test_unusable_meshes_are_named_in_one_line(tmp_path: Path, draw: Callable[[], None], words: str) -> None:
    file = saved(tmp_path / "bad.msh", draw)
    order = 2 if draw is incomplete_cells else 1
    with pytest.raises(MeshError, match=words) as caught:
        create(MPI.COMM_SELF, file, MeshSizes(1.0, 1.0, order))
    assert caught.value.key == "geometry.file"
    assert str(file.file) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("version", [2.2, 4.1])
def test_a_name_stands_for_one_group(tmp_path: Path, version: float) -> None:
    path = write_mesh(tmp_path / "blocks.msh", BLOCKS, version, binary=0)
    path.write_text(path.read_text().replace('"upper"', '"lower"'))
    with pytest.raises(MeshError, match="surfaces have the same name, 'lower'"):
        read_groups(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"", "empty"),
        (b"solid cube\nendsolid\n", "not a gmsh mesh"),
        (b"$MeshFormat\n1 0 8\n$EndMeshFormat\n", "version '1'"),
        (b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n", r"no section \$Nodes"),
        (b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 4", "truncated"),
        (
            b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n1\n1 0 0 0\n$EndNodes\n"
            b"$Elements\n1\n1 2 2 1 1 1 2 3\n$EndElements\n",
            "node 2, which does not exist",
        ),
    ],
)
def test_files_that_are_no_mesh_are_named_in_one_line(tmp_path: Path, text: bytes, words: str) -> None:
    path = tmp_path / "bad.msh"
    path.write_bytes(text)
    for read in (read_groups, lambda path: create(MPI.COMM_SELF, MeshFile(file=path), MeshSizes(1.0, 1.0))):
        with pytest.raises(MeshError, match=words) as caught:
            read(path)
        assert caught.value.key == "geometry.file" and "\n" not in str(caught.value)
    assert not gmsh.isInitialized()


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("version", [2.2, 4.1])
def test_damaged_files_are_refused_or_read_but_crash_nothing(
    tmp_path: Path, version: float, binary: int, rng: np.random.Generator
) -> None:
    path = write_mesh(tmp_path / "mesh.msh", BLOCKS, version, binary)
    sound = path.read_bytes()
    refused = 0
    for trial in range(12):
        data = bytearray(sound)
        if trial % 2:
            data = data[: rng.integers(len(data) - 20)]
        else:
            data[rng.integers(60, len(data) - 20)] = int(rng.integers(256))
        path.write_bytes(data)
        try:
            create(MPI.COMM_SELF, MeshFile(file=path), MeshSizes(1.0, 1.0))
        except MeshError as error:
            refused += 1
            assert error.key == "geometry.file" and "\n" not in str(error)
    assert refused >= 6


def test_a_mesh_is_the_same_from_run_to_run() -> None:
    first, second = (arrays_of(CrossedFibers(), MeshSizes(0.4, 0.2)) for _ in range(2))
    np.testing.assert_array_equal(first.x, second.x)
    np.testing.assert_array_equal(first.cells, second.cells)


def test_parts_are_numbered_by_their_first_cells() -> None:
    body = create(MPI.COMM_SELF, ParallelFibers(count=4), MeshSizes(0.6, 0.4))
    assert body.part_bodies == [[0], [1], [2], [3]]
