"""Partners: which master facet each point of a pass meets, kept from one evaluation to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezomat.contact.surface_pair import SurfacePair
from piezomat.forms.arrays import Array
from piezomat.forms.contact.facets import Facets
from piezomat.forms.contact.gap import point_normals, project
from piezomat.meshes.contact.local_search import closest_facets

# A point keeps its master facet until its projection has left it by this share of the facet; the share grows with
# the Newton iteration, because a point that flips between two facets makes Newton's method cycle.
KEEP = ((0, 0.02), (5, 0.1), (10, 0.5))
KEPT = 0.1  # and at the end of a solve by this share at most


@dataclass
class Search:
    """How far partners are kept and looked for.

    keep: share of a facet by which a point's projection may leave it. everywhere: whether points that meet nothing
    are looked at too, those that may be within `reach` (um) of something; far (um): how far off they may then find
    it. touch (um): up to where a point touches something. depth (um): how deep inside a body a point may be at least.
    drift (um): how much nearer to each other things may have come since the last search everywhere.
    """

    keep: float
    everywhere: bool
    reach: float
    far: float
    touch: float
    depth: float
    drift: float


def update_projections(p: SurfacePair, position: Array, search: Search) -> None:
    """Keep the facets of a pass's points as long as they project onto them, search for the others', and project.

    position (n, d): where the nodes are. Sets the pass's `facet`, `xi`, `found_beyond`, `clear`, `met`, `position` and
    `projection`.
    """
    kind = p.slave.kind
    points = np.einsum("mk,mkd->md", p.points.shape[p.near_points], p.slave_at(position, p.points.facet[p.near_points]))
    near = np.full(len(p.near_points), search.reach)  # what comes nearer than this is to be seen
    have = np.flatnonzero(p.master_facet >= 0)
    left = np.zeros(0, np.int64)
    if len(have):
        facet = p.master_facet[have]
        nodes = p.master_at(position, facet)
        projection = project(kind, points[have], nodes, p.ghost_facets.orientation[facet], p.master_xi[have])
        p.master_xi[have] = projection.xi
        # Outside a convex edge the nearest facet is one that the point is beyond already: it leaves from there.
        keep = np.maximum(search.keep, np.minimum(p.initial_overshoot[have] + KEEP[0][1], KEPT))
        left = have[kind.overshoot(projection.xi) > keep]
        # Something else may have come nearer than a partner that does not touch.
        near[have] = np.where(projection.gap > search.touch, np.minimum(projection.gap, search.reach), -np.inf)
    lost = ~(p.distance_bound > p.motion_since_search + near) & search.everywhere  # numbers or not
    lost[left] = True
    if lost.any():
        _look_for(p, points, position, lost, search)
    p.projected = np.flatnonzero(p.master_facet >= 0)
    p.position, facet = points[p.projected], p.partner
    masters = p.master_at(position, facet)
    p.projection = project(kind, p.position, masters, p.ghost_facets.orientation[facet], p.master_xi[p.projected])
    p.master_xi[p.projected] = p.projection.xi


def _look_for(p: SurfacePair, points: Array, position: Array, lost: NDArray[np.bool_], search: Search) -> None:
    kind = p.slave.kind
    own = p.points.facet[p.near_points[lost]]
    normals = np.zeros_like(points)
    normals[lost] = point_normals(
        kind, p.points.xi[p.near_points[lost]], p.slave_at(position, own), p.slave.orientation[own]
    )
    p.master_facet[lost], p.distance_bound[lost] = -1, -np.inf
    least = np.full(len(p.near_points), np.inf)  # gap of the partner
    away = np.full(len(p.near_points), np.inf)  # least distance of the partner's component, plus approach
    clear = np.full(len(p.near_points), np.inf)  # and of all others
    for near, facets, own in zip(p.candidate_pairs.points, p.candidate_pairs.facets, p.self_candidates, strict=True):
        tried = near[lost[near]]
        if not len(tried):
            continue
        nodes, orientation = p.master_at(position, facets), p.ghost_facets.orientation[facets]
        masters = Facets(kind, nodes, orientation, p.ghost_facets.key[facets])
        pairs, depth = None, max(p.depth, search.depth)
        if own is not None:
            pairs, depth = own.of_points(p.points.facet[p.near_points[tried]]), max(p.self_depth, search.depth)
        found, xi, off = closest_facets(points[tried], normals[tried], masters, max(search.far, depth), depth, pairs)
        off += p.motion_since_search[tried] - search.drift
        met = np.flatnonzero(found >= 0)
        gap = np.full(len(tried), np.inf)
        gap[met] = project(kind, points[tried[met]], nodes[found[met]], orientation[found[met]], xi[met]).gap
        # Of several bodies a point meets the one that it is deepest in, or nearest to.
        nearer = (gap < least[tried]) & (gap <= search.far)
        clear[tried] = np.minimum(clear[tried], np.where(nearer, away[tried], off))
        tried, found, xi, gap = tried[nearer], found[nearer], xi[nearer], gap[nearer]
        least[tried], away[tried], p.master_facet[tried], p.master_xi[tried] = gap, off[nearer], facets[found], xi
        p.initial_overshoot[tried] = np.where(gap > search.touch, kind.overshoot(xi), 0.0)
    p.distance_bound[lost] = clear[lost]
