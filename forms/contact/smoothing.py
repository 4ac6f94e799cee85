"""Smoothing: facets of order 1 replaced by curved ones that interpolate the nodes with continuous normals.

The curved facet is that of order 2 on the same corners. Its added nodes have no unknowns. Each side is the parabola
through its ends that is perpendicular to the nodal normals there (Nagata, Comput. Aided Geom. Design 22 (2005)
327-347). The potential stays linear between the corners.

In 2D the offset of an added node along and across its side is proportional to the length of the side. It rotates and
stretches with the facet and is linear in the corners: so are residual and tangent, and a rigid motion does not change
the surface's shape. In 3D the offset is constant in space, which is valid for small strains and rotations.
"""

from __future__ import annotations

import numpy as np

from piezomat.forms.arrays import Array, Booleans
from piezomat.forms.contact.facets import FacetKind, corner_kind, facet_kind

# Corners at the ends of the sides, in the order of the added nodes.
SIDES = {"line3": [(0, 1)], "tri6": [(1, 2), (0, 2), (0, 1)], "quad9": [(0, 1), (0, 2), (1, 3), (2, 3)]}
# Largest distance, along the side and in its length, of the parabola's middle from the side's middle. Where the
# curvature changes more than threefold from one end to the other, no parabola has both normals: they are approximated.
ALONG = 0.125
STRAIGHT = 1e-10  # 1 - cosine of the angle between two normals below which a side is straight


def curved_kind(kind: FacetKind) -> FacetKind:
    """Kind of order 2 on the corners of a facet of order 1."""
    return facet_kind({"line2": "line3", "tri3": "tri6", "quad4": "quad9"}[kind.name])


def rounding(kind: FacetKind, corners: Array, normals: Array, alone: Booleans) -> Array:
    """Offsets (f, k, d) of the added nodes of a facet `kind` of order 2: in 2D in the side's length, in 3D in um.

    corners, normals (f, n, d): coordinates, um, and unit normals at the corners
    alone (f, n): corners whose normal is that of one facet; it is replaced by the mirror image of the other end's
    """
    offsets = [_offset(corners, normals, alone, *side) for side in SIDES[kind.name]]
    if kind.name == "quad9":  # the middle node as in a Coons patch
        offsets.append(0.5 * np.sum(offsets, axis=0))
    found = np.stack(offsets, axis=1)
    if kind.dim == 1:
        side = corners[:, 1] - corners[:, 0]
        axes = np.stack([side, _turned(side)], axis=1)
        found = np.einsum("fad,fkd->fka", axes, found) / (side**2).sum(axis=1)[:, None, None]
    return found


def _offset(corners: Array, normals: Array, alone: Booleans, i: int, j: int) -> Array:
    """Vector (f, d) from the middle of the side between corners i and j to the middle of its parabola."""
    side = corners[:, j] - corners[:, i]
    square = (side**2).sum(axis=1)
    ends = []
    for a, b in ((i, j), (j, i)):
        mirrored = normals[:, b] - 2.0 * (np.einsum("fd,fd->f", normals[:, b], side) / square)[:, None] * side
        ends.append(np.where(alone[:, a, None], mirrored, normals[:, a]))
    cosine = np.einsum("fd,fd->f", *ends)
    total, change = ends[0] + ends[1], ends[0] - ends[1]
    # The parabola is x_i + (side - c) s + c s^2, with c in the plane of the two normals.
    across = np.einsum("fd,fd->f", change, side) / (2.0 * (1.0 + cosine))
    offset = -0.25 * across[:, None] * total
    if side.shape[1] == 2:
        bent = 1.0 - cosine > STRAIGHT
        along = np.einsum("fd,fd->f", total, side) / (2.0 * np.where(bent, 1.0 - cosine, 1.0))
        shift = -0.25 * np.where(bent, along, 0.0)[:, None] * change
        length = np.linalg.norm(shift, axis=1)
        bound = ALONG * np.sqrt(square)
        offset = offset + shift * (bound / np.maximum(length, bound))[:, None]
    return offset


def rounded(kind: FacetKind, corners: Array, offsets: Array) -> Array:
    """All nodes (f, n + k, d) of facets with corners (f, n, d) and offsets (f, k, d)."""
    if not offsets.shape[1]:
        return corners
    added = np.einsum("kn,fnd->fkd", _spread(kind), corners)
    if corners.shape[2] == 2:
        side = corners[:, 1] - corners[:, 0]
        added = added + np.einsum("fka,fad->fkd", offsets, np.stack([side, _turned(side)], axis=1))
    else:
        added = added + offsets
    return np.concatenate([corners, added], axis=1)


def spread(kind: FacetKind, values: Array, offsets: Array) -> Array:
    """Values (f, n + k) at all nodes from values (f, n) at the corners, linear in between."""
    if not offsets.shape[1]:
        return values
    return np.concatenate([values, values @ _spread(kind).T], axis=1)


def to_corners(kind: FacetKind, rows: Array, offsets: Array) -> Array:
    """Vectors (m, r, n, c) over the corners of facets from vectors (m, r, n + k, c) over all nodes.

    Transpose of the map from a motion of the corners to that of all nodes. offsets (m, k, d) as of `rounding`.
    """
    if not offsets.shape[1]:
        return rows
    share = _spread(kind)
    corners = share.shape[1]
    added = rows[:, :, corners:]
    result = rows[:, :, :corners] + np.einsum("kn,mrkc->mrnc", share, added)
    if kind.dim == 1:
        along, across = offsets[:, 0].T[:, :, None]
        x, y = added[:, :, 0, 0], added[:, :, 0, 1]
        change = np.stack([along * x + across * y, along * y - across * x], axis=2)
        result[:, :, 1, :2] += change
        result[:, :, 0, :2] -= change
    return result


def _spread(kind: FacetKind) -> Array:
    """Corner functions at the added nodes, (k, n)."""
    flat = corner_kind(kind)
    return flat.shape(kind.nodes[len(flat.nodes) :])


def _turned(vectors: Array) -> Array:
    """Vectors rotated by a right angle, counter-clockwise."""
    return np.stack([-vectors[:, 1], vectors[:, 0]], axis=1)
