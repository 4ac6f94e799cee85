"""Overlap of bodies."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from piezomat.forms.arrays import Array
from piezomat.forms.contact.facets import FacetKind
from piezomat.forms.contact.gap import project

NEIGHBOURS = 12  # facets with the nearest centres that are tried


def deepest_overlap(kind: FacetKind, points: Array, facets: Array, orientation: Array) -> float:
    """Largest depth (um) of points (m, d) inside the body with the surface facets (f, n, d); 0 if none is inside.

    A point is inside if its projection on the nearest facet lies on the facet and its gap is negative.
    """
    if not len(points) or not len(facets):
        return 0.0
    count = min(NEIGHBOURS, len(facets))
    _, facet = cKDTree(facets.mean(axis=1)).query(points, k=range(1, count + 1))
    row, facet = np.repeat(np.arange(len(points)), count), facet.ravel()
    p = project(kind, points[row], facets[facet], orientation[facet])
    metric = np.einsum("mad,mbd->mab", p.tangents, p.tangents)
    nearest = np.einsum("mk,mkd->md", kind.shape(kind.clamp(p.xi, metric)), p.nodes)
    distance = np.linalg.norm(points[row] - nearest, axis=1).reshape(-1, count)
    first = distance.argmin(axis=1) + count * np.arange(len(points))
    inside = (p.gap[first] < 0.0) & (kind.overshoot(p.xi[first]) <= 0.0)
    return float(-p.gap[first][inside].min(initial=0.0))
