"""Segments: they are a partition of each slave facet, no master edge runs between their points, both sides agree."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from piezomat.forms.arrays import Array
from piezomat.forms.contact.facets import FacetKind, Facets, facet_kind
from piezomat.forms.contact.integrals import SlavePoints, quadrature_points
from piezomat.forms.contact.segments import nearest_points, segment_points
from piezomat.meshes.contact.facet_bounds import facing_pairs

REACH = 2.0  # every two facets of most tests are a pair
KINDS = ["line2", "line3", "tri3", "tri6", "quad4", "quad9"]
SOLID = KINDS[2:]
each_kind = pytest.mark.parametrize("name", KINDS)


def grid(
    kind: FacetKind, divisions: int, height: float = 0.0, *, upper: bool, size: float = 1.0, turn: float = 0.0
) -> Facets:
    """Facets on a square (2D: an interval) of side `size`, turned about its corner, facing up or down."""
    ends = np.linspace(0.0, size, divisions + 1)
    corner = facet_kind({"lin": "line2", "tri": "tri3", "qua": "quad4"}[kind.name[:3]])
    cells = []
    for i in range(divisions):
        if kind.dim == 1:
            cells.append(ends[[[i], [i + 1]]])
            continue
        for j in range(divisions):
            square = np.array([[ends[a], ends[b]] for b in (j, j + 1) for a in (i, i + 1)])
            cells += [square] if not kind.simplex else [square[[0, 1, 2]], square[[3, 2, 1]]]
    flat = corner.shape(kind.nodes) @ np.array(cells)
    if kind.dim == 2:
        c, s = np.cos(turn), np.sin(turn)
        flat = flat @ np.array([[c, s], [-s, c]])
    nodes = np.concatenate([flat, np.full((*flat.shape[:2], 1), height)], axis=2)
    up = 1.0 if kind.dim == 2 else -1.0
    return Facets(kind, nodes, np.full(len(nodes), -up if upper else up), np.arange(len(nodes)))


def cut(slave: Facets, master: Facets) -> tuple[SlavePoints, NDArray[np.bool_]]:
    return segment_points(slave.nodes, slave, master, facing_pairs(slave, master, REACH))


def places(points: SlavePoints, facets: Facets) -> Array:
    return np.einsum("mk,mkd->md", points.shape, facets.nodes[points.facet])


@each_kind
@pytest.mark.parametrize(("divisions", "size", "turn"), [(3, 1.0, 0.0), (5, 0.8, 0.0), (2, 1.5, 0.3), (1, 0.3, 0.5)])
def test_both_sides_integrate_over_the_same_surface(name: str, divisions: int, size: float, turn: float) -> None:
    """Integrals over what is covered do not depend on which side is cut, and all pieces make up the whole facet."""
    kind = facet_kind(name)
    lower = grid(kind, 2, upper=False)
    upper = grid(kind, divisions, 0.01, upper=True, size=size, turn=turn)
    found = []
    for slave, master in ((lower, upper), (upper, lower)):
        points, covered = cut(slave, master)
        whole = quadrature_points(kind, slave.nodes)
        areas = [np.bincount(p.facet, p.weight) for p in (points, whole)]
        np.testing.assert_allclose(areas[0], areas[1], rtol=1e-8)
        x = places(points, slave)[:, :-1]
        y = x[:, -1]
        powers = np.stack([np.ones_like(y), x[:, 0], y, x[:, 0] * y, y**2])
        found.append(powers[:, covered] @ points.weight[covered])
    np.testing.assert_allclose(found[0], found[1], rtol=1e-8)
    if kind.dim == 1 or turn == 0.0:
        assert found[0][0] == pytest.approx(min(size, 1.0) ** kind.dim, rel=1e-8)


@each_kind
def test_a_function_with_kinks_at_master_edges_is_integrated_exactly(name: str) -> None:
    kind = facet_kind(name)
    points, covered = cut(grid(kind, 2, upper=False), grid(kind, 3, 0.01, upper=True))
    assert covered.all()
    x = places(points, grid(kind, 2, upper=False))[:, 0]
    # The hat function of the master's edge at 1/3.
    assert points.weight @ np.maximum(1.0 - 3.0 * np.abs(x - 1.0 / 3.0), 0.0) == pytest.approx(1.0 / 3.0, rel=1e-9)


@each_kind
def test_without_a_partner_a_facet_has_its_usual_points(name: str) -> None:
    kind = facet_kind(name)
    slave = grid(kind, 2, upper=False)
    for master in (grid(kind, 2, 5.0, upper=True), grid(kind, 2, 0.01, upper=False)):
        points, covered = cut(slave, master)
        usual = quadrature_points(kind, slave.nodes)
        assert covered.all()
        np.testing.assert_allclose(points.weight, usual.weight, rtol=1e-13)
        np.testing.assert_allclose(points.xi, usual.xi, atol=1e-14)
        np.testing.assert_array_equal(points.place, usual.place)


@pytest.mark.parametrize("name", SOLID)
def test_masters_one_above_the_other_do_not_count_twice(name: str) -> None:
    """A second sheet behind a smaller first one: every place is covered once, and all are."""
    kind = facet_kind(name)
    near, far = grid(kind, 3, 0.01, upper=True, size=0.7, turn=0.1), grid(kind, 2, 0.2, upper=True, size=1.5)
    both = Facets(
        kind,
        np.concatenate([far.nodes, near.nodes]),
        np.concatenate([far.orientation, near.orientation]),
        np.arange(len(far.nodes) + len(near.nodes)),
    )
    slave = grid(kind, 1, upper=False)
    points, covered = cut(slave, both)
    assert covered.all()
    np.testing.assert_allclose(points.weight.sum(), 1.0, rtol=1e-8)
    # The near sheet's outline is one of the cuts: what lies under it is integrated exactly.
    alone, under = cut(slave, near)
    c, s = np.cos(0.1), np.sin(0.1)
    local = places(points, slave)[:, :2] @ np.array([[c, -s], [s, c]])
    inside = np.all((local > 0.0) & (local < 0.7), axis=1)
    assert points.weight[inside].sum() == pytest.approx(alone.weight[under].sum(), rel=1e-6)


@pytest.mark.parametrize("name", ["line3", "tri6", "quad9"])
def test_points_lie_on_curved_facets_and_weigh_their_area(name: str) -> None:
    kind = facet_kind(name)

    def bent(facets: Facets) -> Facets:
        nodes = facets.nodes.copy()
        nodes[..., -1] += 0.1 * nodes[..., 0] ** 2
        return Facets(facets.kind, nodes, facets.orientation, facets.key)

    slave, master = bent(grid(kind, 2, upper=False)), bent(grid(kind, 3, 0.01, upper=True))
    points, covered = cut(slave, master)
    x = places(points, slave)
    np.testing.assert_allclose(x[:, -1], 0.1 * x[:, 0] ** 2, atol=1e-12)
    exact = np.arcsinh(0.2) / 0.4 + np.sqrt(1.04) / 2  # arc length of 0.1 x^2 up to 1
    assert points.weight.sum() == pytest.approx(exact, rel=1e-6)
    assert points.weight[covered].sum() == pytest.approx(exact, rel=1e-2)


def test_a_point_takes_after_the_nearest_one_of_its_own_facet(rng: np.random.Generator) -> None:
    kind = facet_kind("tri3")
    old = quadrature_points(kind, grid(kind, 2, upper=False).nodes)
    facet, xi = rng.integers(0, 8, 50), rng.uniform(0.0, 0.5, (50, 2))
    nearest = nearest_points(facet, xi, old)
    np.testing.assert_array_equal(old.facet[nearest], facet)
    for f, x, row in zip(facet, xi, nearest, strict=True):
        own = np.flatnonzero(old.facet == f)
        assert row == own[np.linalg.norm(old.xi[own] - x, axis=1).argmin()]


@each_kind
def test_no_facets_are_no_trouble(name: str) -> None:
    kind = facet_kind(name)
    some = grid(kind, 2, upper=False)
    empty = Facets(kind, np.zeros((0, *some.nodes.shape[1:])), np.zeros(0), np.zeros(0, np.int64))
    assert len(cut(empty, some)[0].weight) == 0
    assert len(cut(some, empty)[0].weight) == len(quadrature_points(kind, some.nodes).weight)
    assert len(nearest_points(np.zeros(0, np.int64), np.zeros((0, kind.dim)), cut(some, empty)[0])) == 0
