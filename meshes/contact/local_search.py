"""Pairing: which of the facets of a surface each point of another one meets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from piezomat.forms.arrays import Array
from piezomat.forms.contact.facets import FacetKind
from piezomat.forms.contact.gap import facet_normal, point_normals, project

END_TOLERANCE = 0.1  # how far, in facet lengths, a point may slide off the end of a surface before it is let go
FACING = -0.05  # cosine between two surfaces' outward normals below which they can press on each other
SURELY_FACING = -0.5  # the same cosine in the middle of a curved facet that faces all over
DEVIATION = 1.5  # of a curved facet from a flat one, over that of its nodes
BULGE = 0.1  # how far a curved facet may reach out of the box of its nodes, in its length
SEARCH_ITERATIONS = 6  # to the closest point of a curved facet: enough where the point is over the facet
TIE = 1e-9  # facets equally near within this share of their size are told apart by their key


def near_points(points: Array, facets: Array, margin: float) -> NDArray[np.bool_]:
    """Which points (m, d) may lie within `margin` of a facet with nodes (f, n, d); never misses one."""
    near = np.zeros(len(points), bool)
    for _, center, radius in _size_classes(facets):
        distance, _ = cKDTree(center).query(points, distance_upper_bound=margin + radius)
        near |= np.isfinite(distance)
    return near


def near_pairs(slaves: Array, masters: Array, reach: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs (slave facet, master facet), nodes (f, n, d), that may come within `reach` (um); never misses one."""
    if not len(slaves) or not len(masters):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    center = slaves.mean(axis=1)
    radius = np.linalg.norm(slaves - center[:, None], axis=2).max(axis=1)
    return _all_within(center, masters, radius + reach)


def facing_pairs(
    kind: FacetKind,
    slaves: tuple[Array, Array],
    masters: tuple[Array, Array],
    reach: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs (slave facet, master facet) that face each other and may come within `reach` (um); never misses one.

    slaves, masters: current nodes (f, n, d) and orientation (f,) of the facets.
    """
    row, facet = near_pairs(slaves[0], masters[0], reach)
    mine, theirs = (point_normals(kind, np.tile(kind.middle, (len(n), 1)), n, sign) for n, sign in (slaves, masters))
    faces = np.einsum("md,md->m", mine[row], theirs[facet]) < FACING
    return row[faces], facet[faces]


def closest_facets(
    kind: FacetKind,
    points: Array,
    normals: Array,
    facets: Array,
    orientation: Array,
    key: NDArray[np.int64],
    margin: float,
    depth: float = np.inf,
    pairs: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None,
) -> tuple[NDArray[np.int64], Array, Array]:
    """The facet (m,) that each point meets, -1 for none, where (m, t), and how far (m,) all facets are at least.

    The nearest of those that face the point's own surface, by the distance to the facet itself (not its extension);
    a point behind them must be inside the body. points (m, d) with normals (m, d), facets (f, n, d). Two facets
    equally near are told apart by their key, so that the answer does not depend on their order. A point beyond the
    end of the surface meets nothing, nor does one deeper than `depth` (um): it would be nearer to the far side.
    Facets further off than `margin` (um) may be left out; how far they are is told up to there. `pairs` (point,
    facet): if given, nothing but these can meet.
    """
    found = np.full(len(points), -1)
    where = np.zeros((len(points), kind.dim))
    row, facet, clear, unseen = _may_be_nearest(kind, points, normals, facets, orientation, margin, pairs)
    if not len(row):
        return found, where, clear
    seen = _look(kind, points, normals, facets, orientation, row, facet)
    least = seen.least(len(points))
    again = np.flatnonzero(np.isfinite(least) & (unseen < least))
    if len(again):
        more_row, more_facet = _all_within(points[again], facets, least[again])
        more = _look(kind, points, normals, facets, orientation, again[more_row], more_facet)
        seen = seen[~np.isin(row, again)].and_those(more)
    # A point behind a facet is inside the body only if the nearest facet of all says so too: the far side of a body
    # faces the far side of the other.
    closest = np.lexsort((~seen.facing, seen.distance, seen.row))
    rows, first = np.unique(seen.row[closest], return_index=True)
    outside = np.zeros(len(points), bool)
    outside[rows] = (seen.gap > END_TOLERANCE * seen.size)[closest[first]]
    seen = seen[seen.facing & ((seen.gap > 0.0) | (~outside[seen.row] & (seen.gap > -depth)))]
    seen = seen[seen.distance <= seen.least(len(points))[seen.row] + TIE * seen.size]
    # Of facets that meet at an edge, the one that the point is not beyond, however small its neighbour.
    beyond = kind.overshoot(seen.xi) > END_TOLERANCE
    order = np.lexsort((key[seen.facet], beyond, seen.row))
    rows, first = np.unique(seen.row[order], return_index=True)
    chosen = order[first][~beyond[order[first]]]
    found[seen.row[chosen]] = seen.facet[chosen]
    where[seen.row[chosen]] = seen.xi[chosen]
    return found, where, clear


@dataclass(frozen=True)
class _Seen:
    """Pairs (row of a point, facet): closest point, gap, distance to the facet itself, its size, whether it faces."""

    row: NDArray[np.int64]
    facet: NDArray[np.int64]
    xi: Array
    gap: Array
    distance: Array
    size: Array
    facing: NDArray[np.bool_]

    def __getitem__(self, pairs: NDArray) -> _Seen:
        return _Seen(*(getattr(self, name)[pairs] for name in self.__dataclass_fields__))

    def and_those(self, more: _Seen) -> _Seen:
        """These pairs and then more."""
        both = ((getattr(self, name), getattr(more, name)) for name in self.__dataclass_fields__)
        return _Seen(*(np.concatenate(parts) for parts in both))

    def least(self, points: int) -> Array:
        """Distance of each point to the nearest facet that faces it, inf for none."""
        least = np.full(points, np.inf)
        np.minimum.at(least, self.row[self.facing], self.distance[self.facing])
        return least


def _look(
    kind: FacetKind,
    points: Array,
    normals: Array,
    facets: Array,
    orientation: Array,
    row: NDArray[np.int64],
    facet: NDArray[np.int64],
) -> _Seen:
    """What each of these pairs of a point and a facet looks like."""
    p = project(kind, points[row], facets[facet], orientation[facet], iterations=SEARCH_ITERATIONS)
    metric = np.einsum("mad,mbd->mab", p.tangents, p.tangents)
    nearest = np.einsum("mk,mkd->md", kind.shape(kind.clamp(p.xi, metric)), p.nodes)
    distance = np.linalg.norm(points[row] - nearest, axis=1)
    size = np.linalg.norm(np.ptp(p.nodes, axis=1), axis=1)
    facing = np.einsum("md,md->m", p.normal, normals[row]) < FACING
    return _Seen(row, facet, p.xi, p.gap, distance, size, facing)


def brute_force_facets(
    kind: FacetKind,
    points: Array,
    normals: Array,
    facets: Array,
    orientation: Array,
    key: NDArray[np.int64],
    depth: float = np.inf,
    may_meet: NDArray[np.bool_] | None = None,
) -> NDArray[np.int64]:
    """The slow, readable reference of `closest_facets`: every point against every facet that it `may_meet` (m, f)."""
    found = np.full(len(points), -1)
    for i in range(len(points)):
        every = np.arange(len(facets)) if may_meet is None else np.flatnonzero(may_meet[i])
        if not len(every):
            continue
        seen = _look(kind, points, normals, facets, orientation, np.full(len(every), i), every)
        closest = np.lexsort((~seen.facing, seen.distance))[0]
        inside = (seen.gap[closest] <= END_TOLERANCE * seen.size[closest]) & (seen.gap > -depth)
        seen = seen[seen.facing & ((seen.gap > 0.0) | inside)]
        if len(seen.row):
            seen = seen[seen.distance <= seen.distance.min() + TIE * seen.size]
            beyond = kind.overshoot(seen.xi) > END_TOLERANCE
            best = np.lexsort((key[seen.facet], beyond))[0]
            found[i] = -1 if beyond[best] else seen.facet[best]
    return found


def _size_classes(facets: Array) -> list[tuple[NDArray[np.int64], Array, float]]:
    """Facets by size, within a factor of two: members, centres, largest radius."""
    if not len(facets):
        return []
    center = facets.mean(axis=1)
    radius = np.linalg.norm(facets - center[:, None], axis=2).max(axis=1)
    level = np.floor(np.log2(radius / radius.min() * (1.0 + 1e-12))).astype(int)
    return [
        (members, center[members], float(radius[members].max()))
        for members in (np.flatnonzero(level == i) for i in np.unique(level))
    ]


def _candidates(
    kind: FacetKind, points: Array, facets: Array, margin: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Pairs (point, facet): the nearest centres of every size class.

    And how near (m,) a facet that is left out could be to each point, if the class is full of elongated ones.
    """
    neighbours = 6 if kind.dim == 1 else 16
    rows, columns = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    unseen = np.full(len(points), np.inf)
    for members, center, radius in _size_classes(facets):
        count = min(neighbours, len(members))
        distance, index = cKDTree(center).query(points, k=range(1, count + 1), distance_upper_bound=margin + radius)
        row, column = np.nonzero(index < len(members))
        rows.append(row)
        columns.append(members[index[row, column]])
        if count < len(members):
            unseen = np.minimum(unseen, distance[:, -1] - radius)
    return np.concatenate(rows), np.concatenate(columns), unseen


def _may_be_nearest(
    kind: FacetKind,
    points: Array,
    normals: Array,
    facets: Array,
    orientation: Array,
    margin: float,
    pairs: tuple[NDArray[np.int64], NDArray[np.int64]] | None,
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array, Array]:
    """Pairs (point, facet) that a cheap bound cannot rule out: few need a closer look.

    And how far (m,) all facets are from each point at least, as far as `margin`, and those that are left out although
    they might be nearest: where none of the nearest facets surely faces the point, all within `margin` may be many.
    """
    clear, left_out = np.full(len(points), margin), np.full(len(points), np.inf)
    if not len(facets):
        return np.zeros(0, np.int64), np.zeros(0, np.int64), clear, left_out
    flat = _Flat.of(kind, facets, orientation)
    if pairs is None:
        row, facet, unseen = _candidates(kind, points, facets, margin)
    else:
        (row, facet), unseen = pairs, np.full(len(points), np.inf)
    row, facet, least, nearest = _bounded(kind, points, normals, flat, row, facet, margin)
    again = np.flatnonzero((unseen < nearest) & (nearest < margin))
    some = (unseen < nearest) & (nearest >= margin)
    left_out[some] = unseen[some]
    clear = np.minimum(clear, np.maximum(left_out, 0.0))
    if len(again):
        more = _all_within(points[again], facets, nearest[again])
        more_row, more_facet, more_least, _ = _bounded(kind, points[again], normals[again], flat, *more, margin)
        once = ~np.isin(row, again)
        row = np.concatenate([row[once], again[more_row]])
        facet = np.concatenate([facet[once], more_facet])
        least = np.concatenate([least[once], more_least])
    np.minimum.at(clear, row, np.maximum(least, 0.0))
    return row, facet, clear, left_out


@dataclass(frozen=True)
class _Flat:
    """The flat parallelograms or triangles that touch facets in their middle, and how far facets deviate from those.

    center (f, d), radius (f,) of a sphere around the facet, normal (f, d), tangents and their dual (f, t, d), metric
    (f, t, t), deviation (f,).
    """

    center: Array
    radius: Array
    normal: Array
    tangents: Array
    dual: Array
    metric: Array
    deviation: Array

    @classmethod
    def of(cls, kind: FacetKind, facets: Array, orientation: Array) -> _Flat:
        """Those of facets (f, n, d)."""
        middle = kind.middle
        tangents = np.stack(
            [np.einsum("k,fkd->fd", kind.shape(middle[None], (a,))[0], facets) for a in range(kind.dim)], 1
        )
        center = np.einsum("k,fkd->fd", kind.shape(middle[None])[0], facets)
        metric = tangents @ np.swapaxes(tangents, 1, 2)
        deviation = DEVIATION * np.linalg.norm(facets - center[:, None] - (kind.nodes - middle) @ tangents, axis=2).max(
            axis=1
        )
        deviation += TIE * np.sqrt(np.trace(metric, axis1=1, axis2=2))
        radius = (1.0 + BULGE) * np.linalg.norm(facets - center[:, None], axis=2).max(axis=1)
        normal = facet_normal(tangents, orientation)
        return cls(center, radius, normal, tangents, np.linalg.solve(metric, tangents), metric, deviation)


def _bounded(
    kind: FacetKind,
    points: Array,
    normals: Array,
    flat: _Flat,
    row: NDArray[np.int64],
    facet: NDArray[np.int64],
    margin: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array, Array]:
    """Those pairs whose facet may be the nearest that faces the point, or nearer than that.

    With how far (k,) it is at least, and how far (m,) from each point the nearest is at most: facets that face it in
    their middle do so everywhere; `margin` where there is none.
    """
    nearest = np.full(len(points), margin)
    away = points[row] - flat.center[facet]
    distance = np.linalg.norm(away, axis=1)
    sure = np.einsum("md,md->m", flat.normal[facet], normals[row]) < SURELY_FACING
    np.minimum.at(nearest, row[sure], (distance + BULGE * flat.radius[facet])[sure])
    able = np.flatnonzero(distance - flat.radius[facet] <= nearest[row])
    row, facet, sure, away = row[able], facet[able], sure[able], away[able]
    # The distance to the flat facet, less and more by how far the curved one deviates from it.
    middle = kind.middle
    xi = kind.clamp(middle + np.einsum("kad,kd->ka", flat.dual[facet], away), flat.metric[facet]) - middle
    distance = np.linalg.norm(away - np.einsum("ka,kad->kd", xi, flat.tangents[facet]), axis=1)
    least, most = distance - flat.deviation[facet], distance + flat.deviation[facet]
    np.minimum.at(nearest, row[sure], most[sure])
    able = least <= nearest[row]
    return row[able], facet[able], least[able], nearest


def _all_within(points: Array, facets: Array, distance: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """All pairs (point, facet) that may be within a distance (m,) of each other."""
    rows, columns = [], []
    for members, center, radius in _size_classes(facets):
        near = cKDTree(center).query_ball_point(points, distance + radius)
        rows.append(np.repeat(np.arange(len(points)), [len(n) for n in near]))
        columns.append(members[np.concatenate(near).astype(np.int64)])
    row, column = np.concatenate(rows), np.concatenate(columns)
    # A sphere around an elongated facet holds many of its neighbours, the box around it few.
    low, high = facets.min(axis=1), facets.max(axis=1)
    bulge = BULGE * (high - low).max(axis=1, keepdims=True)
    off = np.maximum(low[column] - points[row], points[row] - high[column]) - bulge[column]
    within = np.linalg.norm(np.maximum(off, 0.0), axis=1) <= distance[row]
    return row[within], column[within]
