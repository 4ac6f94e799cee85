"""No phantom contact: points press on what they are behind, on nothing else, whatever the shapes and the meshes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.facets import FacetKind, Facets, facet_kind
from piezomat.forms.contact.gap import point_normals, project
from piezomat.forms.contact.integrals import nodal_points, quadrature_points
from piezomat.meshes.contact.local_search import brute_force_facets, closest_facets
from piezomat.meshes.contact.overlap import deepest_overlap

SIZES = (0.05, 0.1, 0.3, 1.0)  # facets of 1:1 to 1:20
GAPS = (0.1, 0.02, 1e-3, -1e-3, -0.01)  # between two bodies; below zero they overlap


def facets_along(kind: FacetKind, start: Array, *sides: Array, counts: tuple[int, ...]) -> list[Array]:
    """Facets (n, d) of a parallelogram or line from `start` along `sides`, so many along each."""
    found = []
    for cell in np.ndindex(*counts):
        halves = (kind.nodes, 1.0 - kind.nodes) if kind.dim == 2 and kind.simplex else (kind.nodes,)
        for nodes in halves:
            found.append(start + ((np.array(cell) + nodes) / counts) @ np.array(sides))
    return found


def oriented(kind: FacetKind, nodes: Array, outward: Array) -> Facets:
    """Facets with nodes (f, n, d) whose normals are on the side of `outward` (f, d)."""
    middle = np.tile(kind.middle, (len(nodes), 1))
    normal = point_normals(kind, middle, nodes, np.ones(len(nodes)))
    return Facets(kind, nodes, np.sign(np.einsum("md,md->m", normal, outward)), np.arange(len(nodes)))


class Polygon:
    """A random polygon, counter-clockwise; every second one is concave."""

    dim = 2

    def __init__(self, rng: np.random.Generator) -> None:
        gaps = rng.dirichlet(np.full(rng.integers(3, 9), 3.0)) * 2.0 * np.pi
        angle = np.cumsum(np.minimum(gaps, 2.6)) + rng.uniform(0.0, 2.0 * np.pi)
        radius = rng.uniform(0.35, 1.0, len(angle)) if rng.random() < 0.5 else np.ones(len(angle))
        self.corners = np.stack([np.cos(angle), np.sin(angle)], axis=1) * radius[:, None]

    def moved(self, by: Array) -> Polygon:
        """The same somewhere else."""
        other = object.__new__(Polygon)
        other.corners = self.corners + by
        return other

    @property
    def edges(self) -> Array:
        """(n, 2)"""
        return np.roll(self.corners, -1, axis=0) - self.corners

    def outline(self, count: int) -> Array:
        """Points all over the surface."""
        share = np.linspace(0.0, 1.0, count)[:, None]
        return np.concatenate([p + share * e for p, e in zip(self.corners, self.edges, strict=True)])

    def depth(self, points: Array) -> Array:
        """Distance to the surface, positive inside: to the nearest edge, with the winding number."""
        start, edge = self.corners, self.edges
        share = np.einsum("mkd,kd->mk", points[:, None] - start, edge) / (edge**2).sum(axis=1)
        away = points[:, None] - start - np.clip(share, 0.0, 1.0)[:, :, None] * edge
        to = (start - points[:, None]) @ np.array([1.0, 1.0j])
        inside = np.angle(np.roll(to, -1, axis=1) / to).sum(axis=1) > np.pi
        return np.where(inside, 1.0, -1.0) * np.linalg.norm(away, axis=2).min(axis=1)

    def facets(self, kind: FacetKind, size: float) -> Facets:
        """Facets of about this size."""
        found, outward = [], []
        for start, edge in zip(self.corners, self.edges, strict=True):
            side = facets_along(kind, start, edge, counts=(max(1, round(np.linalg.norm(edge) / size)),))
            found += side
            outward += [[edge[1], -edge[0]]] * len(side)
        return oriented(kind, np.array(found), np.array(outward))


class Cubes:
    """Some unit cubes that hang together by their faces, at random; turned."""

    dim = 3

    def __init__(self, rng: np.random.Generator) -> None:
        self.full = np.zeros((5, 5, 5), bool)  # those on the rim stay empty
        self.full[2, 2, 2] = True
        for _ in range(rng.integers(0, 6)):
            cubes = np.argwhere(self.full)
            cube, axis = cubes[rng.integers(len(cubes))], rng.integers(3)
            cube[axis] = np.clip(cube[axis] + rng.choice([-1, 1]), 1, 3)
            self.full[tuple(cube)] = True
        turned = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
        self.turn, self.place = turned if rng.random() < 0.5 else np.eye(3), np.zeros(3)

    def moved(self, by: Array) -> Cubes:
        """The same somewhere else."""
        other = object.__new__(Cubes)
        other.full, other.turn, other.place = self.full, self.turn, self.place + by
        return other

    def sides(self) -> list[tuple[Array, int, int]]:
        """Lower corner, axis and direction of each outer face of a cube."""
        found = []
        for cube in np.argwhere(self.full):
            for axis in range(3):
                for direction in (-1, 1):
                    step = direction * np.eye(3, dtype=int)[axis]
                    if not self.full[tuple(cube + step)]:
                        found.append((cube - 2.5 + np.maximum(step, 0), axis, direction))
        return found

    def outline(self, count: int) -> Array:
        """Points all over the surface."""
        share = np.linspace(0.0, 1.0, count)
        place = np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 2)
        found = [low + place @ np.delete(np.eye(3), axis, axis=0) for low, axis, _ in self.sides()]
        return np.concatenate(found) @ self.turn.T + self.place

    def depth(self, points: Array) -> Array:
        """Distance to the surface, positive inside: to the nearest face, and whether the point is in a cube."""
        local = (points - self.place) @ self.turn
        cube = np.clip(np.floor(local + 2.5).astype(int), 0, 4)
        distance = np.full(len(points), np.inf)
        for low, axis, _ in self.sides():
            high = low + 1.0 - np.eye(3)[axis]
            away = np.maximum(np.maximum(low - local, local - high), 0.0)
            distance = np.minimum(distance, np.linalg.norm(away, axis=1))
        return np.where(self.full[tuple(cube.T)], distance, -distance)

    def facets(self, kind: FacetKind, size: float) -> Facets:
        """Facets of about this size."""
        found, outward = [], []
        count = round(1.0 / max(size, 0.15))
        for low, axis, direction in self.sides():
            side = facets_along(kind, low, *np.delete(np.eye(3), axis, axis=0), counts=(count, count))
            found += side
            outward += [direction * np.eye(3)[axis]] * len(side)
        placed = np.array(found) @ self.turn.T + self.place
        return oriented(kind, placed, np.array(outward) @ self.turn.T)


def brought_near(body: Any, other: Any, gap: float, rng: np.random.Generator) -> Any:
    """`body` moved in a random direction to where it is `gap` from touching `other` along that direction."""
    way = rng.standard_normal(body.dim)
    way = np.eye(body.dim)[-1] if rng.random() < 0.5 else way / np.linalg.norm(way)
    side = rng.uniform(-0.7, 0.7, body.dim) * (rng.random() < 0.7)
    count = 60 if body.dim == 2 else 9
    low, high = 0.0, 8.0
    for _ in range(25):
        middle = 0.5 * (low + high)
        there = body.moved(side + middle * way)
        apart = other.depth(there.outline(count)).max() < 0.0 and there.depth(other.outline(count)).max() < 0.0
        low, high = (low, middle) if apart else (middle, high)
    return body.moved(side + (high + gap) * way)


class Search:
    """The points of a body, at nodes or inside facets, against the facets of another one."""

    def __init__(self, kind: FacetKind, body: Any, other: Any, sizes: Array, nodal: bool) -> None:
        slaves = body.facets(kind, sizes[0])
        self.masters = other.facets(kind, sizes[1])
        points = nodal_points(kind, slaves.nodes, None) if nodal else quadrature_points(kind, slaves.nodes)
        own = slaves.nodes[points.facet]
        self.points = np.einsum("mk,mkd->md", points.shape, own)
        self.normals = point_normals(kind, points.xi, own, slaves.orientation[points.facet])
        self.middles = np.einsum("k,mkd->md", kind.shape(kind.middle[None])[0], own)

    def closest(self) -> Integers:
        """What `closest_facets` finds within 1 um, not deeper than 0.5 um."""
        return closest_facets(self.points, self.normals, self.masters, 1.0, 0.5, middles=self.middles)[0]

    def brute(self, rows: Integers) -> Integers:
        """What its reference finds for some of the points."""
        given = self.points[rows], self.normals[rows], self.masters, 0.5
        return brute_force_facets(*given, middles=self.middles[rows])

    def gaps(self, found: Integers) -> Array:
        """Gaps (m,) to the facets found, inf where there is none."""
        return gaps(self.points, self.masters, found)


def gaps(points: Array, facets: Facets, found: Integers) -> Array:
    """Gaps (m,) of points to facets, inf where there is none."""
    met = np.flatnonzero(found >= 0)
    gap = np.full(len(points), np.inf)
    gap[met] = project(facets.kind, points[met], facets.nodes[found[met]], facets.orientation[found[met]]).gap
    return gap


# Shape, kind of facet, number of pairs of bodies.
SHAPES: list[Any] = [(Polygon, "line2", 40), (Polygon, "line3", 30), (Cubes, "tri3", 15), (Cubes, "quad4", 15)]
SHAPES += [pytest.param(Cubes, "quad9", 15, marks=pytest.mark.slow)]


@pytest.mark.parametrize(("shape", "name", "count"), SHAPES)
def test_points_press_as_deep_as_they_are(shape: Any, name: str, count: int, rng: np.random.Generator) -> None:
    """Random bodies beside each other: no pressure where they are apart, and none deeper than the surfaces overlap."""
    pressed = 0
    for number in range(count):
        gap, sizes = GAPS[number % len(GAPS)], rng.choice(SIZES, 2)
        other = shape(rng)
        body = brought_near(shape(rng), other, gap, rng)
        overlap = max(other.depth(body.outline(60)).max(), body.depth(other.outline(60)).max(), 0.0)
        for nodal in (False, True):
            search = Search(facet_kind(name), body, other, sizes, nodal)
            found, depth = search.gaps(search.closest()), other.depth(search.points)
            # Beside an edge a point may be nearer to that than to what it has come in through.
            most = 3.0 * max(overlap, depth.max()) if gap < 0.0 else 0.0
            assert -found.min(initial=0.0) <= most + 1e-9, (number, gap, sizes)
            # A point that is nearest to what faces it presses on that.
            away = 1e-6 * search.normals
            slope = (other.depth(search.points - away) - other.depth(search.points + away)) / 2e-6
            faces = (depth > 1e-5) & (depth < 0.4) & (slope < -0.3)
            np.testing.assert_allclose(found[faces], -depth[faces], atol=1e-9)
            pressed += int(faces.sum())
    assert pressed > 20


@pytest.mark.parametrize(
    ("shape", "name", "count"), [(Polygon, "line2", 6), (Polygon, "line3", 6), (Cubes, "tri3", 4), (Cubes, "quad9", 2)]
)
def test_the_search_is_that_through_all_facets(shape: Any, name: str, count: int, rng: np.random.Generator) -> None:
    behind = 0
    for number in range(count):
        other, sizes = shape(rng), rng.choice(SIZES[1:], 2)
        body = brought_near(shape(rng), other, (-0.02, 0.02)[number % 2], rng)
        search = Search(facet_kind(name), body, other, sizes, nodal=True)
        depth, found = other.depth(search.points), search.closest()
        near = np.flatnonzero(depth > -0.9)
        near = np.union1d(rng.choice(near, min(60, len(near)), replace=False), np.argsort(depth)[-60:])
        expected = np.full(len(found), -1)
        expected[near] = search.brute(near)
        near = near[np.minimum(search.gaps(found), search.gaps(expected))[near] < 0.9]
        np.testing.assert_array_equal(found[near], expected[near])
        behind += int((search.gaps(found)[near] < 0.0).sum())
    assert behind > 2


# --- Beside an edge -------------------------------------------------------------------------------


def slab(kind: FacetKind, thickness: float, count: int) -> Facets:
    """A square or cuboid from -1 to 0, with so many facets a side, whose top is at height 0."""
    d = kind.dim + 1
    found, outward = [], []
    extent = np.ones(d)
    extent[-1] = thickness
    for axis in range(d):
        for direction in (-1, 1):
            start = -extent.copy()
            start[axis] = 0.0 if direction == 1 else -extent[axis]
            side = facets_along(kind, start, *np.delete(np.diag(extent), axis, axis=0), counts=(count,) * kind.dim)
            found += side
            outward += [direction * np.eye(d)[axis]] * len(side)
    return oriented(kind, np.array(found), np.array(outward))


@pytest.mark.parametrize("name", ["line2", "line3", "tri3", "quad4", "tri6", "quad9"])
def test_a_point_at_the_edge_of_a_contact_stays_in_it(name: str) -> None:
    """A facet lies 0.01 deep in the top of a slab, up to its edge: its points at the edge and just outside press too.

    Those of a facet whose middle is outside do not, beyond the edge or nearer to it than they are deep.
    """
    kind = facet_kind(name)
    facets, d = slab(kind, 1.0, 2), kind.dim + 1
    middle = np.full(d, -0.3)
    middle[-1] = -0.01
    outside = np.where(np.arange(d) == 0, 0.3, middle)
    for beyond in (-0.2, -0.02, -0.005, -1e-6, 0.0, 1e-6, 0.002, 0.04):
        point = np.full(d, -0.6)
        point[-1], point[0] = -0.01, beyond
        for to in (middle, outside):
            normal = -np.eye(d)[None, -1]
            found, *_ = closest_facets(point[None], normal, facets, 1.0, 0.5, middles=to[None])
            presses = to is middle or beyond <= -0.01
            assert gaps(point[None], facets, found)[0] == pytest.approx(-0.01 if presses else np.inf, abs=1e-12), beyond


@pytest.mark.parametrize("name", ["line2", "line3", "tri3", "quad4", "tri6", "quad9"])
@pytest.mark.parametrize("height", [-0.009, -1e-3, 1e-3, 0.04])
def test_the_side_of_a_block_does_not_meet_the_far_side_of_another(name: str, height: float) -> None:
    """It stands on a slab, 0.01 deep or just above it, and faces the opposite side of the slab from within."""
    kind = facet_kind(name)
    facets, d = slab(kind, 1.0, 2), kind.dim + 1
    point, above = np.full((1, d), -0.6), np.full((1, d), -0.6)
    point[0, -1], above[0, -1] = height, height + 0.1
    found, *_ = closest_facets(point, -np.eye(d)[:1], facets, 1.0, 0.9, middles=above)
    assert not (gaps(point, facets, found) < 0.0).any()


def test_a_point_in_front_of_a_sharp_edge_is_outside() -> None:
    """Behind the plane of one of its faces, but further in front of the other."""
    wedge = np.array([[[-1.0, -0.2], [0.0, 0.0]], [[0.0, 0.0], [-1.0, 0.2]]])
    facets = oriented(facet_kind("line2"), wedge, np.array([[0.0, -1.0], [0.0, 1.0]]))
    point, normal = np.array([[0.02, -0.015]]), np.array([[0.0, -1.0]])  # faces the upper side
    found, *_ = closest_facets(point, normal, facets, 1.0, 0.5, middles=point - 0.1)
    assert found[0] == -1


@pytest.mark.parametrize("name", ["line2", "tri3", "quad4", "quad9"])
def test_the_overlap_is_by_the_nearest_facet_of_all(name: str, rng: np.random.Generator) -> None:
    """Not by those with the nearest middles: the top of a body is one facet, its other sides have many."""
    kind = facet_kind(name)
    coarse, fine = slab(kind, 0.2, 1), slab(kind, 0.2, 16)
    top, rest = coarse.nodes[:, :, -1].min(axis=1) > -1e-9, fine.nodes[:, :, -1].min(axis=1) < -1e-9
    nodes = np.concatenate([coarse.nodes[top], fine.nodes[rest]])
    orientation = np.concatenate([coarse.orientation[top], fine.orientation[rest]])
    body = Facets(kind, nodes, orientation, np.arange(len(nodes)))
    points = rng.uniform(-0.95, -0.05, (50, kind.dim + 1))
    points[:, -1] = rng.uniform(0.01, 0.3, 50)
    assert deepest_overlap(points, body) == 0.0
    points[0] = -0.5
    points[0, -1] = -0.03
    assert deepest_overlap(points, body) == pytest.approx(0.03, abs=1e-12)
    assert deepest_overlap(points[:0], body) == 0.0
