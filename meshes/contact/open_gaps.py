"""Closest points across open gaps: where the facets of a polygonal surface are few and far, and their edges count."""

from __future__ import annotations

import numpy as np

from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.facets import Facets
from piezomat.meshes.contact.facet_bounds import TIE, Pairs
from piezomat.meshes.contact.signed_distance import relevant_pairs

# Cosine between a facet's normal and the way to a point, above which an edge is one of a smooth surface. At others, as
# at the end of a surface, there is nothing to face.
SMOOTH = 0.9
# Cosine between a point's normal and the way to it, up to which its surface faces the other one. Field lines bend: half
# discs that touch face each other up to their flat sides; without what is turned by more than a right angle they have
# 5 % less capacitance.
TURNED = 0.5
TOUCH = 1e-6  # facet sizes: a distance below this has no direction


def closest_across(
    points: Array, normals: Array, facets: Facets, margin: float, depth: float, pairs: Pairs | None = None
) -> tuple[Integers, Array, Array, Array]:
    """Facet (m,) that each point faces, -1 for none; its closest point xi (m, t); gap (m,), um; its direction (m, d).

    A point faces the nearest facet of all, unless it is turned away from it, and sees its interior, or an edge or a
    corner of a smooth surface. The gap is the distance of the two, along the way from the facet to the point. A point
    behind its facet has a negative gap along the facet's normal, if it is less than `depth` deep.

    points, normals (m, d), margin (um) and pairs as of `closest_facets`
    """
    found, kind = np.full(len(points), -1), facets.kind
    xi, gap, direction = np.zeros((len(points), kind.dim)), np.full(len(points), np.inf), np.zeros_like(points)
    seen, _ = relevant_pairs(points, normals, facets, margin, pairs, facing=False)
    seen = seen[(seen.distance <= margin) & (seen.distance <= seen.least(len(points))[seen.row] + TIE * seen.size)]
    nodes = facets.nodes[seen.facet]
    tangents = np.stack([np.einsum("mk,mkd->md", kind.shape(seen.xi, (a,)), nodes) for a in range(kind.dim)], axis=1)
    inside = kind.clamp(seen.xi, np.einsum("mad,mbd->mab", tangents, tangents))
    away = points[seen.row] - np.einsum("mk,mkd->md", kind.shape(inside), nodes)
    length = np.linalg.norm(away, axis=1)
    apart = (seen.gap > -TOUCH * seen.size) & (length > TOUCH * seen.size)
    way = np.where(apart[:, None], away / np.maximum(length, np.finfo(float).tiny)[:, None], seen.normal)
    smooth = np.einsum("md,md->m", way, seen.normal) > SMOOTH
    sees = apart | ((seen.gap > -depth) & (kind.overshoot(seen.xi) <= TIE))
    sees &= np.einsum("md,md->m", way, normals[seen.row]) < TURNED
    sharp = np.zeros(len(points), bool)
    sharp[seen.row[~smooth]] = True
    some = np.flatnonzero(sees & ~sharp[seen.row])
    some = some[np.lexsort((facets.key[seen.facet[some]], seen.row[some]))]
    row, first = np.unique(seen.row[some], return_index=True)
    some = some[first]
    found[row], xi[row], direction[row] = seen.facet[some], inside[some], way[some]
    gap[row] = np.where(apart, length, seen.gap)[some]
    return found, xi, gap, direction
