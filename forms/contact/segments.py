"""Segments: slave facets cut along the edges of the master facets that they face, with Gauss points on the pieces.

No master edge then runs between the points of a piece, so that the contact integral sees every kink, and forces
that are linear on both surfaces are carried over exactly (Puso and Laursen 2004; Farah, Popp and Wall 2015).

In two dimensions a slave facet, straight or curved, is cut where the ends of master facets have their closest points
on it. In three dimensions facets are cut as flat polygons in the plane of the slave facet, those of order 2 as four
of them; the points lie on the facet itself, whatever its shape. The pieces of a facet are a partition of it: they
neither overlap nor leave anything out, and what no master facet covers is a piece of its own, which meets nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from piezomat.forms.arrays import Array
from piezomat.forms.contact.facets import FacetKind, facet_kind, triangle_rule
from piezomat.forms.contact.gap import project
from piezomat.forms.contact.integrals import SlavePoints

Index = NDArray[np.int64]

SAME = 1e-7  # cuts nearer to each other than this share of the facet are one: what they miss is its square
SLIVER = 1e-10  # pieces smaller than this share of the facet are left out
SHEET = 0.01  # masters that differ in height by less than about this share of the facet's size are equally near
COVERED = 1e-8  # how exactly the pieces must add up to the facet

# Corner nodes of the flat parts that a facet is taken for, in the order of tri3 and quad4.
PARTS = {
    "tri3": [[0, 1, 2]],
    "quad4": [[0, 1, 2, 3]],
    "tri6": [[0, 5, 4], [5, 1, 3], [4, 3, 2], [3, 4, 5]],
    "quad9": [[0, 4, 5, 8], [4, 1, 8, 6], [5, 8, 2, 7], [8, 6, 7, 3]],
}


@dataclass(frozen=True)
class Facets:
    """Facets as they are now: nodes (f, n, d), orientation (f,), key (f,) that no partition changes."""

    nodes: Array
    orientation: Array
    key: Index


def segment_points(
    kind: FacetKind, reference: Array, slave: Facets, master: Facets, pairs: tuple[Index, Index]
) -> tuple[SlavePoints, NDArray[np.bool_]]:
    """Gauss points on the pieces of all slave facets, and whether a master facet covers the piece (m,).

    reference (f, n, d): undeformed coordinates, whose area (um2; 2D: um) the weights add up to. `pairs`: slave and
    master facet of each pair that face each other; a slave facet in no pair is one piece, which may meet anything.
    """
    if kind.dim == 1:
        facet, xi, share, covered = _intervals(kind, slave, master, pairs)
    else:
        facet, xi, share, covered = _polygons(kind, slave, master, pairs)
    weight = share * _metric(kind, xi, reference[facet])
    order = np.argsort(facet, kind="stable")
    facet, xi, weight, covered = facet[order], xi[order], weight[order], covered[order]
    first = np.searchsorted(facet, facet)
    place = np.arange(len(facet)) - first
    return SlavePoints(facet, place, xi, kind.shape(xi), weight, weight), covered


def nearest_points(facet: Index, xi: Array, of: SlavePoints) -> Index:
    """The nearest of the points `of` on the same facet, for each point; every facet must have some."""
    apart = 10.0  # reference facets are smaller than that
    if not len(facet):
        return np.zeros(0, np.int64)
    tree = cKDTree(np.column_stack([apart * of.facet, of.xi]))
    return tree.query(np.column_stack([apart * facet, xi]))[1]


def _metric(kind: FacetKind, xi: Array, nodes: Array) -> Array:
    """Area per reference area of facets with nodes (m, n, d), each at its own point xi (m, t)."""
    tangents = np.stack([np.einsum("mk,mkd->md", kind.shape(xi, (a,)), nodes) for a in range(kind.dim)], axis=1)
    return np.sqrt(np.linalg.det(tangents @ np.swapaxes(tangents, 1, 2)))


# --- Two dimensions -------------------------------------------------------------------------------


def _intervals(
    kind: FacetKind, slave: Facets, master: Facets, pairs: tuple[Index, Index]
) -> tuple[Index, Array, Array, NDArray[np.bool_]]:
    """Facet, xi, share of the reference facet, and whether it is covered, of points on pieces of lines."""
    s, m = pairs
    ends = np.stack(
        [project(kind, master.nodes[m, e], slave.nodes[s], slave.orientation[s]).xi[:, 0] for e in (0, 1)], axis=1
    )
    low, high = np.clip(ends.min(axis=1), 0.0, 1.0), np.clip(ends.max(axis=1), 0.0, 1.0)
    every = np.arange(len(slave.nodes))
    owner = np.concatenate([every, every, s, s])
    cut = np.concatenate([np.zeros(len(every)), np.ones(len(every)), low, high])
    kept = (cut == 0.0) | (cut == 1.0) | ((cut > SAME) & (cut < 1.0 - SAME))
    order = np.lexsort((cut[kept], owner[kept]))
    owner, cut = owner[kept][order], cut[kept][order]
    fresh = np.r_[True, (np.diff(owner) > 0) | (np.diff(cut) > SAME)][: len(owner)]
    owner, cut = owner[fresh], cut[fresh]
    piece = np.flatnonzero(np.diff(owner) == 0)
    facet, start, length = owner[piece], cut[piece], cut[piece + 1] - cut[piece]
    paired = np.isin(facet, s)
    covered = ~paired | _inside_any(facet, start + 0.5 * length, s, low, high)
    x, w = kind.quadrature()
    xi = start[:, None] + length[:, None] * x[:, 0]
    share = length[:, None] * w
    n = len(x)
    return np.repeat(facet, n), xi.reshape(-1, 1), share.ravel(), np.repeat(covered, n)


def _inside_any(facet: Index, place: Array, s: Index, low: Array, high: Array) -> NDArray[np.bool_]:
    """Whether each place (p,) on a facet (p,) lies in one of the intervals low..high on facets s."""
    inside = np.zeros(len(facet), bool)
    order = np.argsort(s, kind="stable")
    s, low, high = s[order], low[order], high[order]
    first, last = np.searchsorted(s, facet), np.searchsorted(s, facet, side="right")
    for k in range(int((last - first).max(initial=0))):
        row = np.minimum(first + k, len(s) - 1)
        inside |= (first + k < last) & (low[row] <= place) & (place <= high[row])
    return inside


# --- Three dimensions -----------------------------------------------------------------------------


@dataclass
class _Pieces:
    """Convex polygons in planes of parts of slave facets: vertices (p, k, 2), the first `count` (p,) of each."""

    part: Index
    vertices: Array
    count: Index

    def __getitem__(self, rows: NDArray) -> _Pieces:
        return _Pieces(self.part[rows], self.vertices[rows], self.count[rows])

    @property
    def area(self) -> Array:
        """(p,)"""
        return _area(self.vertices, self.count)

    @classmethod
    def joined(cls, sets: list[_Pieces]) -> _Pieces:
        """All pieces of some sets."""
        widest = max(p.vertices.shape[1] for p in sets)
        vertices = [np.pad(p.vertices, ((0, 0), (0, widest - p.vertices.shape[1]), (0, 0))) for p in sets]
        return cls(
            np.concatenate([p.part for p in sets]), np.concatenate(vertices), np.concatenate([p.count for p in sets])
        )


def _polygons(
    kind: FacetKind, slave: Facets, master: Facets, pairs: tuple[Index, Index]
) -> tuple[Index, Array, Array, NDArray[np.bool_]]:
    """As `_intervals`, on pieces of polygons."""
    s, m = pairs
    parts = np.array(PARTS[kind.name])
    flat = facet_kind("tri3" if kind.simplex else "quad4")
    ring = [0, 1, 2] if kind.simplex else [0, 1, 3, 2]
    used = np.unique(s)
    number = len(parts)
    # The parts of a facet that is paired stand one after the other, and every pair is one of parts.
    corners = slave.nodes[used][:, parts].reshape(-1, flat.nodes.shape[0], 3)
    plane = _Plane(corners, ring)
    part = (np.searchsorted(used, s)[:, None, None] * number + np.arange(number)[None, :, None]).repeat(number, axis=2)
    other = np.broadcast_to(np.arange(number)[None, None, :], part.shape)
    row = np.broadcast_to(np.arange(len(s))[:, None, None], part.shape).ravel()
    part, other = part.ravel(), other.ravel()
    facing = master.nodes[m[row][:, None], parts[other]][:, ring]
    inside, height = plane.to_plane(part, facing)
    level = np.rint(np.abs(height) / (SHEET * plane.size[part]))
    order = np.lexsort((other, master.key[m[row]], level, part))
    covered, free = _partition(plane.polygons, part[order], inside[order])
    pieces = _Pieces.joined([covered, free])
    meets = np.arange(len(pieces.part)) < len(covered.part)

    corner, area, piece = _triangles(pieces)
    x, w = triangle_rule(1 if kind.name == "tri3" else 2)
    bary = np.column_stack([1.0 - x.sum(axis=1), x])
    place = np.einsum("qk,tkd->tqd", bary, corner).reshape(-1, 2)
    tile = np.repeat(pieces.part[piece], len(w))
    local = project(flat, plane.to_space(tile, place), plane.nodes[tile], np.ones(len(tile))).xi
    share = (area[:, None] * 2.0 * w).ravel() / _metric(flat, local, plane.nodes[tile])
    xi = np.einsum("mk,mkt->mt", flat.shape(local), kind.nodes[parts[tile % number]])
    share /= number  # the parts are equal shares of the reference facet
    whole, weight = kind.quadrature()
    rest = np.setdiff1d(np.arange(len(slave.nodes)), used)
    return (
        np.concatenate([used[tile // number], np.repeat(rest, len(weight))]),
        np.concatenate([xi, np.tile(whole, (len(rest), 1))]),
        np.concatenate([share, np.tile(weight, len(rest))]),
        np.concatenate([np.repeat(meets[piece], len(w)), np.ones(len(rest) * len(weight), bool)]),
    )


class _Plane:
    """The mean planes of parts with corners (p, n, 3), whose outlines are the corners in the order `ring`."""

    def __init__(self, corners: Array, ring: list[int]) -> None:
        outline = corners[:, ring]
        self.center = outline.mean(axis=1)
        spokes = outline - self.center[:, None]
        normal = np.cross(spokes, np.roll(spokes, -1, axis=1)).sum(axis=1)
        self.normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        first = spokes[:, 0] - np.einsum("pd,pd->p", spokes[:, 0], self.normal)[:, None] * self.normal
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        self.axes = np.stack([first, np.cross(self.normal, first)], axis=1)
        part = np.arange(len(corners))
        self.nodes = self.to_space(part, self.to_plane(part, corners)[0])
        flat = self.to_plane(part, outline)[0]
        self.polygons = _Pieces(part, flat, np.full(len(part), len(ring)))
        self.size = np.linalg.norm(np.ptp(outline, axis=1), axis=1)

    def to_plane(self, part: Index, points: Array) -> tuple[Array, Array]:
        """Points (m, k, 3) in the plane of a part (m,), (m, k, 2), and their mean height above it (m,)."""
        away = points - self.center[part][:, None]
        height = np.einsum("mkd,md->mk", away, self.normal[part]).mean(axis=1)
        return np.einsum("mkd,mad->mka", away, self.axes[part]), height

    def to_space(self, part: Index, points: Array) -> Array:
        """Points (m, ..., 2) of the plane of a part (m,) in space."""
        center = self.center[part].reshape(-1, *[1] * (points.ndim - 2), 3)
        return center + np.einsum("m...a,mad->m...d", points, self.axes[part])


def _partition(polygons: _Pieces, part: Index, masters: Array) -> tuple[_Pieces, _Pieces]:
    """The pieces of polygons that convex masters (m, k, 2) cover, and the pieces that none does.

    part (m,), ascending: the polygon that each master faces. Of masters one above the other the first one counts.
    """
    outline = _counter_clockwise(masters)
    whole = polygons.area
    pieces = polygons[part]
    for edge in range(outline.shape[1]):
        pieces = _left_of(pieces, outline[:, edge], outline[:, (edge + 1) % outline.shape[1]], whole)
    pieces = pieces[pieces.area > SLIVER * whole[pieces.part]]
    covered = np.bincount(pieces.part, pieces.area, minlength=len(whole))
    exact = np.abs(covered - whole) <= COVERED * whole
    # Where the pieces do not add up, masters overlap or leave something out: take them away one after the other.
    done, rest = [pieces[exact[pieces.part]]], polygons[~exact]
    first, last = (np.searchsorted(part, np.arange(len(whole)), side=side) for side in ("left", "right"))
    for k in range(int((last - first)[~exact].max(initial=0))):
        row = first[rest.part] + k
        waits = row < last[rest.part]
        left, inner, row = [rest[~waits]], rest[waits], row[waits]
        for edge in range(outline.shape[1]):
            start, end = outline[row, edge], outline[row, (edge + 1) % outline.shape[1]]
            left.append(_left_of(inner, end, start, whole))
            inner = _left_of(inner, start, end, whole)
        done.append(inner)
        rest = _Pieces.joined(left)
        rest = rest[rest.area > SLIVER * whole[rest.part]]
    done = _Pieces.joined(done)
    return done[done.area > SLIVER * whole[done.part]], rest


def _left_of(pieces: _Pieces, start: Array, end: Array, whole: Array) -> _Pieces:
    """What of each piece lies on the left of the line from start (p, 2) to end (p, 2); possibly nothing."""
    v, k = pieces.vertices, pieces.vertices.shape[1]
    along = end - start
    away = v - start[:, None]
    side = along[:, None, 0] * away[..., 1] - along[:, None, 1] * away[..., 0]
    tiny = SLIVER * np.sqrt(whole[pieces.part]) * np.linalg.norm(along, axis=1)
    side = np.where(np.abs(side) <= tiny[:, None], 0.0, side)
    column = np.arange(k)
    follow = np.where(column + 1 < pieces.count[:, None], column + 1, 0)
    valid = column < pieces.count[:, None]
    after, beyond = np.take_along_axis(side, follow, axis=1), np.take_along_axis(v, follow[..., None], axis=1)
    kept, crossed = valid & (side >= 0.0), valid & (side * after < 0.0)
    share = np.where(crossed, side, 0.0) / np.where(crossed, side - after, 1.0)
    point = v + share[..., None] * (beyond - v)
    both = np.stack([v, point], axis=2).reshape(len(v), 2 * k, 2)
    mask = np.stack([kept, crossed], axis=2).reshape(len(v), 2 * k)
    count = mask.sum(axis=1)
    order = np.argsort(~mask, axis=1, kind="stable")[:, : max(int(count.max(initial=3)), 3)]
    return _Pieces(pieces.part, np.take_along_axis(both, order[..., None], axis=1), np.where(count >= 3, count, 0))


def _area(vertices: Array, count: Index) -> Array:
    """Signed areas of polygons."""
    column = np.arange(vertices.shape[1])
    follow = np.where(column + 1 < count[:, None], column + 1, 0)
    after = np.take_along_axis(vertices, follow[..., None], axis=1)
    cross = vertices[..., 0] * after[..., 1] - vertices[..., 1] * after[..., 0]
    return 0.5 * np.where(column < count[:, None], cross, 0.0).sum(axis=1)


def _counter_clockwise(outline: Array) -> Array:
    turned = _area(outline, np.full(len(outline), outline.shape[1])) < 0.0
    return np.where(turned[:, None, None], outline[:, ::-1], outline)


def _triangles(pieces: _Pieces) -> tuple[Array, Array, Index]:
    """Triangles (t, 3, 2) that make up convex pieces, their areas, and the piece of each."""
    corners, owners = [], []
    for k in range(1, pieces.vertices.shape[1] - 1):
        rows = np.flatnonzero(k + 1 < pieces.count)
        corners.append(pieces.vertices[rows][:, [0, k, k + 1]])
        owners.append(rows)
    corner, owner = np.concatenate(corners), np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    corner, owner = corner[order], owner[order]
    return corner, _area(corner, np.full(len(corner), 3)), owner
