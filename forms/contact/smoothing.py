"""Facets of order 1 as curved ones: a surface that interpolates the nodes, with normals continuous from facet to facet.

A facet is taken for the one of order 2 on its corners. Its added nodes carry no unknowns; each side is the parabola
through its ends that is perpendicular to the nodal normals there (Nagata, Comput. Aided Geom. Design 22 (2005)
327-347). The potential stays linear between the corners.

In 2D an added node keeps its place along and across its side, in the side's length. That turns and stretches with the
facet, and is linear in the corners: so are residual and tangent, and a rigid motion leaves the surface as it is. In 3D
it keeps its offset in space, as small strains and rotations allow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezomat.forms.arrays import Array
from piezomat.forms.contact.augmentation import corner_kind
from piezomat.forms.contact.facets import FacetKind, facet_kind

# Corners at the ends of the sides, in the order of the added nodes.
SIDES = {"line3": [(0, 1)], "tri6": [(1, 2), (0, 2), (0, 1)], "quad9": [(0, 1), (0, 2), (1, 3), (2, 3)]}
# How far along its side the middle of a parabola may lie from the side's middle, in the side's length: where the
# curvature changes more than threefold from one end to the other no parabola suits, and normals are met nearly.
ALONG = 0.125
STRAIGHT = 1e-10  # 1 - cosine of the angle between two normals below which a side is straight


def curved_kind(kind: FacetKind) -> FacetKind:
    """The facet of order 2 on the corners of one of order 1."""
    return facet_kind({"line2": "line3", "tri3": "tri6", "quad4": "quad9"}[kind.name])


def rounding(kind: FacetKind, corners: Array, normals: Array, alone: NDArray[np.bool_]) -> Array:
    """Offsets (f, k, d) of the added nodes of a facet `kind` of order 2: in 2D in the side's length, in 3D in um.

    corners (f, n, d) with unit normals (f, n, d); where a corner is `alone` (f, n) its normal has no say, and the
    side is bent evenly.
    """
    offsets = [_offset(corners, normals, alone, *side) for side in SIDES[kind.name]]
    if kind.name == "quad9":  # in the middle, as of a Coons patch
        offsets.append(0.5 * np.sum(offsets, axis=0))
    found = np.stack(offsets, axis=1)
    if kind.dim == 1:
        side = corners[:, 1] - corners[:, 0]
        axes = np.stack([side, _turned(side)], axis=1)
        found = np.einsum("fad,fkd->fka", axes, found) / (side**2).sum(axis=1)[:, None, None]
    return found


def _offset(corners: Array, normals: Array, alone: NDArray[np.bool_], i: int, j: int) -> Array:
    """From the middle of a side to that of its parabola, (f, d)."""
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
    """All nodes (f, n + k, d) of facets with corners (f, n, d) and offsets (f, k, d); k = 0: the corners alone."""
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
    """Values (f, n) at the corners at all nodes (f, n + k), linear between the corners."""
    if not offsets.shape[1]:
        return values
    return np.concatenate([values, values @ _spread(kind).T], axis=1)


def to_corners(kind: FacetKind, rows: Array, offsets: Array) -> Array:
    """Vectors (m, r, n + k, c) over the nodes of facets, offsets (m, k, d), as ones (m, r, n, c) over their corners.

    What they say of a motion of all nodes they then say of the motion of the corners that causes it.
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
    """Turned by a right angle, counter-clockwise."""
    return np.stack([-vectors[:, 1], vectors[:, 0]], axis=1)
