"""Local search: the fast search against that of every point among all facets, on one rank and across ranks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from piezomat.contact.setup import interfaces_of
from piezomat.discretization.model import Model
from piezomat.forms.arrays import Array
from piezomat.forms.contact.facets import FacetKind, Facets, facet_kind
from piezomat.forms.contact.gap import point_normals
from piezomat.meshes.body_mesh import create
from piezomat.meshes.contact.facet_bounds import near_points
from piezomat.meshes.contact.global_search import (
    MASTER,
    ONE_TO_ONE,
    SEARCH_CLUSTER,
    SLAVE,
    Clusters,
    GhostFacets,
    share_facets,
)
from piezomat.meshes.contact.local_search import END_TOLERANCE, brute_force_facets, closest_facets
from piezomat.scene import Scene
from tests.facets import KINDS, rotation

RADIUS = 0.5
each_kind = pytest.mark.parametrize("name", KINDS)


def sheet(kind: FacetKind, place: Callable[..., Array], *breaks: Array) -> Array:
    """Facets (f, n, d) between breaks along each parameter, at place(*parameters) -> (n, d)."""
    facets = []
    for cell in np.ndindex(*(len(b) - 1 for b in breaks)):
        ends = [(b[i], b[i + 1]) for b, i in zip(breaks, cell, strict=True)]
        halves = (kind.nodes, 1.0 - kind.nodes) if kind.dim == 2 and kind.simplex else (kind.nodes,)
        for nodes in halves:
            facets.append(place(*(a + (b - a) * nodes[:, i] for i, (a, b) in enumerate(ends))))
    return np.array(facets)


def outward(kind: FacetKind, facets: Array, inside: Callable[[Array], Array]) -> Array:
    """Orientations that turn the normals away from the point inside(centre) of each facet."""
    middle = np.tile(kind.middle, (len(facets), 1))
    center = np.einsum("mk,mkd->md", kind.shape(middle), facets)
    normal = point_normals(kind, middle, facets, np.ones(len(facets)))
    return np.where(np.einsum("md,md->m", normal, center - inside(center)) > 0.0, 1.0, -1.0)


def graded(low: float, high: float, count: int, ratio: float, rng: np.random.Generator) -> Array:
    """Breaks whose spacing grows about as a geometric sequence."""
    steps = np.geomspace(1.0, ratio, count) * rng.uniform(0.7, 1.4, count)
    return low + (high - low) * np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum()


class Fiber:
    """Upper half of a fiber about the x axis (2D: its section), its facets graded and shuffled."""

    def __init__(self, name: str, rng: np.random.Generator, around: Array, along: Array) -> None:
        self.kind = kind = facet_kind(name)
        self.length = along[-1]
        if kind.dim == 1:
            facets = sheet(kind, lambda a: RADIUS * np.stack([np.sin(a), np.cos(a)], axis=1), around)
            self.axis = np.zeros(2)
        else:
            facets = sheet(
                kind,
                lambda a, x: np.stack([x, RADIUS * np.sin(a), RADIUS * np.cos(a)], axis=1),
                around,
                along,
            )
            self.axis = np.array([1.0, 0.0, 0.0])
        self.facets = rng.permutation(facets)
        self.orientation = outward(kind, self.facets, lambda c: c * self.axis)
        self.key = rng.permutation(len(facets))

    def points(self, rng: np.random.Generator, count: int, low: float, high: float) -> tuple[Array, Array]:
        """Points over all the fiber and a little past its ends, low to high above it, and rough normals to it."""
        angle = rng.uniform(-0.55 * np.pi, 0.55 * np.pi, count)
        height = rng.uniform(low, high, count) * rng.choice([1.0, 0.1, 0.01], count)
        radial = np.stack([np.sin(angle), np.cos(angle)], axis=1)
        points = (RADIUS + height)[:, None] * radial
        if self.kind.dim == 2:
            radial = np.column_stack([np.zeros(count), radial])
            points = np.column_stack([rng.uniform(-0.05, 1.05, count) * self.length, points])
        normals = -radial + 0.3 * rng.standard_normal(radial.shape)
        return points, normals / np.linalg.norm(normals, axis=1)[:, None]

    def closest(self, points: Array, normals: Array, depth: float = np.inf) -> NDArray[np.int64]:
        return closest_facets(
            points, normals, Facets(self.kind, self.facets, self.orientation, self.key), 2.0 * RADIUS, depth
        )[0]

    def brute(self, points: Array, normals: Array, depth: float = np.inf) -> NDArray[np.int64]:
        return brute_force_facets(points, normals, Facets(self.kind, self.facets, self.orientation, self.key), depth)


# --- Closest facets -------------------------------------------------------------------------------


@each_kind
@pytest.mark.parametrize("ratio", [1.0, 20.0])
def test_closest_is_that_of_all(name: str, ratio: float, rng: np.random.Generator) -> None:
    """Even and graded fibers, points above and below the surface and past its ends."""
    around = graded(-0.5 * np.pi, 0.5 * np.pi, 10, ratio, rng)
    fiber = Fiber(name, rng, around, graded(0.0, 2.0 * RADIUS, 5, ratio**0.5, rng))
    points, normals = fiber.points(rng, 40, -0.06, 0.1)
    for depth in (np.inf, 0.02):
        found = fiber.closest(points, normals, depth)
        np.testing.assert_array_equal(found, fiber.brute(points, normals, depth))
        assert (found >= 0).sum() > 20 and (found < 0).any()


@pytest.mark.parametrize("name", ["tri3", "tri6", "quad4", "quad9"])
@pytest.mark.parametrize("aspect", [5.0, 50.0])
def test_elongated_facets_are_found(name: str, aspect: float, rng: np.random.Generator) -> None:
    """The nearest centres are not those of the nearest facets where these are long and narrow."""
    around = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 25)
    along = np.arange(4) * aspect * (around[1] - around[0]) * RADIUS
    fiber = Fiber(name, rng, around, along)
    points, normals = fiber.points(rng, 50, -0.02, 0.06)
    found = fiber.closest(points, normals)
    np.testing.assert_array_equal(found, fiber.brute(points, normals))
    inside = np.all(points[:, :1] > 0.0, axis=1) & (points[:, 0] < fiber.length) & (points[:, 2] > 0.05)
    assert (found[inside] >= 0).all()


@each_kind
def test_the_closest_facet_is_where_the_point_is(name: str, rng: np.random.Generator) -> None:
    """On a flat strip: the facet under the point, and the place in it."""
    kind = facet_kind(name)
    breaks = graded(0.0, 1.0, 6, 4.0, rng)
    facets = sheet(kind, lambda *a: np.stack([*a, 0.0 * a[0]], axis=1), *[breaks] * kind.dim)
    d = kind.dim + 1
    up = np.eye(d)[-1]
    orientation = outward(kind, facets, lambda c: c - up)
    under = rng.uniform(0.01, 0.99, (50, kind.dim))
    points = np.column_stack([under, rng.uniform(-0.02, 0.2, 50)])
    found, where, _ = closest_facets(
        points, np.tile(-up, (50, 1)), Facets(kind, facets, orientation, np.arange(len(facets))), 1.0
    )
    np.testing.assert_allclose(
        np.einsum("mk,mkd->md", kind.shape(where), facets[found]), np.column_stack([under, np.zeros(50)]), atol=1e-12
    )
    assert kind.overshoot(where).max() <= 1e-9


@each_kind
def test_points_off_the_ends_meet_nothing(name: str) -> None:
    """A point may slide off by END_TOLERANCE of a facet, no further."""
    kind = facet_kind(name)
    breaks = np.linspace(0.0, 1.0, 5)
    facets = sheet(kind, lambda *a: np.stack([*a, 0.0 * a[0]], axis=1), *[breaks] * kind.dim)
    up = np.eye(kind.dim + 1)[-1]
    orientation = outward(kind, facets, lambda c: c - up)
    off = 0.25 * END_TOLERANCE * np.array([0.5, 0.99, 1.01, 2.0, 30.0])
    points = np.full((5, kind.dim + 1), 0.6)
    points[:, 0], points[:, -1] = 1.0 + off, 0.01
    normals, master = np.tile(-up, (5, 1)), Facets(kind, facets, orientation, np.arange(len(facets)))
    found, *_ = closest_facets(points, normals, master, 1.0)
    np.testing.assert_array_equal(found >= 0, [True, True, False, False, False])
    # Nor do points far above, at less than a right angle, or without a facet that faces them.
    points[:, 0] = 0.6
    assert (closest_facets(points, normals, master, 1.0)[0] >= 0).all()
    assert (closest_facets(points + 3.0 * up, normals, master, 1.0)[0] < 0).all()
    assert (closest_facets(points, -normals, master, 1.0)[0] < 0).all()
    assert (closest_facets(points, np.roll(normals, 1, axis=1), master, 1.0)[0] < 0).all()


@each_kind
def test_nothing_meets_the_far_side_of_a_thin_body(name: str, rng: np.random.Generator) -> None:
    """A plate thinner than its facets: from above only its upper side is met, from below only its lower."""
    kind, thickness = facet_kind(name), 0.1
    breaks, d = np.linspace(0.0, 1.0, 4), kind.dim + 1
    up = np.eye(d)[-1]
    sides = [
        sheet(kind, lambda *a, z=z: np.stack([*a, 0.0 * a[0] + z], axis=1), *[breaks] * kind.dim)
        for z in (0.0, -thickness)
    ]
    facets = np.concatenate(sides)
    orientation = outward(kind, facets, lambda c: c * (1.0 - up) - 0.5 * thickness * up)
    key = np.arange(len(facets))
    under = rng.uniform(0.05, 0.95, (40, kind.dim))
    for height in (0.05, 0.0, -0.01):
        points = np.column_stack([under, np.full(40, height)])
        for normal, expected in ((-up, height > -thickness), (up, False)):
            normals = np.tile(normal, (40, 1))
            found, *_ = closest_facets(points, normals, Facets(kind, facets, orientation, key), 1.0, 0.5 * thickness)
            assert (found >= 0).all() == expected
            assert (found < len(sides[0])).all()
    # From below the same, upside down.
    points = np.column_stack([under, np.full(40, -thickness - 0.02)])
    found, *_ = closest_facets(
        points, np.tile(up, (40, 1)), Facets(kind, facets, orientation, key), 1.0, 0.5 * thickness
    )
    assert (found >= len(sides[0])).all()


@each_kind
def test_ties_do_not_depend_on_the_order_of_facets(name: str, rng: np.random.Generator) -> None:
    """A point above a node or an edge belongs to the facet with the lowest key of those that share it."""
    kind = facet_kind(name)
    breaks = np.linspace(0.0, 1.0, 6)
    turn = rotation(kind.dim + 1, rng)
    facets = sheet(kind, lambda *a: np.stack([*a, 0.0 * a[0]], axis=1) @ turn.T, *[breaks] * kind.dim)
    up = turn[:, -1]
    orientation = outward(kind, facets, lambda c: c - up)
    key = rng.permutation(len(facets))
    nodes = facets.reshape(-1, kind.dim + 1)
    nodes = nodes[np.unique(nodes.round(9), axis=0, return_index=True)[1]]
    for height in (0.03, -0.01, 0.0):
        points = nodes + height * up
        normals = np.tile(-up, (len(points), 1))
        sharing = np.linalg.norm(facets[:, :, None] - nodes, axis=3).min(axis=1) < 1e-6
        lowest = np.where(sharing, key[:, None], len(key)).min(axis=0)
        for _ in range(3):
            order = rng.permutation(len(facets))
            found, *_ = closest_facets(
                points, normals, Facets(kind, facets[order], orientation[order], key[order]), 1.0
            )
            np.testing.assert_array_equal(key[order][found], lowest)


def test_point_above_a_ridge_is_kept_by_the_larger_facet() -> None:
    """It is as far from both; by the small one's measure it is off its end."""
    kind = facet_kind("line2")
    nodes = np.array([[[-1.0, -0.3], [0.0, 0.0]], [[0.0, 0.0], [0.02, -0.01]]])
    orientation = outward(kind, nodes, lambda c: c - np.array([0.0, 1.0]))
    point, normal = np.array([[0.0, 0.05]]), np.array([[0.0, -1.0]])
    for key in ([0, 1], [1, 0]):
        found, *_ = closest_facets(point, normal, Facets(kind, nodes, orientation, np.array(key)), 1.0)
        assert found[0] == 0


def test_no_points_and_no_facets() -> None:
    for name in KINDS:
        kind = facet_kind(name)
        d = kind.dim + 1
        some, none = np.zeros((3, d)), np.zeros((0, len(kind.nodes), d))
        found, where, _ = closest_facets(some, some, Facets(kind, none, np.zeros(0), np.zeros(0, int)), 1.0)
        assert (found == -1).all() and where.shape == (3, kind.dim)
        assert not near_points(some, none, 1.0).any()
        facets = sheet(kind, lambda *a: np.stack([*a, 0.0 * a[0]], axis=1), *[np.array([0.0, 1.0])] * kind.dim)
        one = np.ones(len(facets))
        found, where, _ = closest_facets(some[:0], some[:0], Facets(kind, facets, one, np.arange(len(facets))), 1.0)
        assert found.shape == (0,) and where.shape == (0, kind.dim)
        assert near_points(some[:0], facets, 1.0).shape == (0,)
        assert boxes(none).shape == (0, 2, d)


def boxes(facets: Array, size: int = SEARCH_CLUSTER) -> Array:
    """Boxes (b, 2, d) around clusters of facets of one body."""
    return Clusters.of(facets.min(axis=1), facets.max(axis=1), np.zeros(len(facets), np.int64), size).boxes


# --- What is near ---------------------------------------------------------------------------------


def sampled(kind: FacetKind, facets: Array) -> Array:
    """Points (f, s, d) all over each facet."""
    steps = np.linspace(0.0, 1.0, 9)
    xi = np.stack(np.meshgrid(*[steps] * kind.dim), axis=-1).reshape(-1, kind.dim)
    return np.einsum("sk,fkd->fsd", kind.shape(xi[kind.overshoot(xi) <= 1e-12]), facets)


@each_kind
def test_near_points_misses_none(name: str, rng: np.random.Generator) -> None:
    fiber = Fiber(name, rng, graded(-0.5 * np.pi, 0.5 * np.pi, 10, 20.0, rng), graded(0.0, 1.0, 3, 3.0, rng))
    points = rng.uniform(-1.5, 1.5, (600, fiber.kind.dim + 1))
    places = sampled(fiber.kind, fiber.facets).reshape(-1, points.shape[1])
    distance, _ = cKDTree(places).query(points)
    size = np.linalg.norm(np.ptp(fiber.facets, axis=1), axis=1).max()
    for margin in (0.0, 0.05, 0.4):
        near = near_points(points, fiber.facets, margin)
        assert near[distance <= margin].all()
        assert not near[distance > margin + 2.0 * size].any()
    assert (distance <= 0.4).any() and (distance > 0.4 + 2.0 * size).any()


@each_kind
def test_boxes_hold_all_facets(name: str, rng: np.random.Generator) -> None:
    fiber = Fiber(name, rng, np.linspace(-1.5, 1.5, 40), np.linspace(0.0, 1.0, 8))
    found = boxes(fiber.facets)
    held = np.all(
        (fiber.facets[:, None] >= found[:, 0, None]) & (fiber.facets[:, None] <= found[:, 1, None]), axis=(2, 3)
    )
    assert held.any(axis=1).all()
    assert len(found) >= len(fiber.facets) / SEARCH_CLUSTER
    assert len(boxes(fiber.facets, len(fiber.facets))) == 1
    assert len(boxes(fiber.facets, 1)) == len(fiber.facets)


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["line3", "tri3", "quad9"])
@pytest.mark.parametrize("uneven", [False, True])
def test_every_rank_sees_the_facets_near_its_own(
    name: str, uneven: bool, comm: MPI.Comm, rng: np.random.Generator
) -> None:
    """All that come within the margin of its slave facets, from every rank once; also if ranks have none."""
    kind = facet_kind(name)
    around, along = graded(-1.5, 1.5, 24, 10.0, rng), graded(0.0, 1.0, 4, 2.0, rng)
    master, slave = Fiber(name, rng, around, along), Fiber(name, rng, around[::-1], along)
    offset = np.zeros(kind.dim + 1)
    offset[-1] = 0.03
    slaves = slave.facets + offset
    parts = 1 if uneven else comm.size  # all on one rank, or spread by angle and at random
    slave_rank = np.minimum((slaves.mean(axis=1)[:, -2] + 0.5) * parts, parts - 1).astype(int)
    master_rank = rng.integers(0, parts, len(master.facets))
    mine, theirs = slaves[slave_rank == comm.rank], master_rank == comm.rank
    numbers = np.arange(len(master.facets))[:, None] * 100 + np.arange(len(kind.nodes))
    component, flat = np.full(theirs.sum(), MASTER), master.facets[theirs, :0]
    own = GhostFacets(numbers[theirs], master.orientation[theirs], master.key[theirs], component, component, flat)
    for margin in (0.05, 0.3):
        visible = share_facets(comm, mine, np.full(len(mine), SLAVE), own, master.facets[theirs], margin, ONE_TO_ONE)
        seen = visible.nodes[:, 0] // 100
        assert len(np.unique(seen)) == len(seen) == len(visible)
        np.testing.assert_array_equal(visible.nodes, numbers[seen])
        np.testing.assert_array_equal(visible.orientation, master.orientation[seen])
        np.testing.assert_array_equal(visible.key, master.key[seen])
        if not len(mine):
            assert not len(visible)
            continue
        distance = cKDTree(sampled(kind, mine).reshape(-1, kind.dim + 1)).query(sampled(kind, master.facets))[0]
        distance = distance.min(axis=1)
        assert np.isin(np.flatnonzero(distance <= margin), seen).all()
        # And not everything: what is far from the box of all its slaves stays where it is.
        low, high = mine.min(axis=(0, 1)) - margin, mine.max(axis=(0, 1)) + margin
        reach = np.all((master.facets.min(axis=1) <= high) & (master.facets.max(axis=1) >= low), axis=1)
        assert reach[seen].all()


@pytest.mark.mpi
@pytest.mark.parametrize("name", ["line2", "tri3"])
def test_pairing_does_not_depend_on_the_ranks(name: str, comm: MPI.Comm, rng: np.random.Generator) -> None:
    """The master facet of each point, by key, is that of a search among all facets."""
    kind = facet_kind(name)
    around, along = np.linspace(-1.2, 1.2, 30), np.linspace(0.0, 1.0, 6)
    master = Fiber(name, rng, around, along)
    points, normals = master.points(rng, 200, -0.02, 0.04)
    facets = np.repeat(points[:, None], len(kind.nodes), axis=1)  # each point is a tiny slave facet
    alone = master.closest(points, normals)
    mine = np.flatnonzero(rng.integers(0, comm.size, len(points)) == comm.rank)
    theirs = rng.integers(0, comm.size, len(master.facets)) == comm.rank
    numbers = np.arange(len(master.facets))[:, None] + np.zeros(len(kind.nodes), int)
    component, flat = np.full(theirs.sum(), MASTER), master.facets[theirs, :0]
    own = GhostFacets(numbers[theirs], master.orientation[theirs], master.key[theirs], component, component, flat)
    visible = share_facets(comm, facets[mine], np.full(len(mine), SLAVE), own, master.facets[theirs], 0.05, ONE_TO_ONE)
    positions = master.facets[visible.nodes[:, 0]]
    found, *_ = closest_facets(
        points[mine], normals[mine], Facets(kind, positions, visible.orientation, visible.key), 0.05
    )
    partner = np.where(found >= 0, visible.nodes[found, 0] if len(visible) else -1, -1)
    np.testing.assert_array_equal(partner, alone[mine])
    assert comm.allreduce(int((partner >= 0).sum())) > 100


# --- Whole bodies ---------------------------------------------------------------------------------


@pytest.mark.mpi
@pytest.mark.parametrize(("dim", "cells"), [(2, "simplex"), (2, "tensor"), (3, "simplex"), (3, "tensor")])
@pytest.mark.parametrize("method", ["point", "node"])
def test_overlap_of_coarse_blocks_is_what_it_is(dim: int, cells: str, method: str, comm: MPI.Comm) -> None:
    """Blocks of one cell each, all their sides searched: no false contact of far faces at the sides and behind."""
    for gap, overlap in ((0.0, 0.0), (0.05, 0.0), (-0.01, 0.01)):
        geometry = {"shape": "stacked_blocks", "gap": gap, "divisions": [[1] * dim] * 2, "height": [0.5, 0.25]}
        scene = Scene(
            geometry=geometry | ({"depth": 1.0} if dim == 3 else {}),
            mesh={"order": 1, "cells": cells, "size": 1.0},
            bodies={"lower": "elastic", "upper": "elastic"},
            boundaries=[{"on": "bottom", "displacement": [0.0] * dim}],
            contact={"method": method},
        )
        model = Model(scene, create(comm, scene.geometry, scene.sizes))
        contact = interfaces_of(model)
        state = model.new_vector()
        contact.detect(state, max(contact.least_search_radius(), 2.0))
        contact.evaluate(state, tangent=False)
        assert contact.penetration() == pytest.approx(overlap, abs=1e-12)
        # The points on the faces that meet are all there, and no others.
        met = comm.allreduce(sum(float(p.points.weight[p.projected_points].sum()) for p in contact.surface_pairs))
        assert met == pytest.approx(2.0, rel=1e-12)
