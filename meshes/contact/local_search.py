"""Local search: the closest master facet that each slave point can meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.forms.contact.facets import FacetKind, Facets
from piezomat.forms.contact.gap import facet_normal, point_normals, project

END_TOLERANCE = 0.1  # distance beyond the end of a surface, in facet lengths, up to which a point still meets it
FACING = -0.05  # cosine between two surfaces' outward normals below which they can press on each other
SURELY_FACING = -0.5  # the same cosine in the middle of a curved facet that faces the point everywhere
DEVIATION = 1.5  # of a curved facet from a flat one, over the deviation of its nodes
BULGE = 0.1  # largest distance of a curved facet from the box of its nodes, in the facet's length
SEARCH_ITERATIONS = 6  # of the projection on a curved facet: enough for points over the facet
TIE = 1e-9  # relative difference of distances, in facet sizes, below which the facets' keys decide


def near_points(points: Array, facets: Array, margin: float) -> Booleans:
    """Whether points (m, d) may lie within `margin` (um) of a facet with nodes (f, n, d); never misses one."""
    near = np.zeros(len(points), bool)
    for _, center, radius in _size_classes(facets):
        distance, _ = cKDTree(center).query(points, distance_upper_bound=margin + radius)
        near |= np.isfinite(distance)
    return near


def near_pairs(slaves: Array, masters: Array, reach: float) -> tuple[Integers, Integers]:
    """Pairs (slave, master) of facets with nodes (f, n, d) that may be within `reach` (um); never misses one."""
    if not len(slaves) or not len(masters):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    center = slaves.mean(axis=1)
    radius = np.linalg.norm(slaves - center[:, None], axis=2).max(axis=1)
    return _all_within(center, masters, radius + reach)


def facing_pairs(slaves: Facets, masters: Facets, reach: float) -> tuple[Integers, Integers]:
    """Pairs (slave, master) of facets that face each other and may be within `reach` (um); never misses one."""
    row, facet = near_pairs(slaves.nodes, masters.nodes, reach)
    slave_normal, master_normal = (
        point_normals(f.kind, np.tile(f.kind.middle, (len(f), 1)), f.nodes, f.orientation) for f in (slaves, masters)
    )
    faces = np.einsum("md,md->m", slave_normal[row], master_normal[facet]) < FACING
    return row[faces], facet[faces]


def closest_facets(
    points: Array,
    normals: Array,
    facets: Facets,
    margin: float,
    depth: float = np.inf,
    pairs: tuple[Integers, Integers] | None = None,
) -> tuple[Integers, Array, Array]:
    """Facet (m,) that each point meets, -1 for none; its closest point xi (m, t); a lower bound of all distances (m,).

    A point meets the nearest of the facets that face its surface, by the distance to the facet itself and not to its
    extension. It meets nothing beyond the end of the surface. Behind the surface it must be inside the body, less than
    `depth` deep. Of equally near facets the one with the least key is taken, so that their order does not matter.

    points, normals (m, d): slave points and outward normals there, um
    facets: current master facets
    margin: distance, um, beyond which facets may be left out; the bound is no larger
    depth: largest penetration, um; a deeper point would be nearer to the far side of the body
    pairs: (point, facet), the only ones that can meet; default all
    """
    found = np.full(len(points), -1)
    xi = np.zeros((len(points), facets.kind.dim))
    row, facet, bound, unseen = _may_be_nearest(points, normals, facets, margin, pairs)
    if not len(row):
        return found, xi, bound
    seen = _projected(points, normals, facets, row, facet)
    least = seen.least(len(points))
    again = np.flatnonzero(np.isfinite(least) & (unseen < least))
    if len(again):
        more_row, more_facet = _all_within(points[again], facets.nodes, least[again])
        more = _projected(points, normals, facets, again[more_row], more_facet)
        seen = seen[~np.isin(row, again)].followed_by(more)
    # A point behind a facet is inside the body only if it is behind the nearest facet of all, too: the far side of a
    # body faces the far side of the other.
    closest = np.lexsort((~seen.facing, seen.distance, seen.row))
    rows, first = np.unique(seen.row[closest], return_index=True)
    outside = np.zeros(len(points), bool)
    outside[rows] = (seen.gap > END_TOLERANCE * seen.size)[closest[first]]
    seen = seen[seen.facing & ((seen.gap > 0.0) | (~outside[seen.row] & (seen.gap > -depth)))]
    seen = seen[seen.distance <= seen.least(len(points))[seen.row] + TIE * seen.size]
    # Of facets that meet at an edge, the one that the point is not beyond, however small its neighbour.
    beyond = facets.kind.overshoot(seen.xi) > END_TOLERANCE
    order = np.lexsort((facets.key[seen.facet], beyond, seen.row))
    rows, first = np.unique(seen.row[order], return_index=True)
    chosen = order[first][~beyond[order[first]]]
    found[seen.row[chosen]] = seen.facet[chosen]
    xi[seen.row[chosen]] = seen.xi[chosen]
    return found, xi, bound


@dataclass(frozen=True)
class _Projected:
    """Pairs (point, facet), (k,): closest point, gap, distance to the facet itself, facet size, whether they face."""

    row: Integers
    facet: Integers
    xi: Array
    gap: Array
    distance: Array
    size: Array
    facing: Booleans

    def __getitem__(self, pairs: NDArray) -> _Projected:
        return _Projected(*(getattr(self, name)[pairs] for name in self.__dataclass_fields__))

    def followed_by(self, more: _Projected) -> _Projected:
        """These pairs, then more."""
        both = ((getattr(self, name), getattr(more, name)) for name in self.__dataclass_fields__)
        return _Projected(*(np.concatenate(parts) for parts in both))

    def least(self, points: int) -> Array:
        """Distance (points,) of each point to the nearest facet that faces it, inf for none."""
        least = np.full(points, np.inf)
        np.minimum.at(least, self.row[self.facing], self.distance[self.facing])
        return least


def _projected(points: Array, normals: Array, facets: Facets, row: Integers, facet: Integers) -> _Projected:
    """Projections of the points `row` (k,) on the facets `facet` (k,)."""
    kind = facets.kind
    p = project(kind, points[row], facets.nodes[facet], facets.orientation[facet], iterations=SEARCH_ITERATIONS)
    metric = np.einsum("mad,mbd->mab", p.tangents, p.tangents)
    nearest = np.einsum("mk,mkd->md", kind.shape(kind.clamp(p.xi, metric)), p.nodes)
    distance = np.linalg.norm(points[row] - nearest, axis=1)
    size = np.linalg.norm(np.ptp(p.nodes, axis=1), axis=1)
    facing = np.einsum("md,md->m", p.normal, normals[row]) < FACING
    return _Projected(row, facet, p.xi, p.gap, distance, size, facing)


def brute_force_facets(
    points: Array, normals: Array, facets: Facets, depth: float = np.inf, may_meet: Booleans | None = None
) -> Integers:
    """Slow, readable reference of `closest_facets`: every point against every facet that it `may_meet` (m, f)."""
    found = np.full(len(points), -1)
    for i in range(len(points)):
        every = np.arange(len(facets)) if may_meet is None else np.flatnonzero(may_meet[i])
        if not len(every):
            continue
        seen = _projected(points, normals, facets, np.full(len(every), i), every)
        closest = np.lexsort((~seen.facing, seen.distance))[0]
        inside = (seen.gap[closest] <= END_TOLERANCE * seen.size[closest]) & (seen.gap > -depth)
        seen = seen[seen.facing & ((seen.gap > 0.0) | inside)]
        if len(seen.row):
            seen = seen[seen.distance <= seen.distance.min() + TIE * seen.size]
            beyond = facets.kind.overshoot(seen.xi) > END_TOLERANCE
            best = np.lexsort((facets.key[seen.facet], beyond))[0]
            found[i] = -1 if beyond[best] else seen.facet[best]
    return found


def _size_classes(facets: Array) -> list[tuple[Integers, Array, float]]:
    """Classes of facets (f, n, d) of equal size within a factor of two: members, centres, largest radius."""
    if not len(facets):
        return []
    center = facets.mean(axis=1)
    radius = np.linalg.norm(facets - center[:, None], axis=2).max(axis=1)
    level = np.floor(np.log2(radius / radius.min() * (1.0 + 1e-12))).astype(int)
    return [
        (members, center[members], float(radius[members].max()))
        for members in (np.flatnonzero(level == i) for i in np.unique(level))
    ]


def _candidates(points: Array, facets: Facets, margin: float) -> tuple[Integers, Integers, Array]:
    """Pairs (point, facet) of the nearest centres of every size class, and a lower bound (m,) of other distances.

    The bound is small where a class has many elongated facets.
    """
    neighbours = 6 if facets.kind.dim == 1 else 16
    rows, columns = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    unseen = np.full(len(points), np.inf)
    for members, center, radius in _size_classes(facets.nodes):
        count = min(neighbours, len(members))
        distance, index = cKDTree(center).query(points, k=range(1, count + 1), distance_upper_bound=margin + radius)
        row, column = np.nonzero(index < len(members))
        rows.append(row)
        columns.append(members[index[row, column]])
        if count < len(members):
            unseen = np.minimum(unseen, distance[:, -1] - radius)
    return np.concatenate(rows), np.concatenate(columns), unseen


def _may_be_nearest(
    points: Array, normals: Array, facets: Facets, margin: float, pairs: tuple[Integers, Integers] | None
) -> tuple[Integers, Integers, Array, Array]:
    """Few pairs (point, facet), among them all that may be nearest, with two lower bounds (m,) of distances.

    The first bound is of all facets, at most `margin`. The second is of facets that are left out although they may be
    nearest: where none of the nearest facets surely faces the point, there may be many within `margin`.
    """
    bound, left_out = np.full(len(points), margin), np.full(len(points), np.inf)
    if not len(facets):
        return np.zeros(0, np.int64), np.zeros(0, np.int64), bound, left_out
    flat = _Flat.of(facets)
    if pairs is None:
        row, facet, unseen = _candidates(points, facets, margin)
    else:
        (row, facet), unseen = pairs, np.full(len(points), np.inf)
    row, facet, least, nearest = _bounded(points, normals, flat, row, facet, margin)
    again = np.flatnonzero((unseen < nearest) & (nearest < margin))
    some = (unseen < nearest) & (nearest >= margin)
    left_out[some] = unseen[some]
    bound = np.minimum(bound, np.maximum(left_out, 0.0))
    if len(again):
        more = _all_within(points[again], facets.nodes, nearest[again])
        more_row, more_facet, more_least, _ = _bounded(points[again], normals[again], flat, *more, margin)
        once = ~np.isin(row, again)
        row = np.concatenate([row[once], again[more_row]])
        facet = np.concatenate([facet[once], more_facet])
        least = np.concatenate([least[once], more_least])
    np.minimum.at(bound, row, np.maximum(least, 0.0))
    return row, facet, bound, left_out


@dataclass(frozen=True)
class _Flat:
    """Flat parallelograms or triangles tangent to facets in their middle, with a bound of the facets' deviation.

    center (f, d); radius (f,) of a sphere around the facet; normal (f, d); tangents and their dual (f, t, d); metric
    (f, t, t); deviation (f,).
    """

    kind: FacetKind
    center: Array
    radius: Array
    normal: Array
    tangents: Array
    dual: Array
    metric: Array
    deviation: Array

    @classmethod
    def of(cls, facets: Facets) -> _Flat:
        """Flat facets tangent to these."""
        kind, nodes = facets.kind, facets.nodes
        middle = kind.middle
        tangents = np.stack(
            [np.einsum("k,fkd->fd", kind.shape(middle[None], (a,))[0], nodes) for a in range(kind.dim)], 1
        )
        center = np.einsum("k,fkd->fd", kind.shape(middle[None])[0], nodes)
        away = nodes - center[:, None]
        metric = tangents @ np.swapaxes(tangents, 1, 2)
        deviation = DEVIATION * np.linalg.norm(away - (kind.nodes - middle) @ tangents, axis=2).max(axis=1)
        deviation += TIE * np.sqrt(np.trace(metric, axis1=1, axis2=2))
        radius = (1.0 + BULGE) * np.linalg.norm(away, axis=2).max(axis=1)
        normal = facet_normal(tangents, facets.orientation)
        return cls(kind, center, radius, normal, tangents, np.linalg.solve(metric, tangents), metric, deviation)


def _bounded(
    points: Array, normals: Array, flat: _Flat, row: Integers, facet: Integers, margin: float
) -> tuple[Integers, Integers, Array, Array]:
    """Pairs whose facet may be the nearest that faces the point, or nearer than that one.

    Also lower bounds (k,) of their distances and an upper bound (m,) of the distance to the nearest facet that faces
    the point, `margin` if there is none. Facets that surely face a point in their middle face it everywhere.
    """
    nearest = np.full(len(points), margin)
    away = points[row] - flat.center[facet]
    distance = np.linalg.norm(away, axis=1)
    sure = np.einsum("md,md->m", flat.normal[facet], normals[row]) < SURELY_FACING
    np.minimum.at(nearest, row[sure], (distance + BULGE * flat.radius[facet])[sure])
    able = np.flatnonzero(distance - flat.radius[facet] <= nearest[row])
    row, facet, sure, away = row[able], facet[able], sure[able], away[able]
    # The distance to the flat facet, minus and plus the deviation of the curved one.
    middle = flat.kind.middle
    xi = flat.kind.clamp(middle + np.einsum("kad,kd->ka", flat.dual[facet], away), flat.metric[facet]) - middle
    distance = np.linalg.norm(away - np.einsum("ka,kad->kd", xi, flat.tangents[facet]), axis=1)
    least, most = distance - flat.deviation[facet], distance + flat.deviation[facet]
    np.minimum.at(nearest, row[sure], most[sure])
    able = least <= nearest[row]
    return row[able], facet[able], least[able], nearest


def _all_within(points: Array, facets: Array, distance: Array) -> tuple[Integers, Integers]:
    """Pairs (point, facet) of facets (f, n, d) that may be within the `distance` (m,) of a point; misses none."""
    rows, columns = [], []
    for members, center, radius in _size_classes(facets):
        near = cKDTree(center).query_ball_point(points, distance + radius)
        rows.append(np.repeat(np.arange(len(points)), [len(n) for n in near]))
        columns.append(members[np.concatenate(near).astype(np.int64)])
    row, column = np.concatenate(rows), np.concatenate(columns)
    # A sphere around an elongated facet contains many of its neighbours, the box around it few.
    low, high = facets.min(axis=1), facets.max(axis=1)
    bulge = BULGE * (high - low).max(axis=1, keepdims=True)
    off = np.maximum(low[column] - points[row], points[row] - high[column]) - bulge[column]
    within = np.linalg.norm(np.maximum(off, 0.0), axis=1) <= distance[row]
    return row[within], column[within]
