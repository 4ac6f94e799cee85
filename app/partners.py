"""Partners: which master facet each point of a pass meets, kept from one evaluation to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.contact_pass import ContactPass
from forms.contact.gap import point_normals, project
from meshes.pairing import closest_facets, may_touch

Array = NDArray[np.float64]

# A point keeps its master facet until its projection has left it by this share of the facet; the share grows with
# the Newton iteration, because a point that flips between two facets makes Newton's method cycle.
KEEP = ((0, 0.02), (5, 0.1), (10, 0.5))
KEPT = 0.1  # and at the end of a solve by this share at most


@dataclass
class Search:
    """How far partners are kept and looked for.

    keep: share of a facet by which a point's projection may leave it. everywhere: whether points that meet nothing
    are looked at too. reach (um): points further off than this, in front of all that faces them, can do nothing yet.
    margin (um): how far facets may be. depth (um): how deep inside a body a point may be at least.
    """

    keep: float
    everywhere: bool
    reach: float
    margin: float
    depth: float


def find_partners(p: ContactPass, position: Array, search: Search) -> None:
    """Keep the facets of a pass's points as long as they project onto them, search for the others', and project.

    position (n, d): where the nodes are. Sets the pass's `facet`, `xi`, `found_beyond`, `met`, `position` and
    `projection`.
    """
    kind = p.slave.kind
    points = np.einsum("mk,mkd->md", p.points.shape[p.rows], p.slave_at(position, p.points.facet[p.rows]))
    lost = (p.facet < 0) & search.everywhere
    have = np.flatnonzero(p.facet >= 0)
    if len(have):
        facet = p.facet[have]
        nodes = p.master_at(position, facet)
        xi = project(kind, points[have], nodes, p.visible.orientation[facet], p.xi[have]).xi
        p.xi[have] = xi
        # Outside a convex edge the nearest facet is one that the point is beyond already: it leaves from there.
        left = np.minimum(p.found_beyond[have] + KEEP[0][1], KEPT)
        lost[have[kind.overshoot(xi) > np.maximum(search.keep, left)]] = True
    if lost.any():
        _look_for(p, points, position, lost, search)
    p.met = np.flatnonzero(p.facet >= 0)
    p.position, facet = points[p.met], p.facet[p.met]
    masters = p.master_at(position, facet)
    p.projection = project(kind, p.position, masters, p.visible.orientation[facet], p.xi[p.met])
    p.xi[p.met] = p.projection.xi


def _look_for(p: ContactPass, points: Array, position: Array, lost: NDArray[np.bool_], search: Search) -> None:
    kind = p.slave.kind
    own = p.points.facet[p.rows[lost]]
    normals = np.zeros_like(points)
    normals[lost] = point_normals(kind, p.points.xi[p.rows[lost]], p.slave_at(position, own), p.slave.orientation[own])
    p.facet[lost] = -1
    least = np.full(len(p.rows), np.inf)
    for near, facets in zip(p.meetings.points, p.meetings.facets, strict=True):
        tried = near[lost[near]]
        if not len(tried):
            continue
        nodes, orientation = p.master_at(position, facets), p.visible.orientation[facets]
        tried = tried[may_touch(kind, points[tried], normals[tried], nodes, orientation, search.reach)]
        found, xi = closest_facets(
            kind,
            points[tried],
            normals[tried],
            nodes,
            orientation,
            p.visible.key[facets],
            search.margin,
            max(p.depth, search.depth),
        )
        met = np.flatnonzero(found >= 0)
        tried, found, xi = tried[met], found[met], xi[met]
        # Of several bodies a point meets the one that it is deepest in, or nearest to.
        gap = project(kind, points[tried], nodes[found], orientation[found], xi).gap
        nearer = gap < least[tried]
        tried = tried[nearer]
        least[tried], p.facet[tried], p.xi[tried] = gap[nearer], facets[found[nearer]], xi[nearer]
        p.found_beyond[tried] = np.where(gap[nearer] > p.law.reach, kind.overshoot(xi[nearer]), 0.0)
