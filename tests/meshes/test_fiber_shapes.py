"""Shapes of many fibers: their deposition, meshes and statistics, and scenes with them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError
from scipy.spatial import cKDTree

from piezomat.meshes.body_mesh import arrays_of
from piezomat.meshes.builders.centre_lines import Face, Fiber, crossings, segment_distances
from piezomat.meshes.builders.sizes import MeshSizes
from piezomat.meshes.gmsh_io.extract import Arrays
from piezomat.meshes.gmsh_io.model import MeshError
from piezomat.meshes.shapes import CrossPly, FiberArray, Fibers, Mat
from piezomat.meshes.shapes.deposition import Bed
from piezomat.meshes.shapes.fiber_shape import FiberShape
from piezomat.scene import Scene, SceneError
from piezomat.scene.data import Shapes

KINDS = [("simplex", 1), ("simplex", 2), ("tensor", 1), ("tensor", 2)]
SMALL = {"width": 6.0, "depth": 6.0, "count": 6}
RECIPES: dict[str, FiberShape] = {
    "square": FiberArray(columns=3, rows=2),
    "hexagonal": FiberArray(arrangement="hexagonal", columns=3, rows=2, gap=0.005),
    "random": FiberArray(arrangement="random", columns=3, rows=2, radius_spread=0.2),
    "bundle": FiberArray(arrangement="hexagonal", columns=2, rows=2, length=2.0),
    "plies": CrossPly(angles=[0.0, 60.0], width=5.0, depth=6.0),
    "stiff": Mat(**SMALL),
    "bending": Mat(**SMALL, bend_radius=4.0, radius_spread=0.1),
    "wavy": Mat(**SMALL, wave_length=5.0, wave_amplitude=0.3, alignment=0.5),
    "short": Mat(**SMALL, length=4.0, bend_radius=4.0),
}


@pytest.mark.parametrize("name", RECIPES)
def test_fibers_rest_on_each_other_and_do_not_overlap(name: str) -> None:
    """Every fiber but those on the floor touches one below it, and none goes into another."""
    shape = RECIPES[name]
    found = crossings(shape.fibers, 0.05)
    expected = 0.005 if name == "hexagonal" else 0.0
    touching = found.gap - expected < 1e-6
    assert (found.gap - expected > -1e-6).all()
    on_floor = {i for i, fiber in enumerate(shape.fibers) if fiber.points[:, 2].min() < 1.03 * fiber.radius}
    resting = set(found.fibers[touching].ravel().tolist())
    assert on_floor | resting == set(range(len(shape.fibers)))
    outcome = shape.outcome()
    assert outcome.fibers == len(shape.fibers) and outcome.crossings >= touching.sum() > 0
    assert outcome.smallest_gap == pytest.approx(expected, abs=1e-6)


def test_no_seed_of_a_mat_makes_fibers_overlap() -> None:
    """Mats of thirty fibers that bend: of fifty seeds number 32 takes the most rounds of lifting."""
    box = {"width": 20.8, "depth": 20.8, "length": 6.0}
    for seed in (30, 32, 35):
        gap = Mat(count=30, seed=seed, bend_radius=1.5, **box).outcome().smallest_gap
        assert gap is None or gap > -1e-8, seed


def test_two_crossed_fibers_rest_as_their_radii_say() -> None:
    bed = Bed(None, 0.0)
    bed.lay("a", np.array([[-3.0, 0.0], [3.0, 0.0]]), 0.5)
    upper = bed.lay("b", np.array([[0.0, -3.0], [0.1, 3.0]]), 0.3)
    np.testing.assert_allclose(upper.points[:, 2], 0.5 + 0.5 + 0.3, rtol=1e-9)
    beside = bed.lay("c", np.array([[-3.0, 0.6], [-1.0, 0.6]]), 0.5)
    np.testing.assert_allclose(beside.points[:, 2], 0.5 + np.sqrt(1.0 - 0.36), rtol=1e-9)


def test_a_fiber_bends_no_more_than_it_may() -> None:
    bed = Bed(6.0, 0.0)
    bed.lay("a", np.array([[-9.0, 0.0], [9.0, 0.0]]), 0.5)
    upper = bed.lay("b", np.array([[0.0, -9.0], [0.0, 9.0]]), 0.5)
    s = np.linspace(2.0, upper.length - 2.0, 400)
    slope, bend = upper.curve(s, 1), upper.curve(s, 2)
    curvature = np.linalg.norm(np.cross(slope, bend), axis=1) / np.linalg.norm(slope, axis=1) ** 3
    assert 0.5 / 6.0 < curvature.max() < 1.4 / 6.0
    assert upper.curve(0.0)[2] == pytest.approx(0.5, abs=1e-3) and 1.5 - 1e-9 < upper.points[:, 2].max() < 1.505


@pytest.mark.parametrize("name", RECIPES)
def test_the_same_seed_gives_the_same_fibers(name: str) -> None:
    shape = RECIPES[name]
    again = type(shape)(**shape.model_dump())
    for first, second in zip(shape.fibers, again.fibers, strict=True):
        np.testing.assert_array_equal(first.points, second.points)
    if name in ("random", "stiff", "bending"):
        other = type(shape)(**shape.model_dump() | {"seed": 1})
        assert any(
            len(a.points) != len(b.points) or (a.points != b.points).any()
            for a, b in zip(shape.fibers, other.fibers, strict=True)
        )


def test_measures_of_a_mat_are_met() -> None:
    dense = Mat(width=8.0, depth=8.0, areal_density=2.0).outcome()
    assert 2.0 <= dense.areal_density < 2.0 + 8.0 * np.sqrt(2.0) * np.pi * 0.25 / 64.0
    thick = Mat(width=8.0, depth=8.0, thickness=5.0).outcome()
    assert 5.0 <= thick.high[2] <= 6.0 + 1e-9
    assert Mat(width=8.0, depth=8.0, count=7, alignment=1.0).outcome().orientation == pytest.approx(1.0)
    random = Mat(width=40.0, depth=40.0, count=60, length=10.0).outcome()
    assert abs(random.orientation) < 0.3
    radii = [fiber.radius for fiber in Mat(width=30.0, depth=30.0, count=200, radius_spread=0.3, length=5.0).fibers]
    assert np.mean(radii) == pytest.approx(0.5, rel=0.07) and np.std(radii) == pytest.approx(0.15, rel=0.2)


def test_porosity_and_crossings_of_a_hexagonal_packing() -> None:
    outcome = FiberArray(arrangement="hexagonal", columns=4, rows=3).outcome()
    assert outcome.crossings == 3 * 3 + 2 * 7
    height = 1.0 + np.sqrt(3.0)
    assert outcome.porosity == pytest.approx(1.0 - 12 * np.pi * 0.25 / (4.5 * height))
    assert outcome.high == pytest.approx((4.5, height))


def measures(arrays: Arrays) -> float:
    """Volume of a 3D mesh by the divergence theorem is no use where cells are curved: corners of its cells alone."""
    corners = arrays.x[arrays.cells[:, : 4 if arrays.cell_type == "tetrahedron" else 8]]
    if arrays.cell_type == "tetrahedron":
        return float(np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6.0)
    # Six tetrahedra a brick, whose vertices are numbered with the first axis running fastest.
    paths = [(0, 1, 3, 7), (0, 1, 5, 7), (0, 2, 3, 7), (0, 2, 6, 7), (0, 4, 5, 7), (0, 4, 6, 7)]
    edges = corners[:, [p[1:] for p in paths]] - corners[:, None, :1]
    return float(np.abs(np.linalg.det(edges)).sum() / 6.0)


@pytest.mark.parametrize(("cells", "order"), KINDS)
@pytest.mark.parametrize("name", ["bundle", "bending", "wavy"])
def test_swept_fibers_are_closed_bodies_of_sound_cells(name: str, cells: str, order: int) -> None:
    """Every facet of a cell belongs to two cells or to a group of the surface; the volume is that of the fibers."""
    shape = RECIPES[name]
    arrays = arrays_of(shape, MeshSizes(0.35, 0.3, order, cells))
    assert arrays.bodies == shape.bodies() and arrays.facet_groups == shape.facet_groups()
    if cells == "simplex":
        faces = [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]
        corners = 3
    else:
        faces = [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 4, 5), (2, 3, 6, 7), (0, 2, 4, 6), (1, 3, 5, 7)]
        corners = 4
    every = np.sort(np.concatenate([arrays.cells[:, face] for face in faces]), axis=1)
    unique, count = np.unique(every, axis=0, return_counts=True)
    assert count.max() == 2
    named = np.unique(np.sort(arrays.facets[:, :corners], axis=1), axis=0)
    np.testing.assert_array_equal(unique[count == 1], named)
    assert measures(arrays) == pytest.approx(sum(fiber.volume for fiber in shape.fibers), rel=0.06)


BOXED = {
    "plies": CrossPly(angles=[0.0, 50.0, 110.0], width=5.0, depth=6.0),
    "stiff": Mat(width=9.0, depth=9.0, count=9, seed=1),
    "bending": Mat(width=8.0, depth=8.0, count=8, bend_radius=3.0, radius_spread=0.1),
    "wavy": Mat(width=8.0, depth=8.0, count=6, wave_length=5.0, wave_amplitude=0.2, bend_radius=4.0, seed=2),
}


def flush_ends(shape: FiberShape) -> list[tuple[int, Fiber, int]]:
    """Number of the body, fiber and end (0 or 1) of every end that is flush with a face of the box."""
    ends = [(i, fiber, end) for i, fiber in enumerate(shape.fibers) for end in (0, 1)]
    return [(i, fiber, end) for i, fiber, end in ends if fiber.faces[end] is not None]


def caps(arrays: Arrays, body: int, group: str) -> NDArray[np.int64]:
    """Facets of a group that belong to a body, (m, nodes)."""
    number = arrays.facet_groups.index(group)
    inside = np.array([number in groups for groups in arrays.combinations])[arrays.facet_values]
    mine = np.isin(arrays.facets, arrays.cells[arrays.cell_body == body]).all(axis=1)
    return arrays.facets[inside & mine]


def area(corners: NDArray[np.float64], quads: bool) -> float:
    """Area of flat facets (m, corners, 3), those of quadrilaterals in DOLFINx order."""
    sides = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    if quads:
        sides = corners[:, 3] - corners[:, 0], corners[:, 2] - corners[:, 1]
    return float(0.5 * np.linalg.norm(np.cross(*sides), axis=1).sum())


def with_square_ends(shape: FiberShape) -> FiberShape:
    """The same fibers, where they lie, without the faces that cut their ends."""
    plain = shape.model_copy()
    plain.__dict__["fibers"] = tuple(replace(fiber, faces=(None, None)) for fiber in shape.fibers)
    return plain


@pytest.mark.parametrize(
    ("name", "cells", "order"),
    [(name, *KINDS[(i + shift) % 4]) for i, name in enumerate(BOXED) for shift in (0, 2)],
)
def test_ends_cut_by_the_box_lie_in_its_faces(name: str, cells: str, order: int) -> None:
    """All nodes of a cap lie in the face; its area is that of the section over the cosine, the volume as it was."""
    shape, sizes = BOXED[name], MeshSizes(0.4, 0.3, order, cells)
    arrays, square = arrays_of(shape, sizes), arrays_of(with_square_ends(shape), sizes)
    ends = flush_ends(shape)
    assert len(ends) > 0.7 * 2 * len(shape.fibers)
    for body, fiber, end in ends:
        face, straight = fiber.faces[end], len(fiber.points) == 2
        group = {(0, -1): "left", (0, 1): "right", (1, -1): "front", (1, 1): "back"}[face.axis, face.outside]
        facets = caps(arrays, body, group)
        x = arrays.x[facets]
        assert len(facets) and abs(x[..., face.axis] - face.where).max() < 1e-9
        mine = [replace(a, cells=a.cells[a.cell_body == body]) for a in (arrays, square)]
        beyond = [(face.outside * (a.x[a.cells][..., face.axis] - face.where)).max() for a in mine]
        slope = fiber.at(np.array(end * fiber.length))[1]
        cosine = abs(slope[face.axis]) / np.linalg.norm(slope)
        assert beyond[0] < 1e-9 and (beyond[1] > 0.01 or cosine > 0.99)
        corners = 3 if cells == "simplex" else 4
        found = area(x[:, :corners], cells == "tensor")
        section = area(square.x[caps(square, body, group)][:, :corners], cells == "tensor")
        assert section == pytest.approx(np.pi * fiber.radius**2, rel=0.08)
        assert found == pytest.approx(section / cosine, rel=1e-9 if straight else 0.06)
        assert measures(mine[0]) == pytest.approx(measures(mine[1]), rel=1e-9 if straight else 0.01)


@pytest.mark.parametrize("name", BOXED)
def test_no_node_of_a_fiber_lies_in_another(name: str) -> None:
    """The tips of flush ends keep clear of the other fibers as their sides do."""
    shape = BOXED[name]
    arrays = arrays_of(shape, MeshSizes(0.3, 0.3, 1, "tensor"))
    bent = 0.005 if name in ("bending", "wavy") else 0.0  # centre lines are measured along chords
    for i, fiber in enumerate(shape.fibers):
        first, last = (fiber.overhang(end) if fiber.faces[end] else 0.0 for end in (0, 1))
        tree = cKDTree(fiber.at(np.linspace(-first, fiber.length + last, 4000))[0])
        others = arrays.x[np.unique(arrays.cells[arrays.cell_body != i])]
        for face in filter(None, fiber.faces):
            others = others[face.outside * (others[:, face.axis] - face.where) < 1e-9]
        assert tree.query(others)[0].min() > (1.0 - bent) * fiber.radius - 1e-6


def test_a_fiber_that_grazes_a_face_or_bends_there_keeps_its_square_end() -> None:
    def cut(angle: float, length: float, height: float = 0.0) -> tuple[Face | None, Face | None]:
        a = np.radians(angle)
        plan = length * np.array([[0.0, 0.0], [np.cos(a), np.sin(a)]])
        points = np.column_stack([plan, [0.5, 0.5 + height]])
        return Fiber("a", points, 0.5, (Face(0, 0.0, -1), None)).flush().faces

    face = Face(0, 0.0, -1)
    assert cut(0.0, 4.0) == cut(45.0, 4.0) == cut(69.0, 8.0) == (face, None)
    assert cut(71.0, 8.0) == cut(60.0, 2.0) == cut(69.0, 8.0, 8.0) == (None, None)
    hook = np.array([[0.0, 0.0, 0.5], [0.5, 0.6, 0.5], [1.5, 0.6, 0.5], [4.0, 0.6, 0.5]])
    assert Fiber("a", hook, 0.5, (face, None)).flush().faces == (None, None)
    shape = Mat(width=20.0, depth=20.0, count=18)
    assert len(flush_ends(shape)) == 2 * 18 - 1 and shape.fibers[17].faces[0] is None
    arrays = arrays_of(shape, MeshSizes(0.5, 0.5, 1, "tensor"))
    assert np.ptp(arrays.x[caps(arrays, 17, "left")][..., 0]) > 0.9  # it belongs to the face all the same


def test_a_tip_is_laid_clear_of_the_fiber_beside_it() -> None:
    """Beyond its last section a fiber cut at 60 degrees has a tip, which must rest on what square ends would miss."""
    face = Face(0, 0.0, -1)
    along = np.array([np.cos(np.pi / 3), -np.sin(np.pi / 3)])

    def laid(cut: Face | None) -> Fiber:
        bed = Bed(None, 0.0)
        bed.lay("a", np.array([[0.0, 1.6], [8.0, 1.6]]), 0.5)
        return bed.lay("b", np.array([[0.0, 0.0], 6.0 * along]), 0.5, (cut, None))

    assert laid(None).points[0, 2] == pytest.approx(0.5)
    tip = laid(face)
    assert tip.faces == (face, None)
    np.testing.assert_allclose(tip.cap(0)[1], [0.0, 1.0, 0.0], atol=1e-12)
    assert 0.5 < tip.points[0, 2] < 1.5


def test_a_straight_fiber_of_second_order_has_its_exact_volume() -> None:
    import gmsh

    from piezomat.meshes.gmsh_io import model as gmsh_model

    shape = FiberArray(columns=1, rows=1, length=2.0)
    with gmsh_model.session():
        shape.build(MeshSizes(0.2, 0.2, 2, "tensor"))
        tags = gmsh_model.elements(3, gmsh_model.groups(3)[0].entities[0])[0].tags
        assert gmsh.model.mesh.getElementQualities(tags, "volume").sum() == pytest.approx(np.pi * 0.5, rel=1e-4)


def test_layers_are_close_where_fibers_cross() -> None:
    shape = CrossPly(angles=[0.0, 90.0], spacing=4.0, width=8.0, depth=8.0)
    coarse, fine = (len(arrays_of(shape, MeshSizes(0.5, size, 1, "tensor")).cells) for size in (0.5, 0.25))
    assert fine > 1.5 * coarse


def test_segment_distances_agree_with_a_search(rng: np.random.Generator) -> None:
    a0, a1, b0, b1 = rng.uniform(-1.0, 1.0, (4, 40, 3))
    b1[:5] = b0[:5] + (a1 - a0)[:5]  # parallel
    b1[5:10] = b0[5:10] + 1e-3 * (b1 - b0)[5:10]
    distance, s, t, away = segment_distances(a0, a1, b0, b1)
    share = np.linspace(0.0, 1.0, 401)
    on_a = a0[:, None] + share[:, None] * (a1 - a0)[:, None]
    on_b = b0[:, None] + share[:, None] * (b1 - b0)[:, None]
    for i in range(len(a0)):
        searched = np.linalg.norm(on_a[i][:, None] - on_b[i], axis=2).min()
        assert distance[i] <= searched + 1e-12 and distance[i] == pytest.approx(searched, abs=1e-2)
    here = a0 + s[:, None] * (a1 - a0) - b0 - t[:, None] * (b1 - b0)
    np.testing.assert_allclose(here, away, atol=1e-14)


def test_crossings_are_counted_once_each() -> None:
    line = np.array([[-5.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    across = [Fiber(f"b{x}", np.array([[x, -5.0, 1.01], [x, 5.0, 1.01]]), 0.5) for x in (-2.0, 2.0)]
    beside = Fiber("c", line + [0.0, 1.0, 0.0], 0.5)
    found = crossings([Fiber("a", line, 0.5), *across, beside], 0.02)
    assert found.fibers.tolist() == [[0, 1], [0, 2], [0, 3], [1, 3], [2, 3]]
    np.testing.assert_allclose(found.gap, [0.01, 0.01, 0.0, 0.01, 0.01], atol=1e-12)
    np.testing.assert_allclose(found.along[:2, 0], [3.0, 7.0], atol=1e-9)


TABLE = "fiber, x, y, z, radius\na, 0, 0, 0.5, 0.5\na, 4, 0, 0.5, 0.5\nb, 2, -2, 1.5, 0.5\nb, 2, 2, 1.5, 0.5\n"


def test_fibers_of_a_table(tmp_path: Path) -> None:
    path = tmp_path / "fibers.csv"
    path.write_text(TABLE)
    shape = Fibers(file=path)
    assert shape.bodies() == ("a", "b") and shape.facet_groups() == ("surfaces", "ends")
    assert shape.outcome().crossings == 1 and shape.outcome().smallest_gap == pytest.approx(0.0, abs=1e-12)
    for text, words in {
        "": "lists no fibers",
        "fiber,x,y,z\na,0,0,0\n": "line 2",
        TABLE + "c, 0, 0, nan, 1\n": "line 6",
        TABLE + "c, 0, 0, 0, 1\n": "'c' needs at least two points",
        TABLE + "b, 9, 9, 9, 0.4\n": "more than one radius",
    }.items():
        path.write_text(text)
        with pytest.raises(MeshError, match=words):
            _ = Fibers(file=path).fibers


def scene(tmp_path: Path, **sections: object) -> Scene:
    path = tmp_path / "fibers.csv"
    path.write_text(TABLE)
    table = {
        "geometry": {"shape": "fibers", "file": str(path)},
        "mesh": {"size": 0.5},
        "bodies": {"*": "pvdf"},
        "boundaries": [{"on": "ends", "displacement": [0, 0, 0]}],
    }
    return Scene(**table | sections)


def test_a_pattern_stands_for_bodies(tmp_path: Path) -> None:
    assert scene(tmp_path).material("b").permittivity is not None
    mixed = scene(tmp_path, bodies={"*": "pvdf", "a": "elastic"})
    assert mixed.material("a").permittivity is None and mixed.material("b").permittivity is not None
    again = Scene(**scene(tmp_path).model_dump(mode="json", exclude_none=True))
    assert again.bodies == {"*": "pvdf"} and again.geometry.bodies() == ("a", "b")
    for wrong in ({"*": "pvdf", "ply_*": "pvdf"}, {"a": "pvdf"}):
        with pytest.raises(SceneError):
            scene(tmp_path, bodies=wrong)


def test_a_table_that_is_not_there_is_blamed_on_its_key(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"geometry\.file.*no_such\.csv"):
        scene(tmp_path, geometry={"shape": "fibers", "file": str(tmp_path / "no_such.csv")})


def test_recipes_refuse_what_cannot_be() -> None:
    shapes = TypeAdapter(Shapes)
    for wrong in (
        {"shape": "mat", "count": 3, "thickness": 2.0},
        {"shape": "mat", "wave_amplitude": 1.0},
        {"shape": "mat", "wave_amplitude": 1.0, "wave_length": 2.0},
        {"shape": "mat", "bend_radius": 0.6},
        {"shape": "mat", "width": 2.0},
        {"shape": "mat", "length": 11.0},
        {"shape": "mat", "alignment": 1.1},
        {"shape": "mat", "seed": -1},
        {"shape": "cross_ply", "spacing": 0.9},
        {"shape": "cross_ply", "angles": []},
        {"shape": "fiber_array", "columns": 0},
        {"shape": "fiber_array", "arrangement": "cubic"},
        {"shape": "fibers"},
    ):
        with pytest.raises(ValidationError):
            shapes.validate_python(wrong)
    with pytest.raises(MeshError, match="no fiber"):
        _ = CrossPly(width=1.5, depth=1.5).fibers
