"""Bounds of distances between points and facets: few pairs of them need a closer look."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.forms.contact.facets import FacetKind, Facets
from piezomat.forms.contact.gap import facet_normal, point_normals

FACING = -0.05  # cosine between two surfaces' outward normals below which they can press on each other
SURELY_FACING = -0.5  # the same cosine in the middle of a curved facet that faces the point everywhere
DEVIATION = 1.5  # of a curved facet from a flat one, over the deviation of its nodes
BULGE = 0.1  # largest distance of a curved facet from the box of its nodes, in the facet's length
TIE = 1e-9  # relative difference of distances, in facet sizes, below which facets are equally near

Pairs = tuple[Integers, Integers]  # (point, facet) or (slave facet, master facet)


def near_points(points: Array, facets: Array, margin: float) -> Booleans:
    """Whether points (m, d) may lie within `margin` (um) of a facet with nodes (f, n, d); never misses one."""
    near = np.zeros(len(points), bool)
    for _, center, radius in _size_classes(facets):
        distance, _ = cKDTree(center).query(points, distance_upper_bound=margin + radius)
        near |= np.isfinite(distance)
    return near


def near_pairs(slaves: Array, masters: Array, reach: float) -> Pairs:
    """Pairs (slave, master) of facets with nodes (f, n, d) that may be within `reach` (um); never misses one."""
    if not len(slaves) or not len(masters):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    center = slaves.mean(axis=1)
    radius = np.linalg.norm(slaves - center[:, None], axis=2).max(axis=1)
    return all_within(center, masters, radius + reach)


def facing_pairs(slaves: Facets, masters: Facets, reach: float) -> Pairs:
    """Pairs (slave, master) of facets that face each other and may be within `reach` (um); never misses one."""
    row, facet = near_pairs(slaves.nodes, masters.nodes, reach)
    slave_normal, master_normal = (
        point_normals(f.kind, np.tile(f.kind.middle, (len(f), 1)), f.nodes, f.orientation) for f in (slaves, masters)
    )
    faces = np.einsum("md,md->m", slave_normal[row], master_normal[facet]) < FACING
    return row[faces], facet[faces]


def may_be_nearest(
    points: Array, normals: Array, facets: Facets, margin: float, pairs: Pairs | None, *, facing: bool
) -> tuple[Integers, Integers, Array, Array]:
    """Few pairs (point, facet), among them all that may be nearest, with two lower bounds (m,) of distances.

    The first bound is of all facets, at most `margin`. The second is of facets that are left out although they may be
    nearest: where none of the nearest facets surely faces the point, there may be many within `margin`.

    facing: whether the nearest of the facets that face the point is meant, or that of all.
    """
    bound, left_out = np.full(len(points), margin), np.full(len(points), np.inf)
    if not len(facets):
        return np.zeros(0, np.int64), np.zeros(0, np.int64), bound, left_out
    flat = _Flat.of(facets)
    if pairs is None:
        row, facet, unseen = _candidates(points, facets, margin)
    else:
        (row, facet), unseen = pairs, np.full(len(points), np.inf)
    row, facet, least, nearest = _bounded(points, normals, flat, row, facet, margin, facing=facing)
    again = np.flatnonzero((unseen < nearest) & (nearest < margin))
    some = (unseen < nearest) & (nearest >= margin)
    left_out[some] = unseen[some]
    bound = np.minimum(bound, np.maximum(left_out, 0.0))
    if len(again):
        more = all_within(points[again], facets.nodes, nearest[again])
        more_row, more_facet, more_least, _ = _bounded(
            points[again], normals[again], flat, *more, margin, facing=facing
        )
        once = ~np.isin(row, again)
        row = np.concatenate([row[once], again[more_row]])
        facet = np.concatenate([facet[once], more_facet])
        least = np.concatenate([least[once], more_least])
    np.minimum.at(bound, row, np.maximum(least, 0.0))
    return row, facet, bound, left_out


def all_within(points: Array, facets: Array, distance: Array) -> Pairs:
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
    points: Array, normals: Array, flat: _Flat, row: Integers, facet: Integers, margin: float, *, facing: bool
) -> tuple[Integers, Integers, Array, Array]:
    """Pairs whose facet may be the nearest that faces the point, or nearer than that one.

    Also lower bounds (k,) of their distances and an upper bound (m,) of the distance to the nearest facet that faces
    the point, `margin` if there is none. Facets that surely face a point in their middle face it everywhere. Without
    `facing` all facets count as facing the point.
    """
    nearest = np.full(len(points), margin)
    away = points[row] - flat.center[facet]
    distance = np.linalg.norm(away, axis=1)
    sure = np.einsum("md,md->m", flat.normal[facet], normals[row]) < SURELY_FACING
    sure |= not facing
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
