"""Corners of a surface where it has an edge, and the directions of the facets that meet there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.corners import SHARP, facet_frames
from piezomat.forms.contact.facets import corner_kind
from piezomat.meshes.contact.nodal_normals import corner_normals, facets_at_nodes
from piezomat.meshes.contact.surface import Surface, global_numbers


@dataclass(frozen=True)
class SharpCorners:
    """Corners of facets at which two facets of the surface meet at more than 40 degrees.

    facet (c,), place (c,): facet and number of the corner in it
    normals (c, k, d): undeformed normals of the facets that meet there, in the facet's axes; some are repeated
    """

    facet: Integers
    place: Integers
    normals: Array

    def __len__(self) -> int:
        return len(self.facet)


def sharp_corners(space: Any, group: Surface) -> SharpCorners:
    """The sharp corners of this rank's facets of a surface. Collective."""
    count = len(corner_kind(group.kind).nodes)
    numbers = global_numbers(space, group.nodes[:, :count])
    corner = corner_normals(group.kind, group.reference, group.orientation)[:, :count]
    node = numbers.ravel()
    there, normals = facets_at_nodes(space.mesh.comm, numbers, group.key, corner)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    first, last = np.searchsorted(there, node), np.searchsorted(there, node, side="right")
    most = int((last - first).max(initial=1))
    meeting = normals[np.minimum(first[:, None] + np.arange(most), last[:, None] - 1)]
    least = np.einsum("mkd,mld->mkl", meeting, meeting).min(axis=(1, 2), initial=1.0)
    facet, place = np.divmod(np.flatnonzero(least < SHARP), count)
    frames = facet_frames(group.kind, group.kind.nodes[place], group.reference[facet], group.orientation[facet])
    normals = np.einsum("mkd,mad->mka", meeting[facet * count + place], frames)
    return SharpCorners(facet, place, normals)
