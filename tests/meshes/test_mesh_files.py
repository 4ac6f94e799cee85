"""Mesh files: every format and drawing is read, and what cannot be used is named in one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import gmsh
import numpy as np
import pytest
from mpi4py import MPI

from piezomat.meshes.body_mesh import arrays_of, create
from piezomat.meshes.gmsh_io import model as gmsh_model
from piezomat.meshes.gmsh_io.mesh_file import MeshFile, read_groups
from piezomat.meshes.gmsh_io.model import MeshError
from piezomat.meshes.mesh_entities import exterior_facets
from piezomat.meshes.shapes import CrossedFibers, FacingHalves, MeshSizes, Shape, StackedBlocks
from tests.meshes.test_body_mesh import BLOCKS, integrate


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


def swept(recombine: bool) -> Callable[[], None]:
    def draw() -> None:
        bottom = gmsh.model.occ.addRectangle(0, 0, 0, 1, 1)
        made = gmsh.model.occ.extrude([(2, bottom)], 0, 0, 1, [2], recombine=True)
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(3, [tag for dim, tag in made if dim == 3], name="body")
        if recombine:
            other = gmsh.model.occ.addBox(2, 0, 0, 1, 1, 1)
            gmsh.model.occ.synchronize()
            gmsh.model.addPhysicalGroup(3, [other], name="other")
        gmsh.model.mesh.generate(3)

    return draw


def folded_tetrahedra() -> None:
    """Three tetrahedra around an edge, the last of which is turned back over the first."""
    points = [[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [0.5, 0.5, 0.2], [-1, 0, 0]]
    volume = gmsh.model.addDiscreteEntity(3)
    gmsh.model.mesh.addNodes(3, volume, list(range(1, 7)), np.ravel(points))
    gmsh.model.mesh.addElementsByType(volume, 4, [], np.ravel([[1, 3, 4, 2], [1, 3, 5, 2], [1, 4, 6, 2]]))
    gmsh.model.addPhysicalGroup(3, [volume], name="body")


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
        (swept(recombine=False), "Prism 6 cannot be used, only triangle, quadrilateral, tetrahedron, hexahedron cells"),
        (swept(recombine=True), "Prism 6 cannot be used"),
        (not_planar, "plane"),
        (moved_across("simplex"), "inverted or degenerate"),
        (moved_across("tensor"), "inverted or degenerate"),
        (flat_tetrahedra, "inverted or degenerate"),
        (folded_tetrahedra, "overlap their neighbours"),
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


@pytest.mark.parametrize(("version", "binary"), [(2.2, 0), (2.2, 1), (4.1, 1)])
@pytest.mark.parametrize(("recombine", "order"), [(False, 1), (True, 1), (False, 2), (True, 2)])
def test_surfaces_of_a_body_may_be_drawn_either_way(
    tmp_path: Path, recombine: bool, order: int, version: float, binary: int
) -> None:
    """MSH 2.2 names the physical group of a cell alone, which here has cells of both orientations."""

    def draw() -> None:
        geo = gmsh.model.geo
        points = [geo.addPoint(x, y, 0) for x, y in ((0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (0, 1))]
        lines = [geo.addLine(points[i], points[j]) for i, j in ((0, 1), (1, 4), (4, 5), (5, 0), (1, 2), (2, 3), (3, 4))]
        loops = [lines[0:4], [lines[1], -lines[6], -lines[5], -lines[4]]]  # the second one clockwise
        surfaces = [geo.addPlaneSurface([geo.addCurveLoop(loop)]) for loop in loops]
        for tag in surfaces:
            geo.mesh.setTransfiniteSurface(tag)
            if recombine:
                geo.mesh.setRecombine(2, tag)
        for line in lines:
            geo.mesh.setTransfiniteCurve(line, 4)
        geo.synchronize()
        gmsh.model.addPhysicalGroup(2, surfaces, name="body")
        gmsh.model.mesh.generate(2)
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", binary)

    body = create(MPI.COMM_SELF, saved(tmp_path / "body.msh", draw), MeshSizes(1.0, 1.0, order))
    assert integrate(body, "dx", np.arange(len(body.cell_body))) == pytest.approx(2.0, rel=1e-13)
    assert integrate(body, "ds", exterior_facets(body.mesh)) == pytest.approx(6.0, rel=1e-13)


def test_volumes_may_be_mirrored(tmp_path: Path) -> None:
    def mirrored() -> None:
        CrossedFibers().build(MeshSizes(0.8, 0.8))
        gmsh.model.mesh.affineTransform([-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0])

    body = create(MPI.COMM_SELF, saved(tmp_path / "mirrored.msh", mirrored), MeshSizes(1.0, 1.0))
    other = create(MPI.COMM_SELF, CrossedFibers(), MeshSizes(0.8, 0.8))
    volumes = [integrate(each, "dx", np.arange(len(each.cell_body))) for each in (body, other)]
    assert volumes[0] == pytest.approx(volumes[1], rel=1e-12)


@pytest.mark.parametrize("order", [3, "incomplete"])
def test_cells_of_other_orders_are_read_at_order_1(tmp_path: Path, order: int | str) -> None:
    def draw() -> None:
        if order == "incomplete":
            return incomplete_cells()
        square(recombine=True)
        return gmsh.model.mesh.setOrder(order)

    body = create(MPI.COMM_SELF, saved(tmp_path / "square.msh", draw), MeshSizes(1.0, 1.0))
    assert integrate(body, "dx", np.arange(len(body.cell_body))) == pytest.approx(1.0, rel=1e-13)


@pytest.mark.parametrize(
    "before",
    [b"$Comments\nmade by me: $Nodes, $MeshFormat\n$EndComments\n", b"\n$Comments\r\n\r\n$EndComments\r\n\n", b" \n"],
)
def test_comments_may_come_first(tmp_path: Path, before: bytes) -> None:
    path = write_mesh(tmp_path / "blocks.msh", BLOCKS, binary=0)
    path.write_bytes(before * 2 + path.read_bytes())
    assert read_groups(path) == (2, BLOCKS.bodies(), BLOCKS.facet_groups())


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("version", [2.2, 4.1])
def test_a_group_may_be_named_like_a_section(tmp_path: Path, version: float, binary: int) -> None:
    path = write_mesh(tmp_path / "blocks.msh", BLOCKS, version, binary)
    path.write_bytes(path.read_bytes().replace(b'"upper"', b'"$EndPhysicalNames"'))
    assert read_groups(path)[1] == ("lower", "$EndPhysicalNames")


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
        (b"$MeshFormat\n1 0 8\n$EndMeshFormat\n", "version '1.0'"),
        (b"$MeshFormat\n4 0 8\n$EndMeshFormat\n", "version '4.0'; allowed: 2.2 or 4.1"),
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
