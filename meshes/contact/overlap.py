"""Overlap of bodies."""

from __future__ import annotations

import numpy as np

from piezomat.forms.arrays import Array
from piezomat.forms.contact.facets import Facets
from piezomat.meshes.contact.signed_distance import nearest_facets


def deepest_overlap(points: Array, facets: Facets) -> float:
    """Largest depth (um) of points (m, d) inside the body with the surface facets; 0 if none is inside.

    A point is inside if its projection on the nearest facet lies on the facet and its gap is negative.
    """
    nearest = nearest_facets(points, np.zeros_like(points), facets)
    return float(-nearest.gap[nearest.inside & nearest.over].min(initial=0.0))
