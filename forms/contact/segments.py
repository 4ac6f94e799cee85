"""Segments: slave facets cut along the edges of the master facets that they face, with Gauss points on each segment.

No master edge runs between the points of a segment. So the contact integral resolves every kink, and tractions that
are linear on both surfaces are transferred exactly (Puso and Laursen 2004; Farah, Popp and Wall 2015).

In two dimensions a slave facet, straight or curved, is cut at the closest points to the ends of master facets. In three
dimensions facets are cut as flat polygons in the plane of the slave facet, those of order 2 as four flat parts; the
points lie on the facet itself, whatever its shape. The segments of a facet are a partition of it. The part that no
master facet covers is cut into segments too, which meet nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.forms.contact.facets import FacetKind, Facets, facet_kind, triangle_rule
from piezomat.forms.contact.gap import project
from piezomat.forms.contact.integrals import SlavePoints

CUT_TOLERANCE = 1e-7  # share of the facet between two cuts below which they are one: the error is its square
SLIVER = 1e-10  # share of the facet below which a segment is left out
SHEET = 0.01  # difference in height, over the facet's size, below which two masters are about equally near
COVERED = 1e-8  # tolerance of the sum of the segments' areas, over the area of the facet

# Corner nodes of the flat parts that replace a facet, in the order of tri3 and quad4.
PARTS = {
    "tri3": [[0, 1, 2]],
    "quad4": [[0, 1, 2, 3]],
    "tri6": [[0, 5, 4], [5, 1, 3], [4, 3, 2], [3, 4, 5]],
    "quad9": [[0, 4, 5, 8], [4, 1, 8, 6], [5, 8, 2, 7], [8, 6, 7, 3]],
}


def segment_points(
    reference: Array, slave: Facets, master: Facets, pairs: tuple[Integers, Integers]
) -> tuple[SlavePoints, Booleans]:
    """Gauss points on the segments of all slave facets, and whether a master facet covers the segment (m,).

    reference (f, n, d): undeformed coordinates of the slave facets; the weights add up to their area (um2; 2D: um)
    pairs: slave and master facet of each pair that face each other; a slave facet without pair is one segment that may
        meet any master facet
    """
    kind = slave.kind
    facet, xi, share, covered = (_intervals if kind.dim == 1 else _polygons)(slave, master, pairs)
    weight = share * _metric(kind, xi, reference[facet])
    order = np.argsort(facet, kind="stable")
    facet, xi, weight, covered = facet[order], xi[order], weight[order], covered[order]
    first = np.searchsorted(facet, facet)
    place = np.arange(len(facet)) - first
    return SlavePoints(facet, place, xi, kind.shape(xi), weight, weight), covered


def nearest_points(facet: Integers, xi: Array, of: SlavePoints) -> Integers:
    """Index (m,) of the nearest of the points `of` on the same facet; every facet must have one.

    facet (m,), xi (m, t): facets and reference coordinates of the points.
    """
    apart = 10.0  # larger than a reference facet
    if not len(facet):
        return np.zeros(0, np.int64)
    tree = cKDTree(np.column_stack([apart * of.facet, of.xi]))
    return tree.query(np.column_stack([apart * facet, xi]))[1]


def _metric(kind: FacetKind, xi: Array, nodes: Array) -> Array:
    """Area per reference area (m,) of facets with nodes (m, n, d), one at each point xi (m, t)."""
    tangents = np.stack([np.einsum("mk,mkd->md", kind.shape(xi, (a,)), nodes) for a in range(kind.dim)], axis=1)
    return np.sqrt(np.linalg.det(tangents @ np.swapaxes(tangents, 1, 2)))


# --- Two dimensions -------------------------------------------------------------------------------


def _intervals(
    slave: Facets, master: Facets, pairs: tuple[Integers, Integers]
) -> tuple[Integers, Array, Array, Booleans]:
    """Facet, xi, share of the reference facet, and whether it is covered, of points on segments of lines."""
    kind, (s, m) = slave.kind, pairs
    ends = np.stack(
        [project(kind, master.nodes[m, e], slave.nodes[s], slave.orientation[s]).xi[:, 0] for e in (0, 1)], axis=1
    )
    low, high = np.clip(ends.min(axis=1), 0.0, 1.0), np.clip(ends.max(axis=1), 0.0, 1.0)
    every = np.arange(len(slave.nodes))
    owner = np.concatenate([every, every, s, s])
    cut = np.concatenate([np.zeros(len(every)), np.ones(len(every)), low, high])
    kept = (cut == 0.0) | (cut == 1.0) | ((cut > CUT_TOLERANCE) & (cut < 1.0 - CUT_TOLERANCE))
    order = np.lexsort((cut[kept], owner[kept]))
    owner, cut = owner[kept][order], cut[kept][order]
    fresh = np.r_[True, (np.diff(owner) > 0) | (np.diff(cut) > CUT_TOLERANCE)][: len(owner)]
    owner, cut = owner[fresh], cut[fresh]
    segment = np.flatnonzero(np.diff(owner) == 0)
    facet, start, length = owner[segment], cut[segment], cut[segment + 1] - cut[segment]
    paired = np.isin(facet, s)
    covered = ~paired | _inside_any(facet, start + 0.5 * length, s, low, high)
    x, w = kind.quadrature()
    xi = start[:, None] + length[:, None] * x[:, 0]
    share = length[:, None] * w
    n = len(x)
    return np.repeat(facet, n), xi.reshape(-1, 1), share.ravel(), np.repeat(covered, n)


def _inside_any(facet: Integers, place: Array, s: Integers, low: Array, high: Array) -> Booleans:
    """Whether places (p,) on facets (p,) lie in one of the intervals low..high (k,) on facets s (k,)."""
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
class _Polygons:
    """Convex polygons in planes of parts of slave facets: part (p,), vertices (p, k, 2), of which `count` (p,)."""

    part: Integers
    vertices: Array
    count: Integers

    def __getitem__(self, rows: NDArray) -> _Polygons:
        return _Polygons(self.part[rows], self.vertices[rows], self.count[rows])

    @property
    def area(self) -> Array:
        """Areas (p,)."""
        return _area(self.vertices, self.count)

    @classmethod
    def concatenated(cls, sets: list[_Polygons]) -> _Polygons:
        """Polygons of all sets, in order."""
        widest = max(p.vertices.shape[1] for p in sets)
        vertices = [np.pad(p.vertices, ((0, 0), (0, widest - p.vertices.shape[1]), (0, 0))) for p in sets]
        return cls(
            np.concatenate([p.part for p in sets]), np.concatenate(vertices), np.concatenate([p.count for p in sets])
        )


def _polygons(
    slave: Facets, master: Facets, pairs: tuple[Integers, Integers]
) -> tuple[Integers, Array, Array, Booleans]:
    """As `_intervals`, on segments that are polygons."""
    kind, (s, m) = slave.kind, pairs
    parts = np.array(PARTS[kind.name])
    flat = facet_kind("tri3" if kind.simplex else "quad4")
    ring = [0, 1, 2] if kind.simplex else [0, 1, 3, 2]
    used = np.unique(s)
    number = len(parts)
    # The parts of a paired facet are consecutive, and every pair is one of parts.
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
    segments = _Polygons.concatenated([covered, free])
    meets = np.arange(len(segments.part)) < len(covered.part)

    corner, area, segment = _triangles(segments)
    x, w = triangle_rule(1 if kind.name == "tri3" else 2)
    bary = np.column_stack([1.0 - x.sum(axis=1), x])
    place = np.einsum("qk,tkd->tqd", bary, corner).reshape(-1, 2)
    tile = np.repeat(segments.part[segment], len(w))
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
        np.concatenate([np.repeat(meets[segment], len(w)), np.ones(len(rest) * len(weight), bool)]),
    )


class _Plane:
    """Mean planes of parts with corners (p, n, 3); their outlines are the corners in the order `ring`."""

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
        self.polygons = _Polygons(part, flat, np.full(len(part), len(ring)))
        self.size = np.linalg.norm(np.ptp(outline, axis=1), axis=1)

    def to_plane(self, part: Integers, points: Array) -> tuple[Array, Array]:
        """Coordinates (m, k, 2) of points (m, k, 3) in the plane of a part (m,), and their mean height (m,)."""
        away = points - self.center[part][:, None]
        height = np.einsum("mkd,md->mk", away, self.normal[part]).mean(axis=1)
        return np.einsum("mkd,mad->mka", away, self.axes[part]), height

    def to_space(self, part: Integers, points: Array) -> Array:
        """Points (m, ..., 3) with coordinates (m, ..., 2) in the plane of a part (m,)."""
        center = self.center[part].reshape(-1, *[1] * (points.ndim - 2), 3)
        return center + np.einsum("m...a,mad->m...d", points, self.axes[part])


def _partition(polygons: _Polygons, part: Integers, masters: Array) -> tuple[_Polygons, _Polygons]:
    """Segments of polygons that convex masters (m, k, 2) cover, and segments that none covers.

    part (m,), ascending: the polygon that each master faces. Where masters overlap, the first one counts.
    """
    outline = _counter_clockwise(masters)
    whole = polygons.area
    segments = polygons[part]
    for edge in range(outline.shape[1]):
        segments = _left_of(segments, outline[:, edge], outline[:, (edge + 1) % outline.shape[1]], whole)
    segments = segments[segments.area > SLIVER * whole[segments.part]]
    covered = np.bincount(segments.part, segments.area, minlength=len(whole))
    exact = np.abs(covered - whole) <= COVERED * whole
    # Where the areas do not add up, masters overlap or leave gaps: subtract them one by one.
    done, rest = [segments[exact[segments.part]]], polygons[~exact]
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
        rest = _Polygons.concatenated(left)
        rest = rest[rest.area > SLIVER * whole[rest.part]]
    done = _Polygons.concatenated(done)
    return done[done.area > SLIVER * whole[done.part]], rest


def _left_of(segments: _Polygons, start: Array, end: Array, whole: Array) -> _Polygons:
    """Part of each segment on the left of the line from start (p, 2) to end (p, 2); possibly empty."""
    v, k = segments.vertices, segments.vertices.shape[1]
    along = end - start
    away = v - start[:, None]
    side = along[:, None, 0] * away[..., 1] - along[:, None, 1] * away[..., 0]
    tiny = SLIVER * np.sqrt(whole[segments.part]) * np.linalg.norm(along, axis=1)
    side = np.where(np.abs(side) <= tiny[:, None], 0.0, side)
    column = np.arange(k)
    follow = np.where(column + 1 < segments.count[:, None], column + 1, 0)
    valid = column < segments.count[:, None]
    after, beyond = np.take_along_axis(side, follow, axis=1), np.take_along_axis(v, follow[..., None], axis=1)
    kept, crossed = valid & (side >= 0.0), valid & (side * after < 0.0)
    share = np.where(crossed, side, 0.0) / np.where(crossed, side - after, 1.0)
    point = v + share[..., None] * (beyond - v)
    both = np.stack([v, point], axis=2).reshape(len(v), 2 * k, 2)
    mask = np.stack([kept, crossed], axis=2).reshape(len(v), 2 * k)
    count = mask.sum(axis=1)
    order = np.argsort(~mask, axis=1, kind="stable")[:, : max(int(count.max(initial=3)), 3)]
    return _Polygons(segments.part, np.take_along_axis(both, order[..., None], axis=1), np.where(count >= 3, count, 0))


def _area(vertices: Array, count: Integers) -> Array:
    """Signed areas (p,) of polygons."""
    column = np.arange(vertices.shape[1])
    follow = np.where(column + 1 < count[:, None], column + 1, 0)
    after = np.take_along_axis(vertices, follow[..., None], axis=1)
    cross = vertices[..., 0] * after[..., 1] - vertices[..., 1] * after[..., 0]
    return 0.5 * np.where(column < count[:, None], cross, 0.0).sum(axis=1)


def _counter_clockwise(outline: Array) -> Array:
    turned = _area(outline, np.full(len(outline), outline.shape[1])) < 0.0
    return np.where(turned[:, None, None], outline[:, ::-1], outline)


def _triangles(segments: _Polygons) -> tuple[Array, Array, Integers]:
    """Triangles (t, 3, 2) of convex segments, their areas (t,), and the segment (t,) of each."""
    corners, owners = [], []
    for k in range(1, segments.vertices.shape[1] - 1):
        rows = np.flatnonzero(k + 1 < segments.count)
        corners.append(segments.vertices[rows][:, [0, k, k + 1]])
        owners.append(rows)
    corner, owner = np.concatenate(corners), np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    corner, owner = corner[order], owner[order]
    return corner, _area(corner, np.full(len(corner), 3)), owner
