"""Shapes as gmsh meshes them: exact volumes, groups, separate bodies, sound cells, sizes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

import gmsh
import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from piezomat.meshes.body_mesh import arrays_of
from piezomat.meshes.builders import extrude
from piezomat.meshes.builders.structured import Lattice
from piezomat.meshes.gmsh_io import model as gmsh_model
from piezomat.meshes.shapes import (
    Cantilever,
    CrossedFibers,
    FacingHalves,
    FiberArray,
    FiberOnBlock,
    MeshSizes,
    ParallelFibers,
    Shape,
    StackedBlocks,
)
from piezomat.scene.data import Shapes

PI = np.pi
R = 0.5
DISC, HALF, ARC = PI * R**2, 0.5 * PI * R**2, PI * R

# Each shape with the exact measures of its bodies and groups.
CASES: dict[str, tuple[Shape, dict[str, float]]] = {
    "halves": (
        FacingHalves(gap=0.01),
        {"lower": HALF, "upper": HALF, "bottom": 1, "top": 1, "lower_contact": ARC, "upper_contact": ARC},
    ),
    "crossed": (
        CrossedFibers(length=1.5),
        {"lower": 1.5 * HALF, "upper": 1.5 * HALF, "bottom": 1.5, "top": 1.5}
        | {"lower_contact": 1.5 * ARC, "upper_contact": 1.5 * ARC, "lower_ends": DISC, "upper_ends": DISC},
    ),
    "crossed_whole": (
        CrossedFibers(length=1.5, angle=40.0, whole=True),
        {"lower": 1.5 * DISC, "upper": 1.5 * DISC, "bottom": 1.5 * ARC, "top": 1.5 * ARC}
        | {"lower_contact": 1.5 * ARC, "upper_contact": 1.5 * ARC}
        | {"lower_ends": 2 * DISC, "upper_ends": 2 * DISC},
    ),
    "stack_2d": (
        ParallelFibers(count=3),
        {f"fiber_{i}": DISC for i in (1, 2, 3)}
        | {"bottom": ARC, "top": ARC}
        | {"fiber_1_contact": ARC, "fiber_2_contact": 2 * ARC, "fiber_3_contact": ARC},
    ),
    "row_2d": (
        ParallelFibers(arrangement="side_by_side"),
        {"fiber_1": DISC, "fiber_2": DISC, "bottom": ARC, "top": ARC, "left": ARC / 2, "right": ARC / 2}
        | {"fiber_1_contact": ARC / 2, "fiber_2_contact": ARC / 2},
    ),
    "row_3d": (
        ParallelFibers(arrangement="side_by_side", length=0.8),
        {"fiber_1": 0.8 * DISC, "fiber_2": 0.8 * DISC, "bottom": 0.8 * ARC, "top": 0.8 * ARC}
        | {"front": 0.4 * ARC, "back": 0.4 * ARC, "fiber_1_contact": 0.4 * ARC, "fiber_2_contact": 0.4 * ARC}
        | {"fiber_1_ends": 2 * DISC, "fiber_2_ends": 2 * DISC},
    ),
    "on_block_2d": (
        FiberOnBlock(width=1.5, height=0.8),
        {"block": 1.2, "fiber": HALF, "bottom": 1.5, "top": 1, "left": 0.8, "right": 0.8}
        | {"block_contact": 1.5, "fiber_contact": ARC},
    ),
    "on_block_3d": (
        FiberOnBlock(width=1.5, height=0.8, length=0.7),
        {"block": 0.84, "fiber": 0.7 * HALF, "bottom": 1.05, "top": 0.7, "left": 1.2, "right": 1.2}
        | {
            "front": 0.56,
            "back": 0.56,
            "block_contact": 1.05,
            "fiber_contact": 0.7 * ARC,
            "fiber_ends": DISC,
        },
    ),
    "blocks_2d": (
        StackedBlocks(width=2, height=[0.5, 0.7], divisions=[[3, 3], [2, 3]], distortion=0.2, tilt=25.0),
        {"lower": 1, "upper": 1.4, "left": 1.2, "right": 1.2, "bottom": 2, "top": 2}
        | {"lower_contact": 2, "upper_contact": 2}
        | {"lower_left": 0.5, "lower_right": 0.5, "lower_bottom": 2, "lower_top": 2}
        | {"upper_left": 0.7, "upper_right": 0.7, "upper_bottom": 2, "upper_top": 2},
    ),
    "blocks_3d": (
        StackedBlocks(
            height=[0.5, 0.4, 0.3],
            depth=0.6,
            divisions=[[3, 2, 3], [2, 2, 2], [1, 2, 1]],
            distortion=0.2,
            tilt=10.0,
        ),
        {
            "block_1": 0.3,
            "block_2": 0.24,
            "block_3": 0.18,
            "left": 0.72,
            "right": 0.72,
            "front": 1.2,
            "back": 1.2,
        }
        | {"bottom": 0.6, "top": 0.6, "block_1_contact": 0.6, "block_2_contact": 1.2, "block_3_contact": 0.6}
        | {f"block_{i}_{side}": 0.6 for i in (1, 2, 3) for side in ("bottom", "top")}
        | {f"block_{i + 1}_{side}": 0.6 * h for i, h in enumerate((0.5, 0.4, 0.3)) for side in ("left", "right")}
        | {f"block_{i + 1}_{side}": h for i, h in enumerate((0.5, 0.4, 0.3)) for side in ("front", "back")},
    ),
    "cantilever_2d": (
        Cantilever(length=3, layers=[0.2, 0.3, 0.5], divisions=[4, 2]),
        {"layer_1": 0.6, "layer_2": 0.9, "layer_3": 1.5, "root": 1, "tip": 1, "bottom": 3, "top": 3}
        | {"interface_1": 3, "interface_2": 3},
    ),
    "cantilever_3d": (
        Cantilever(length=3, width=2),
        {"layer_1": 3, "layer_2": 3, "root": 2, "tip": 2, "bottom": 6, "top": 6, "front": 3, "back": 3}
        | {"interface_1": 6},
    ),
}
KINDS = [(cells, order) for cells in ("simplex", "tensor") for order in (1, 2)]


@contextmanager
def built(shape: Shape, sizes: MeshSizes) -> Iterator[dict[str, list[int]]]:
    """The shape in the current gmsh model, with the entities of its groups by name."""
    with gmsh_model.session():
        shape.build(sizes)
        dim = shape.dimension
        yield {g.name: list(g.entities) for d in (dim, dim - 1) for g in gmsh_model.groups(d)}


def measure(dim: int, entities: list[int]) -> float:
    """Length, area or volume of entities, by quadrature that is exact for the curved cells used here."""
    total = 0.0
    for entity in entities:
        for found in gmsh_model.elements(dim, entity):
            points, weights = gmsh.model.mesh.getIntegrationPoints(found.type, "Gauss6")
            jacobian = gmsh.model.mesh.getJacobians(found.type, points, entity)[1].reshape(-1, len(weights))
            total += float((np.abs(jacobian) @ weights).sum())
    return total


@pytest.mark.parametrize(("cells", "order"), KINDS)
@pytest.mark.parametrize("name", CASES)
def test_a_shape_has_exact_groups_and_sound_cells(name: str, cells: str, order: int) -> None:
    """One mesh for each shape and kind of cell: its groups, its cells, and the nodes that bodies share."""
    shape, exact = CASES[name]
    with built(shape, MeshSizes(0.4, 0.25, order, cells)) as groups:
        assert_exact_measures(shape, groups, exact, order)
        assert_complete_and_sound_cells(shape, groups, cells, order)
        assert_only_a_cantilever_shares_nodes(shape, groups)


def assert_exact_measures(shape: Shape, groups: dict[str, list[int]], exact: dict[str, float], order: int) -> None:
    round_shape = not isinstance(shape, StackedBlocks | Cantilever)
    dim = shape.dimension
    assert tuple(g.name for g in gmsh_model.groups(dim)) == shape.bodies()
    assert tuple(g.name for g in gmsh_model.groups(dim - 1)) == shape.facet_groups()
    assert set(groups) == set(exact)
    # The chord of an angle a loses a^2 / 24 of an arc and a^2 / 6 of the area, a parabola far less.
    tolerance = 1e-12 if not round_shape else (0.1 if order == 1 else 2e-3)
    for group, value in exact.items():
        found = measure(dim if group in shape.bodies() else dim - 1, groups[group])
        assert found == pytest.approx(value, rel=tolerance), group


def assert_complete_and_sound_cells(shape: Shape, groups: dict[str, list[int]], cells: str, order: int) -> None:
    """Cells of one type with all nodes, not inverted, not flat."""
    nodes = {("simplex", 2): (3, 6), ("simplex", 3): (4, 10), ("tensor", 2): (4, 9), ("tensor", 3): (8, 27)}
    for body in shape.bodies():
        for entity in groups[body]:
            (found,) = gmsh_model.elements(shape.dimension, entity)
            assert found.nodes.shape[1] == nodes[cells, shape.dimension][order - 1]
            assert gmsh.model.mesh.getElementQualities(found.tags, "minDetJac").min() > 0
            assert gmsh.model.mesh.getElementQualities(found.tags, "minSICN").min() > 0.01


def assert_only_a_cantilever_shares_nodes(shape: Shape, groups: dict[str, list[int]]) -> None:
    nodes = []
    for body in shape.bodies():
        found = [e.nodes.ravel() for entity in groups[body] for e in gmsh_model.elements(shape.dimension, entity)]
        nodes.append(set(np.concatenate(found).tolist()))
    for first, second in pairwise(nodes):
        assert bool(first & second) == isinstance(shape, Cantilever)


@pytest.mark.parametrize(("cells", "order"), KINDS)
@pytest.mark.parametrize("shape", [FacingHalves(), CrossedFibers(length=1.0)], ids=str)
def test_volumes_converge_with_the_order_of_the_geometry(shape: Shape, cells: str, order: int) -> None:
    errors = []
    for size in (0.2, 0.1):
        with built(shape, MeshSizes(size, size, order, cells)) as groups:
            errors.append(abs(measure(shape.dimension, groups["lower"]) - HALF))
    # Errors go as size^2 and size^4; numbers of cells are whole, so that halving is not exact.
    assert errors[0] / errors[1] > 0.6 * 4**order


def cell_sizes(groups: dict[str, list[int]], body: str, dim: int) -> tuple[np.ndarray, np.ndarray]:
    """Distance to the origin and longest edge of the cells of a body."""
    tags, x = gmsh_model.nodes()
    position = np.zeros((tags.max() + 1, 3))
    position[tags] = x
    corners = np.concatenate([position[e.nodes] for t in groups[body] for e in gmsh_model.elements(dim, t)])
    edges = corners[:, :, None] - corners[:, None, :]
    return np.linalg.norm(corners.mean(axis=1), axis=1), np.linalg.norm(edges, axis=-1).max(axis=(1, 2))


@pytest.mark.parametrize("cells", ["simplex", "tensor"])
@pytest.mark.parametrize("shape", [FacingHalves(), FiberOnBlock(radius=0.4), ParallelFibers()], ids=str)
def test_cells_are_fine_at_contact_and_coarse_far_off(shape: Shape, cells: str) -> None:
    upper = shape.bodies()[1]
    with built(shape, MeshSizes(0.15, 0.03, 1, cells, {upper: 0.5})) as groups:
        for body, factor in zip(shape.bodies(), (1.0, 0.5), strict=True):
            distance, longest = cell_sizes(groups, body, 2)
            near = longest[distance < 0.1]
            # Corners of a good cell are up to sqrt(2) (a square's diagonal) of its size apart.
            assert 0.6 * factor * 0.03 < near.min() and near.max() < 1.7 * factor * 0.03
            assert longest.max() > 0.7 * factor * 0.15
            assert longest.max() < 2.2 * factor * 0.15


@pytest.mark.parametrize("cells", ["simplex", "tensor"])
def test_crossed_fibers_are_fine_at_their_point_of_contact(cells: str) -> None:
    with built(CrossedFibers(), MeshSizes(0.3, 0.08, 1, cells)) as groups:
        for body in ("lower", "upper"):
            distance, longest = cell_sizes(groups, body, 3)
            assert longest[distance < 0.12].max() < 2.2 * 0.08
            assert longest.max() > 0.3


def test_facing_halves_take_the_expected_number_of_nodes() -> None:
    """15,000 unknowns: two displacements and a potential a node."""
    with built(FacingHalves(), MeshSizes(0.038, 0.008, factors={"upper": 0.9})):
        assert len(gmsh_model.nodes()[0]) == pytest.approx(15_000 / 3, rel=0.1)


def test_crossed_fibers_take_the_expected_number_of_nodes() -> None:
    """20,000 unknowns: three displacements and a potential a node."""
    with built(CrossedFibers(), MeshSizes(0.144, 0.0355, factors={"upper": 0.9})):
        assert len(gmsh_model.nodes()[0]) == pytest.approx(20_000 / 4, rel=0.1)


@pytest.mark.parametrize("cells", ["simplex", "tensor"])
@pytest.mark.parametrize("kind", [FacingHalves, ParallelFibers, FiberOnBlock])
def test_a_node_of_each_body_lies_at_the_place_of_contact(kind: type[Shape], cells: str) -> None:
    gap = 0.02
    with built(kind(gap=gap), MeshSizes(0.5, 0.3, 1, cells)):
        x = gmsh_model.nodes()[1]
        for height in (0.0, gap):
            assert np.linalg.norm(x - [0.0, height, 0.0], axis=1).min() < 1e-12


def test_second_order_nodes_lie_on_the_true_curve() -> None:
    for cells in ("simplex", "tensor"):
        with built(FacingHalves(), MeshSizes(0.4, 0.2, 2, cells)) as groups:
            tags, x = gmsh_model.nodes()
            for body, center in (("lower", -R), ("upper", R)):
                found = [e.nodes for t in groups[f"{body}_contact"] for e in gmsh_model.elements(1, t)]
                on_arc = x[np.isin(tags, np.concatenate(found))]
                np.testing.assert_allclose(np.hypot(on_arc[:, 0], on_arc[:, 1] - center), R, rtol=1e-12)


def test_distortion_moves_inner_nodes_alone_and_always_alike() -> None:
    axes = [np.linspace(0, 1, 4)] * 3
    for tensor in (True, False):
        for order in (1, 2):
            regular = Lattice.box(axes, order, tensor)
            moved = [Lattice.box(axes, order, tensor) for _ in range(2)]
            for lattice in moved:
                lattice.distort(0.2, seed=3)
            np.testing.assert_array_equal(moved[0].points, moved[1].points)
            step = np.abs(moved[0].points - regular.points).max(axis=-1)
            assert 0.1 / 3 < step.max() <= 0.2 / 3
            for axis in range(3):
                assert np.take(step, [0, -1], axis=axis).max() < 1e-15


def test_a_shape_is_chosen_by_its_name_and_checked() -> None:
    shapes = TypeAdapter(Shapes)
    assert shapes.validate_python({"shape": "crossed_fibers", "whole": True}) == CrossedFibers(whole=True)
    for wrong in (
        {"shape": "torus"},
        {"shape": "facing_halves", "length": 2.0},
        {"shape": "facing_halves", "radius": -1.0},
        {"shape": "facing_halves", "gap": float("nan")},
        {"shape": "crossed_fibers", "angle": 180.0},
        {"shape": "parallel_fibers", "count": 1},
        {"shape": "stacked_blocks", "height": [1.0]},
        {"shape": "stacked_blocks", "divisions": [[1, 1]]},
        {"shape": "stacked_blocks", "divisions": [[1, 1], [1, 1, 1]]},
        {"shape": "stacked_blocks", "distortion": 0.9},
        {"shape": "cantilever", "divisions": [5, 1, 1]},
        {"shape": "cantilever", "layers": []},
    ):
        with pytest.raises(ValidationError):
            shapes.validate_python(wrong)


@pytest.mark.parametrize(
    ("shape", "size"),
    [
        (FacingHalves(radius=0.3), 0.3),
        (CrossedFibers(whole=True), 1.0),
        (ParallelFibers(length=0.2), 0.2),
        (FiberOnBlock(height=0.4), 0.4),
        (StackedBlocks(height=[0.2, 1.0]), 0.2),
        (Cantilever(), 0.5),
    ],
    ids=str,
)
def test_size_is_the_least_extent(shape: Shape, size: float) -> None:
    assert shape.size() == size


def test_a_session_leaves_the_callers_gmsh_as_it_was() -> None:
    with gmsh_model.session():
        pass
    assert not gmsh.isInitialized()
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.Binary", 0)
        gmsh.model.add("mine")
        with pytest.raises(RuntimeError), gmsh_model.session():
            raise RuntimeError
        assert gmsh.model.getCurrent() == "mine"
        assert gmsh.option.getNumber("Mesh.Binary") == 0
    finally:
        gmsh.finalize()


@pytest.mark.parametrize("shape", [CrossedFibers, ParallelFibers, FiberOnBlock])
def test_the_unit_of_length_changes_no_cell(shape: type[Shape]) -> None:
    """gmsh's tolerances are lengths: in nm crossed fibers had other tetrahedra, and a force 5 % off."""
    here = arrays_of(shape(radius=0.5), MeshSizes(0.3, 0.15))
    for unit in (1e-3, 1e5):
        lengths = {"radius": 0.5 * unit}
        for name in {"length", "width", "height"} & set(shape.model_fields):
            default = shape.model_fields[name].default
            lengths |= {name: default * unit} if default is not None else {}
        there = arrays_of(shape(**lengths), MeshSizes(0.3 * unit, 0.15 * unit))
        np.testing.assert_array_equal(there.cells, here.cells)
        np.testing.assert_allclose(there.x / unit, here.x, atol=1e-12)


def test_bodies_meshed_one_by_one_are_those_meshed_together(monkeypatch: pytest.MonkeyPatch) -> None:
    shape = FiberArray(arrangement="random", columns=5, rows=4, radius_spread=0.1)
    found = []
    for many in (2, 1000):
        monkeypatch.setattr(extrude, "MANY", many)
        found.append(arrays_of(shape, MeshSizes(0.4, 0.2)))
    alone, together = found
    assert alone.bodies == together.bodies and alone.facet_groups == together.facet_groups
    assert len(alone.facets) == len(together.facets)
    assert len(alone.cells) == pytest.approx(len(together.cells), rel=0.03)
    areas = []
    for mesh in found:
        a, b, c = np.moveaxis(mesh.x[mesh.cells], 1, 0)
        areas.append(np.bincount(mesh.cell_body, np.abs(np.cross(b - a, c - a)) / 2.0))
    assert np.allclose(*areas, rtol=1e-12)  # the outlines are divided alike


@pytest.mark.parametrize("cells", ["simplex", "tensor"])
def test_many_bodies_come_into_gmsh_a_few_at_a_time(cells: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """gmsh looks up all nodes of a model for each entity that gets elements: 3,000 fibers took half an hour."""
    bodies: list[int] = []
    add = gmsh.model.mesh.addElementsByType

    def counted(*arguments: Any) -> None:
        bodies.append(len(gmsh.model.getEntities(2)))
        add(*arguments)

    monkeypatch.setattr(gmsh.model.mesh, "addElementsByType", counted)
    monkeypatch.setattr(extrude, "MANY", 4)
    found = []
    for together in (5, 1000):
        monkeypatch.setattr(extrude, "TOGETHER", together)
        bodies.clear()
        found.append(arrays_of(FiberArray(arrangement="hexagonal", columns=4, rows=3), MeshSizes(0.4, 0.2, 1, cells)))
        assert max(bodies) <= together
    few, all_at_once = found
    assert max(bodies) == 12 and few.bodies == all_at_once.bodies and few.facet_groups == all_at_once.facet_groups
    np.testing.assert_array_equal(few.x, all_at_once.x)
    np.testing.assert_array_equal(few.cells, all_at_once.cells)
    np.testing.assert_array_equal(few.cell_body, all_at_once.cell_body)
    np.testing.assert_array_equal(few.facets, all_at_once.facets)
