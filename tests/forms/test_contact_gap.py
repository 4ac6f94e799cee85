"""Facets, closest points, gaps and jumps: each against its definition, each variation against differences."""

from __future__ import annotations

from collections.abc import Callable
from math import factorial

import numpy as np
import pytest

from piezomat.forms.arrays import Array
from piezomat.forms.contact.facets import FacetKind, facet_kind, facet_kind_of
from piezomat.forms.contact.gap import facet_normal, project
from tests.facets import KINDS, PairBatch, inner_points, rotation

each_kind = pytest.mark.parametrize("name", KINDS)
STEP = 3e-4


def difference(f: Callable[[float], Array], step: float = STEP) -> Array:
    """f'(0) by central differences of order 6."""
    near, middle, far = (f(i * step) - f(-i * step) for i in (1, 2, 3))
    return (45.0 * near - 9.0 * middle + far) / (60.0 * step)


def monomial_integral(kind: FacetKind, powers: tuple[int, ...]) -> float:
    """Exact integral of a monomial over the reference facet."""
    if kind.simplex and kind.dim == 2:
        a, b = powers
        return factorial(a) * factorial(b) / factorial(a + b + 2)
    return float(np.prod([1.0 / (a + 1) for a in powers]))


# --- Facets ---------------------------------------------------------------------------------------


@each_kind
def test_shape_functions_are_those_of_their_nodes(name: str, rng: np.random.Generator) -> None:
    kind = facet_kind(name)
    np.testing.assert_allclose(kind.shape(kind.nodes), np.eye(len(kind.nodes)), atol=1e-14)
    xi = rng.uniform(-0.3, 1.3, (20, kind.dim))
    np.testing.assert_allclose(kind.shape(xi).sum(axis=1), 1.0, atol=1e-13)
    for powers in kind.powers:
        values = np.prod(kind.nodes**powers, axis=1)
        np.testing.assert_allclose(kind.shape(xi) @ values, np.prod(xi**powers, axis=1), atol=1e-13)


@each_kind
def test_derivatives_of_shape_functions(name: str, rng: np.random.Generator) -> None:
    kind = facet_kind(name)
    xi = rng.uniform(-0.3, 1.3, (10, kind.dim))
    axes = np.eye(kind.dim)
    for i in range(kind.dim):
        for lower in [(), *((j,) for j in range(kind.dim)), *((j, j) for j in range(kind.dim))]:
            expected = difference(lambda h, i=i, lower=lower: kind.shape(xi + h * axes[i], lower), 0.1)
            np.testing.assert_allclose(kind.shape(xi, (*lower, i)), expected, atol=1e-11)


def test_facets_of_every_cell() -> None:
    cells = {"triangle": "line", "quadrilateral": "line", "tetrahedron": "tri", "hexahedron": "quad"}
    counts = {"line": (2, 3), "tri": (3, 6), "quad": (4, 9)}
    for cell, shape in cells.items():
        for order in (1, 2):
            kind = facet_kind_of(cell, order)
            assert kind.name == f"{shape}{counts[shape][order - 1]}"
            assert kind.order == order
            assert len(kind.nodes) == counts[shape][order - 1]
            assert kind.affine == (order == 1 and shape != "quad")


@each_kind
def test_quadrature_is_exact(name: str) -> None:
    kind = facet_kind(name)
    points, weights = kind.quadrature()
    assert weights.min() > 0.0
    assert kind.overshoot(points).max() < 0.0
    simplex = kind.simplex and kind.dim == 2
    degree = 2 * kind.order if simplex else 2 * kind.order + 1
    powers = [p for p in np.ndindex((degree + 1,) * kind.dim) if not simplex or sum(p) <= degree]
    for p in powers:
        found = weights @ np.prod(points ** np.array(p), axis=1)
        assert found == pytest.approx(monomial_integral(kind, p), rel=1e-13), p


@each_kind
def test_overshoot_counts_from_the_nearest_side(name: str, rng: np.random.Generator) -> None:
    kind = facet_kind(name)
    assert kind.overshoot(inner_points(kind, rng, 50)).max() <= 0.0
    middle = 0.5 if not kind.simplex or kind.dim == 1 else 1.0 / 3.0
    for axis in range(kind.dim):
        point = np.full((1, kind.dim), middle)
        point[0, axis] = -0.2
        assert kind.overshoot(point)[0] == pytest.approx(0.2, abs=1e-15)
    upper = np.full((1, kind.dim), 0.6) if kind.simplex and kind.dim == 2 else np.full((1, kind.dim), 1.2)
    assert kind.overshoot(upper)[0] == pytest.approx(0.2, abs=1e-15)


@each_kind
def test_clamp_finds_the_nearest_point(name: str, rng: np.random.Generator) -> None:
    """In the metric of any stretched and sheared facet; what lies on the facet stays."""
    kind, count = facet_kind(name), 300
    tangents = rng.standard_normal((count, kind.dim, kind.dim + 1)) * rng.uniform(0.05, 1.0, (count, 1, 1))
    metric = np.einsum("mad,mbd->mab", tangents, tangents)
    inside = inner_points(kind, rng, count)
    np.testing.assert_array_equal(kind.clamp(inside, metric), inside)
    anywhere = rng.uniform(-2.0, 3.0, (count, kind.dim))
    clamped = kind.clamp(anywhere, metric)
    assert kind.overshoot(clamped).max() < 1e-14

    def distance(points: Array) -> Array:
        off = points - anywhere
        return np.sqrt(np.einsum("...ma,mab,...mb->...m", off, metric, off))

    for sample in np.concatenate([kind.nodes, inner_points(kind, rng, 2000)]):
        assert (distance(clamped) <= distance(np.tile(sample, (count, 1))) * (1.0 + 1e-12)).all()


def test_clamp_at_known_places() -> None:
    def clamped(name: str, points: list[list[float]]) -> Array:
        xi = np.array(points)
        return facet_kind(name).clamp(xi, np.tile(np.eye(xi.shape[1]), (len(xi), 1, 1)))

    np.testing.assert_allclose(clamped("line3", [[-0.1], [0.3], [1.7]]), [[0], [0.3], [1]])
    np.testing.assert_allclose(clamped("quad4", [[-0.1, 0.4], [1.2, 1.3], [0.5, 0.6]]), [[0, 0.4], [1, 1], [0.5, 0.6]])
    corners = clamped("tri3", [[-0.2, -0.1], [2.0, -0.5], [-0.5, 3.0], [0.6, 0.6], [0.3, -0.2]])
    np.testing.assert_allclose(corners, [[0, 0], [1, 0], [0, 1], [0.5, 0.5], [0.3, 0.0]], atol=1e-15)


# --- Closest points -------------------------------------------------------------------------------


@each_kind
def test_closest_point_is_found_again(name: str, rng: np.random.Generator) -> None:
    """A point set up along the normal at a known place: the place and the signed distance."""
    batch = PairBatch(name, rng, 200)
    p = batch.project(batch.unknowns)
    np.testing.assert_allclose(p.xi, batch.xi, atol=1e-12)
    np.testing.assert_allclose(p.gap, batch.gap, atol=1e-14)


@each_kind
def test_closest_point_is_closest(name: str, rng: np.random.Generator) -> None:
    batch = PairBatch(name, rng, 40)
    kind, q = batch.kind, batch.unknowns
    p, points, master = batch.project(q), batch.points(q), q[:, batch.nodes :, : batch.dim]
    away = points - np.einsum("mk,mkd->md", kind.shape(p.xi), master)
    # Sums over up to 9 nodes, of coordinates up to 5 (their last digit: 9e-16) times tangents up to 4: how they round
    # depends on NumPy and the processor (1.5e-14 at most in 60 draws).
    assert np.abs(np.einsum("mad,md->ma", p.tangents, away)).max() < 9 * np.spacing(5.0) * 4
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), np.abs(p.gap), atol=1e-14)
    grid = np.stack(np.meshgrid(*[np.linspace(-0.3, 1.3, 65)] * kind.dim), axis=-1).reshape(-1, kind.dim)
    sampled = np.einsum("gk,mkd->mgd", kind.shape(grid), master)
    nearest = np.linalg.norm(sampled - points[:, None], axis=2).min(axis=1)
    assert (np.abs(p.gap) <= nearest + 1e-14).all()
    # And the samples come as near as their spacing allows.
    assert (nearest**2 <= p.gap**2 + 0.05**2).all()


@each_kind
def test_start_of_the_search_does_not_matter(name: str, rng: np.random.Generator) -> None:
    batch = PairBatch(name, rng, 100)
    master = batch.unknowns[:, batch.nodes :, : batch.dim]
    points = batch.points(batch.unknowns)
    start = inner_points(batch.kind, rng, 100)
    p = project(batch.kind, points, master, batch.orientation, start)
    np.testing.assert_allclose(p.xi, batch.xi, atol=1e-12)


def test_closest_point_from_beyond_the_centre_of_curvature() -> None:
    """The curvature term, which loses the minimum there, is left out: the search ends at a minimum."""
    kind = facet_kind("line3")
    nodes = np.array([[[-0.5, 0.25], [0.5, 0.25], [0.0, 0.0]]])  # y = x^2, centre of curvature at its vertex 0.5
    points = np.array([[0.05, 0.9]])
    p = project(kind, points, nodes, np.array([-1.0]))
    away = points[0] - kind.shape(p.xi)[0] @ nodes[0]
    assert abs(p.tangents[0, 0] @ away) < 1e-12
    assert p.tangents[0, 0] @ p.tangents[0, 0] - p.second[0, 0, 0] @ away > 0.0
    x = np.linspace(-1.0, 1.0, 4001)
    assert np.linalg.norm(away) <= np.hypot(x - 0.05, x**2 - 0.9).min() + 1e-12


@each_kind
def test_projection_says_how_the_facet_lies(name: str, rng: np.random.Generator) -> None:
    """Normals are unit, perpendicular and turned over by the orientation; tangents and curvature are derivatives."""
    batch = PairBatch(name, rng, 30)
    kind, p = batch.kind, batch.project(batch.unknowns)
    np.testing.assert_allclose(np.linalg.norm(p.normal, axis=1), 1.0, atol=1e-14)
    assert np.abs(np.einsum("mad,md->ma", p.tangents, p.normal)).max() < 1e-14
    np.testing.assert_allclose(facet_normal(p.tangents, -batch.orientation), -p.normal, atol=1e-15)
    axes = np.eye(kind.dim)

    def surface(xi: Array) -> Array:
        return np.einsum("mk,mkd->md", kind.shape(xi), p.nodes)

    for a in range(kind.dim):
        slope = difference(lambda h, a=a: surface(p.xi + h * axes[a]), 0.1)
        np.testing.assert_allclose(p.tangents[:, a], slope, atol=1e-12)
        for b in range(kind.dim):
            bend = difference(
                lambda h, a=a, b=b: difference(lambda k: surface(p.xi + h * axes[a] + k * axes[b]), 0.1), 0.1
            )
            np.testing.assert_allclose(p.second[:, a, b], bend, atol=1e-11)
            np.testing.assert_allclose(p.curvature[:, a, b], np.einsum("md,md->m", bend, p.normal), atol=1e-11)


@each_kind
def test_numbering_of_the_nodes_does_not_matter(name: str, rng: np.random.Generator) -> None:
    """A facet walked the other way round has the opposite orientation and the same gap."""
    kind = facet_kind(name)
    mirrored = 1.0 - kind.nodes if kind.dim == 1 else kind.nodes[:, ::-1]
    order = [int(np.abs(kind.nodes - m).sum(axis=1).argmin()) for m in mirrored]
    assert sorted(order) == list(range(len(order)))
    batch = PairBatch(name, rng, 20)
    points, master = batch.points(batch.unknowns), batch.unknowns[:, batch.nodes :, : batch.dim]
    p = project(kind, points, master[:, order], -batch.orientation)
    np.testing.assert_allclose(p.gap, batch.gap, atol=1e-14)


# --- Variations -----------------------------------------------------------------------------------


def directions(batch: PairBatch, rng: np.random.Generator) -> Array:
    """A random direction in the unknowns of every pair."""
    return rng.uniform(-1.0, 1.0, batch.unknowns.shape)


def along(rows: Array, first: Array, direction: Array) -> Array:
    """First variation in a direction, (m,)."""
    return np.einsum("mr,mrnc,mnc->m", first, rows, direction)


def vector(rows: Array, first: Array) -> Array:
    """First variation as a vector over the unknowns, (m, 2 n, c)."""
    return np.einsum("mr,mrnc->mnc", first, rows)


def matrix(rows: Array, second: Array) -> Array:
    """Second variation as matrices over the unknowns, (m, 2 n c, 2 n c)."""
    flat = rows.reshape(*rows.shape[:2], -1)
    return np.swapaxes(flat, 1, 2) @ second @ flat


@each_kind
def test_first_variations_are_derivatives(name: str, rng: np.random.Generator) -> None:
    batch = PairBatch(name, rng, 60)
    q = batch.unknowns
    v = batch.variations(q)
    for _ in range(5):
        d = directions(batch, rng)
        gap = difference(lambda h, d=d: batch.project(q + h * d).gap)
        jump = difference(lambda h, d=d: batch.jump(q + h * d))
        np.testing.assert_allclose(along(v.rows, v.gap, d), gap, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(along(v.rows, v.jump, d), jump, rtol=1e-10, atol=1e-10)


@each_kind
def test_second_variations_are_derivatives_of_the_first(name: str, rng: np.random.Generator) -> None:
    batch = PairBatch(name, rng, 60)
    q = batch.unknowns
    v = batch.variations(q)

    def first(state: Array) -> tuple[Array, Array]:
        there = batch.variations(state, second=False)
        return vector(there.rows, there.gap), vector(there.rows, there.jump)

    for _ in range(5):
        d = directions(batch, rng)
        for place, second in enumerate((v.gap2, v.jump2)):
            turn = np.einsum("mij,mj->mi", matrix(v.rows, second), d.reshape(len(d), -1))
            expected = difference(lambda h, d=d, place=place: first(q + h * d)[place]).reshape(turn.shape)
            scale = np.abs(expected).max(axis=1, keepdims=True)
            assert (np.abs(turn - expected) / scale).max() < 1e-9


@each_kind
def test_second_variations_are_symmetric(name: str, rng: np.random.Generator) -> None:
    batch = PairBatch(name, rng, 60)
    v = batch.variations(batch.unknowns)
    for second in (v.gap2, v.jump2):
        m = matrix(v.rows, second)
        assert np.abs(m).max() > 0.1
        assert np.abs(m - np.swapaxes(m, 1, 2)).max() < 1e-12 * np.abs(m).max()


@each_kind
def test_gap_alone_needs_no_potential(name: str, rng: np.random.Generator) -> None:
    """Without potentials the gap's variations are the same, and there is no jump."""
    batch = PairBatch(name, rng, 20)
    q, d = batch.unknowns, batch.dim
    coupled = batch.variations(q)
    batch.components, mechanical = d, q[..., :d]
    alone = batch.variations(mechanical)
    assert alone.jump is None and alone.jump2 is None
    first = vector(coupled.rows, coupled.gap)
    assert not first[..., d].any()
    np.testing.assert_allclose(vector(alone.rows, alone.gap), first[..., :d], atol=1e-15)
    second = matrix(coupled.rows, coupled.gap2).reshape(len(q), *q.shape[1:], *q.shape[1:])
    assert not second[:, :, d].any() and not second[..., d].any()
    found = matrix(alone.rows, alone.gap2).reshape(len(q), *mechanical.shape[1:], *mechanical.shape[1:])
    np.testing.assert_allclose(found, second[:, :, :d, :, :d], atol=1e-13)


@each_kind
def test_rigid_motion_changes_nothing(name: str, rng: np.random.Generator) -> None:
    batch = PairBatch(name, rng, 30)
    q, d = batch.unknowns, batch.dim
    moved = q.copy()
    moved[..., :d] = q[..., :d] @ rotation(d, rng).T + rng.standard_normal(d)
    moved[..., d] += 3.0
    np.testing.assert_allclose(batch.project(moved).gap, batch.project(q).gap, atol=1e-13)
    np.testing.assert_allclose(batch.jump(moved), batch.jump(q), atol=1e-12)
    # So the first variations vanish along rigid motions, and a second one along a rotation takes the first with it.
    v = batch.variations(q)
    gap, jump = vector(v.rows, v.gap), vector(v.rows, v.jump)
    assert np.abs(gap.sum(axis=1)).max() < 1e-12
    assert np.abs(jump.sum(axis=1)).max() < 1e-11
    for i in range(d):
        for j in range(i):
            spin = np.zeros((d, d))
            spin[i, j], spin[j, i] = 1.0, -1.0
            turning = np.zeros_like(q)
            turning[..., :d] = q[..., :d] @ spin.T
            assert np.abs(along(v.rows, v.gap, turning)).max() < 1e-12
            assert np.abs(along(v.rows, v.jump, turning)).max() < 1e-11
            for second, first in ((v.gap2, gap), (v.jump2, jump)):
                turned = np.zeros_like(first)
                turned[..., :d] = first[..., :d] @ spin.T
                found = np.einsum("mij,mj->mi", matrix(v.rows, second), turning.reshape(len(q), -1))
                scale = np.abs(matrix(v.rows, second)).max()
                assert np.abs(found - turned.reshape(found.shape)).max() < 1e-11 * scale


@pytest.mark.parametrize("name", ["line3", "tri6", "quad4", "quad9"])
def test_random_facets_are_warped(name: str, rng: np.random.Generator) -> None:
    """The tests above would say little about flat facets."""
    batch = PairBatch(name, rng, 60)
    assert np.median(np.abs(batch.project(batch.unknowns).curvature).max(axis=(1, 2))) > 0.02
