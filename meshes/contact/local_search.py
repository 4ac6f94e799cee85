"""Local search: the closest master facet that each slave point can meet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.forms.contact.facets import Facets
from piezomat.meshes.contact.facet_bounds import SURELY_FACING, TIE, Pairs
from piezomat.meshes.contact.signed_distance import (
    NearestFacets,
    PointFacetPairs,
    nearest_facets,
    projected_pairs,
    relevant_pairs,
)

END_TOLERANCE = 0.1  # distance beyond the end of a surface, in facet lengths, up to which a point still meets it
# For a point beside an edge: how far from the edge another place of its facet is looked at, and how deep that must be,
# both over the point's depth.
INWARD, AS_DEEP = 2.0, 0.5


def closest_facets(
    points: Array,
    normals: Array,
    facets: Facets,
    margin: float,
    depth: float = np.inf,
    pairs: Pairs | None = None,
    middles: Array | None = None,
    through: float = 0.0,
) -> tuple[Integers, Array, Array]:
    """Facet (m,) that each point meets, -1 for none; its closest point xi (m, t); a lower bound of all distances (m,).

    A point meets the nearest of the facets that face its surface, by the distance to the facet itself and not to its
    extension, or none. It meets nothing beyond the end of the surface. Behind the facet it must be less than `depth`
    deep, and have entered the body through it, see `_have_entered`. Of equally near facets the one with the least key
    is taken, so that their order does not matter.

    points, normals (m, d): slave points and outward normals there, um
    facets: current master facets
    margin: distance, um, beyond which facets may be left out; the bound is no larger
    depth: largest penetration, um; a deeper point would be nearer to the far side of the body
    pairs: (point, facet), the only ones that can meet; default all
    middles (m, d): middle of the slave facet of each point; without, no point beside an edge meets what it is behind
    through: penetration, um, up to which a point may be nearer to the far side of a thin body
    """
    found = np.full(len(points), -1)
    xi = np.zeros((len(points), facets.kind.dim))
    seen, bound = relevant_pairs(points, normals, facets, margin, pairs)
    facing = np.flatnonzero(seen.facing)
    nearest = seen[facing]
    tied = nearest.distance <= nearest.least(len(points))[nearest.row] + TIE * nearest.size
    facing, nearest = facing[tied], nearest[tied]
    meets = nearest.gap > -depth
    behind = np.flatnonzero(meets & (nearest.gap < -TIE * nearest.size))
    # Most points are over their facet, and no other is nearer.
    first = nearest.distance[behind] <= seen.least(len(points))[nearest.row[behind]]
    unclear = behind[~first | (facets.kind.overshoot(nearest.xi[behind]) > 0.0)]
    if len(unclear):
        given = points, normals, facets, margin, pairs, middles, through
        meets[unclear] = _have_entered(*given, seen, facing[unclear])
    nearest = nearest[meets]
    # Of facets that meet at an edge, the one that the point is not beyond, however small its neighbour.
    beyond = facets.kind.overshoot(nearest.xi) > END_TOLERANCE
    order = np.lexsort((facets.key[nearest.facet], beyond, nearest.row))
    _, first = np.unique(nearest.row[order], return_index=True)
    chosen = order[first][~beyond[order[first]]]
    found[nearest.row[chosen]] = nearest.facet[chosen]
    xi[nearest.row[chosen]] = nearest.xi[chosen]
    return found, xi, bound


def _have_entered(
    points: Array,
    normals: Array,
    facets: Facets,
    margin: float,
    pairs: Pairs | None,
    middles: Array | None,
    through: float,
    seen: PointFacetPairs,
    which: Integers,
) -> Booleans:
    """Whether points have entered the body through the facets that they are behind, of `which` (k,) of the pairs.

    A point is as deep in the body as it is behind the nearest facet of all. If that facet faces the point's surface,
    the point has entered through it, or is outside. If not, the point is beside an edge. Then either a contact ends
    there, or the point is on a side of a body that stands across the edge, and the facets that face it are on the far
    side. The two differ on the way from the point to the middle of its own facet. In the former case that way leads
    away from the edge, to a place that is further from the edge than it is deep, whose nearest facet faces it. A point
    outside the body must enter it on that way, to half of its own depth behind the facet at least.

    In a thin body the nearest facet may be that of the far side, which faces as the point's own surface does.
    """
    kind, behind = facets.kind, seen[which]
    rows, row = np.unique(behind.row, return_inverse=True)
    number = np.full(len(points), -1)
    number[rows] = np.arange(len(rows))
    near = seen[number[seen.row] >= 0]
    nearest = NearestFacets.of(kind, replace(near, row=number[near.row]), len(rows))
    entered = nearest.inside[row] & nearest.faces[row]
    far_side = np.einsum("md,md->m", nearest.normal, normals[rows]) > -SURELY_FACING
    entered |= (nearest.inside & far_side)[row] & (behind.gap > -through)
    if middles is None:
        return entered
    way = (middles - points)[rows]
    inward = -np.einsum("md,md->m", way, nearest.normal)
    beside = ~entered & (kind.overshoot(behind.xi) <= END_TOLERANCE) & (inward[row] > 0.0)
    beside = np.flatnonzero(beside)
    if len(beside):
        row, point = row[beside], rows[row[beside]]
        share = np.clip((nearest.gap[row] - INWARD * behind.gap[beside]) / inward[row], 0.0, 1.0)
        moved = points[point] + share[:, None] * way[row]
        there = nearest_facets(moved, normals[point], facets, margin, _pairs_of(pairs, point))
        entered[beside] = there.faces & (nearest.inside[row] | (there.gap <= AS_DEEP * behind.gap[beside]))
    return entered


def _pairs_of(pairs: Pairs | None, points: Integers) -> Pairs | None:
    """Pairs (point, facet) of these points (k,), numbered from 0 in their order."""
    if pairs is None:
        return None
    order = np.argsort(pairs[0], kind="stable")
    first, last = (np.searchsorted(pairs[0][order], points, side=side) for side in ("left", "right"))
    row = np.repeat(np.arange(len(points)), last - first)
    before = np.cumsum(last - first) - (last - first)
    return row, pairs[1][order[first[row] + np.arange(len(row)) - before[row]]]


def brute_force_facets(
    points: Array,
    normals: Array,
    facets: Facets,
    depth: float = np.inf,
    may_meet: Booleans | None = None,
    middles: Array | None = None,
) -> Integers:
    """Slow, readable reference of `closest_facets`: every point against every facet that it `may_meet` (m, f)."""
    found = np.full(len(points), -1)
    for i in range(len(points)):
        every = np.arange(len(facets)) if may_meet is None else np.flatnonzero(may_meet[i])
        if not len(every):
            continue
        seen = projected_pairs(points[i, None], normals[i, None], facets, 0 * every, every)
        gap, faces, normal = _nearest_of_all(seen)
        seen = seen[seen.facing]
        seen = seen[seen.distance <= seen.distance.min(initial=np.inf) + TIE * seen.size]
        meets = seen.gap > -depth
        for k in np.flatnonzero(meets & (seen.gap < -TIE * seen.size)):
            if gap <= 0.0 and faces:
                continue
            way = middles[i] - points[i] if middles is not None else np.zeros_like(normal)
            meets[k] = False
            if way @ normal < 0.0 and facets.kind.overshoot(seen.xi[k, None])[0] <= END_TOLERANCE:
                share = np.clip((INWARD * seen.gap[k] - gap) / (way @ normal), 0.0, 1.0)
                moved = points[i, None] + share * way
                gap_there, faces_there, _ = _nearest_of_all(
                    projected_pairs(moved, normals[i, None], facets, 0 * every, every)
                )
                meets[k] = faces_there and (gap <= 0.0 or gap_there <= AS_DEEP * seen.gap[k])
        seen = seen[meets]
        if len(seen.row):
            beyond = facets.kind.overshoot(seen.xi) > END_TOLERANCE
            best = np.lexsort((facets.key[seen.facet], beyond))[0]
            found[i] = -1 if beyond[best] else seen.facet[best]
    return found


def _nearest_of_all(seen: PointFacetPairs) -> tuple[float, bool, Array]:
    """Gap and outward normal of the facet nearest to one point, and whether an equally near one faces it."""
    tied = seen[seen.distance <= seen.distance.min() + TIE * seen.size]
    most = np.abs(tied.gap).argmax()
    return float(tied.gap[most]), bool(tied.facing.any()), tied.normal[most]
