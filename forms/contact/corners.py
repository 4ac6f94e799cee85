"""Sharp corners of surfaces: when a point there is in contact on its own, and not as the end of a facet.

Points inside facets do not see a corner that comes first: they are a fifth of a facet behind it. A facet that lies flat
on the other surface needs no point at its corners: its own points are as deep. So a corner is a contact point, with the
share of the area that a node has, as far as every facet that meets there is tilted from the other surface. The share
depends on the directions alone; its change with them is left out of the force, which is wrong by some 1e-3 of it while
a body tips over from a corner to a face.
"""

from __future__ import annotations

import numpy as np

from piezomat.forms.arrays import Array
from piezomat.forms.contact.facets import FacetKind
from piezomat.forms.contact.gap import facet_normal
from piezomat.forms.contact.laws.response import smooth_step

# Angles between a facet and the other surface: flat below the first one, tilted above the second. At 20 degrees the
# corner lies 0.07 facets inside the other body before a point of the facet meets it.
FLAT, TILTED = np.cos(np.radians([20.0, 30.0]))
# Cosine between the normals of two facets below which their corner can be tilted from a flat surface on all sides.
SHARP = float(np.cos(np.radians(40.0)))


def facet_frames(kind: FacetKind, xi: Array, nodes: Array, orientation: Array) -> Array:
    """Orthonormal axes (m, d, d), the normal last, of facets with nodes (m, n, d), each at its point xi (m, t)."""
    tangents = np.stack([np.einsum("mk,mkd->md", kind.shape(xi, (axis,)), nodes) for axis in range(kind.dim)], axis=1)
    normal = facet_normal(tangents, orientation)
    first = tangents[:, 0] / np.linalg.norm(tangents[:, 0], axis=1, keepdims=True)
    axes = [first, normal] if kind.dim == 1 else [first, np.cross(normal, first), normal]
    return np.stack(axes, axis=1)


def corner_share(normals: Array, frames: Array, other: Array) -> Array:
    """Share (m,) of corners: 0 where a facet that meets there lies flat on the other surface, 1 where all are tilted.

    normals (m, k, d): of the facets that meet at each corner, in the axes of one of them; frames (m, d, d): its present
    axes; other (m, d): normal of the other surface
    """
    cosine = -np.einsum("mka,mad,md->mk", normals, frames, other).min(axis=1)
    return smooth_step((cosine - TILTED) / (FLAT - TILTED))[0]
