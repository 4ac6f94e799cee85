"""Smoothed facets: a surface through the nodes with a continuous normal, and the derivatives of contact on it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.forms.contact.facets import facet_kind
from piezomat.forms.contact.gap import point_normals
from piezomat.forms.contact.smoothing import rounded, spread
from piezomat.meshes.body_mesh import Partition, create
from piezomat.meshes.contact.nodal_normals import smoothed
from piezomat.meshes.contact.surface import Surface, body_facets, surface
from piezomat.meshes.shapes import CrossedFibers, MeshSizes, Shape, StackedBlocks
from piezomat.scene import Scene, SceneError
from piezomat.simulation import run
from scripts.studies.stability_maps import around, ripple
from scripts.studies.stability_methods import Method
from tests.scenes import press
from tests.verification.test_ranks import strips
from tests.verification.test_segment_patch import patch, stress_error

RADIUS = 0.5


def surface_of(shape: Shape, cells: Any, comm: MPI.Comm, partition: Partition | None = None) -> Surface:
    """The smoothed outside of the first body of a shape."""
    bodies = create(comm, shape, MeshSizes(0.25, 0.12, 1, cells), partition=partition)
    space = fenicsx.lagrange(bodies.mesh, 1, bodies.mesh.geometry.dim)
    return smoothed(space, surface(space, "", body_facets(space, bodies.cell_body, 0), 1))


def closed(x: Array) -> Surface:
    """The smoothed outside of a closed polygon with corners x (n, 2), counter-clockwise, on one rank."""
    n = len(x)
    nodes = np.stack([np.arange(n), np.roll(np.arange(n), -1)], axis=1)
    flat = Surface("", facet_kind("line2"), nodes.astype(np.int32), x[nodes], np.ones(n), np.arange(n), nodes[:, 0], x)

    class Space:
        """The attributes of a space that `smoothed` uses."""

        class mesh:
            comm = MPI.COMM_SELF

        class dofmap:
            class index_map:
                local_to_global = staticmethod(lambda nodes: nodes)

    return smoothed(Space, flat)


def ends(group: Surface) -> tuple[Array, Array]:
    """Normals of each facet at the end of the facet before and at its own beginning."""
    xi = np.ones((len(group), 1))
    last, first = (point_normals(group.kind, s * xi, group.reference, group.orientation) for s in (1.0, 0.0))
    return np.roll(last, 1, axis=0), first


def test_the_normal_is_continuous_where_curvature_changes() -> None:
    """An ellipse, unevenly divided: the polygon's normals jump by 0.3, those of the smoothed one by rounding."""
    angle = np.linspace(0.0, 2.0 * np.pi, 37)[:-1]
    angle = angle + 0.3 * np.sin(3.0 * angle) / 3.0
    group = closed(np.stack([1.3 * np.cos(angle), np.sin(angle)], axis=1))
    before, after = ends(group)
    np.testing.assert_allclose(before, after, atol=1e-10)
    flat = point_normals(facet_kind("line2"), np.zeros((36, 1)), group.reference[:, :2], group.orientation)
    assert np.abs(flat - np.roll(flat, 1, axis=0)).max() > 0.2


def test_the_smoothed_circle_is_a_circle() -> None:
    """24 facets of unequal length: nodes are on it, the middle of facets 150 times nearer to it than chords are."""
    angle = np.linspace(0.0, 2.0 * np.pi, 25)[:-1]
    angle = angle + 0.2 * np.sin(2.0 * angle) / 2.0
    group = closed(RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    np.testing.assert_array_equal(group.reference[:, 0], RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    middle = np.linalg.norm(group.reference[:, 2], axis=1)
    chord = np.linalg.norm(group.reference[:, :2].mean(axis=1), axis=1)
    assert np.abs(middle - RADIUS).max() < np.abs(chord - RADIUS).max() / 150.0


def test_the_smoothed_circle_turns_and_moves_with_its_corners(rng: np.random.Generator) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 13)[:-1]
    group = closed(np.stack([np.cos(angle), 0.7 * np.sin(angle)], axis=1))
    c, s = np.cos(1.0), np.sin(1.0)
    turn, shift = np.array([[c, s], [-s, c]]), rng.normal(size=2)
    moved = rounded(group.kind, group.reference[:, :2] @ turn + shift, group.rounding)
    np.testing.assert_allclose(moved, group.reference @ turn + shift, atol=1e-14)


@pytest.mark.parametrize("cells", ["simplex", "tensor"])
def test_fibers_in_three_dimensions_become_round(cells: str) -> None:
    """Added nodes on the round side: ten times nearer to the cylinder than those of flat facets; edges stay sharp."""
    group = surface_of(CrossedFibers(radius=RADIUS, length=0.8), cells, MPI.COMM_SELF)
    corners = group.nodes.shape[1]
    flat = rounded(group.kind, group.reference[:, :corners], 0.0 * group.rounding)[:, corners:]
    round_side = np.linalg.norm(group.reference[:, :corners, 1:] - [0.0, -RADIUS], axis=2).min(axis=1) > RADIUS - 1e-6
    inner = round_side & (group.reference[:, :corners, 2].min(axis=1) > -0.9 * RADIUS)
    inner &= np.abs(group.reference[:, :corners, 0]).max(axis=1) < 0.4 - 1e-6
    assert inner.sum() > 10
    off = [
        np.abs(np.linalg.norm(x[inner][:, :, 1:] - [0.0, -RADIUS], axis=2) - RADIUS).max()
        for x in (group.reference[:, corners:], flat)
    ]
    assert off[0] < 0.1 * off[1]
    np.testing.assert_allclose(group.rounding[~round_side], 0.0, atol=1e-12)


def test_the_potential_stays_linear_between_the_corners() -> None:
    values, offsets = np.array([[1.0, 3.0, 5.0]]), np.zeros((1, 3, 3))
    np.testing.assert_allclose(spread(facet_kind("tri6"), values, offsets), [[1, 3, 5, 4, 3, 2]])


@pytest.mark.mpi
@pytest.mark.parametrize("cells", ["simplex", "tensor"])
@pytest.mark.parametrize("shape", [CrossedFibers(length=0.8), StackedBlocks(divisions=[[4, 2], [3, 2]])])
def test_smoothed_surfaces_do_not_depend_on_the_ranks(shape: Shape, cells: str, comm: MPI.Comm) -> None:
    found, alone = surface_of(shape, cells, comm, strips), surface_of(shape, cells, MPI.COMM_SELF)
    place = np.searchsorted(np.sort(alone.key), found.key)
    np.testing.assert_allclose(found.reference, alone.reference[np.argsort(alone.key)][place], atol=1e-14)
    if isinstance(shape, StackedBlocks):
        np.testing.assert_allclose(found.rounding, 0.0, atol=1e-14)


def pressed(method: str, geometry: dict[str, Any], kinematics: str, **contact: Any) -> Scene:
    dim = 3 if geometry["shape"] == "crossed_fibers" else 2
    return press(
        geometry,
        mesh={"size": 0.4, "contact_size": 0.15},
        model={"kinematics": kinematics},
        bodies={"lower": "pvdf", "upper": "pvdf"},
        boundaries=[
            {"on": "bottom", "displacement": [0.0] * dim, "potential": 0.0},
            {"on": "top", "displacement": [0.0] * (dim - 1) + [-0.03], "follows": "press"},
        ],
        contact={"method": method, "smoothing": True, **contact},
        load={"steps": [1], "factors": {"press": [1.0]}},
    )


PLACES = [("plane", "node"), ("plane", "point"), ("plane", "segment"), ("space", "node"), ("space", "point")]


@pytest.mark.parametrize(("name", "method"), [*PLACES, ("planes", "point")])
def test_tangent_is_the_derivative_of_the_residual(name: str, method: str, rng: np.random.Generator) -> None:
    """Contact's product with a random change of state, against differences of its residual."""
    geometry = {"shape": "crossed_fibers", "length": 0.8} if name == "space" else {"shape": "facing_halves"}
    scene = pressed(method, geometry, "small")
    if name == "planes":
        scene = Scene(**{**scene.model_dump(), "planes": [{"name": "lid", "point": [0.0, 0.06], "normal": [0, -1.0]}]})
    finished = run(scene, MPI.COMM_SELF)
    contact, x = finished.contact, finished.problem.state.copy()
    contact.detect(x, 0.1)
    change = x.duplicate()
    change.array[:] = rng.normal(size=len(change.array_r))
    contact.evaluate(x, tangent=False)
    contact.linearize(x)
    product, difference = x.duplicate(), x.duplicate()
    product.set(0.0)
    difference.set(0.0)
    contact.add_product(change, product)
    step = 1e-7
    for sign in (1.0, -1.0):
        residual = x.duplicate()
        residual.set(0.0)
        contact.add_residual(x + sign * step * change, residual)
        difference.axpy(sign / (2.0 * step), residual)
    assert product.norm() > 1.0
    assert (difference - product).norm() < 1e-5 * product.norm()


def test_a_fiber_slides_smoothly_round_a_coarse_stiff_one() -> None:
    """Ripple of the normal force a third at most, catching of corners a fifth at most of what they are with facets."""
    flat, smooth = (
        ripple(run(around(Method("", {"method": "point", "smoothing": smoothing}), 24, 100.0, steps=16), MPI.COMM_SELF))
        for smoothing in (False, True)
    )
    assert smooth[0] < flat[0] / 3.0
    assert smooth[1] < flat[1] / 5.0


def test_flat_faces_stay_flat() -> None:
    """The patch test is passed as without smoothing: edges of blocks are sharp."""
    scene = patch(([3, 2], [2, 1]), "simplex", 1, 2, 20.0)
    scene = Scene(**{**scene.model_dump(), "contact": {"method": "segment", "normal_penalty": 1e9, "smoothing": True}})
    assert stress_error(scene, MPI.COMM_SELF, 20.0) < 1e-10


def test_what_is_round_already_or_would_have_to_turn_is_refused() -> None:
    given = pressed("point", {"shape": "crossed_fibers"}, "small").model_dump()
    with pytest.raises(SceneError, match=r"contact.smoothing.*mesh.order = 2"):
        Scene(**{**given, "mesh": {"size": 0.4, "order": 2}})
    with pytest.raises(SceneError, match=r"contact.smoothing.*small"):
        Scene(**{**given, "model": {"kinematics": "finite"}})
