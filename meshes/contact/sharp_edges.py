"""Sharp edges of a surface in three dimensions, and the directions of the two facets that meet there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from piezomat.forms.arrays import Array
from piezomat.forms.contact.corners import SHARP, facet_frames
from piezomat.forms.contact.edges import sides
from piezomat.forms.contact.facets import corner_kind
from piezomat.forms.contact.gap import point_normals
from piezomat.meshes.contact.global_search import GhostFacets
from piezomat.meshes.contact.nodal_normals import facets_at_nodes
from piezomat.meshes.contact.surface import Surface, global_numbers


@dataclass(frozen=True)
class EdgedFacets(GhostFacets):
    """Master facets with their sharp edges.

    edges (f, e, 2, d): see `sharp_edges`
    """

    edges: Array


def sharp_edges(space: Any, group: Surface) -> Array:
    """Normals (f, e, 2, d) of the two facets at each side of this rank's facets, in the facet's axes. Collective.

    Zero where the two do not meet at more than 40 degrees, or are in a groove and not on a ridge.
    """
    flat = corner_kind(group.kind)
    nodes = np.sort(global_numbers(space, group.nodes[:, sides(group.kind)]), axis=2)
    index_map = space.dofmap.index_map
    number = nodes[:, :, 0] * np.int64(index_map.size_global) + nodes[:, :, 1]
    corners = group.reference[:, : len(flat.nodes)]
    middle = np.tile(group.kind.middle, (len(group), 1))
    normal, center = point_normals(group.kind, middle, group.reference, group.orientation), corners.mean(axis=1)
    count = number.shape[1]
    each = np.repeat(np.concatenate([normal, center], axis=1)[:, None], count, axis=1)
    there, data = facets_at_nodes(space.mesh.comm, number, group.key, each)
    first, last = (np.searchsorted(there, number.ravel(), side=side) for side in ("left", "right"))
    two = np.flatnonzero(last - first == 2)
    facet = two // count
    meeting = data[first[two, None] + np.arange(2)]
    normals, centers = meeting[..., :3], meeting[..., 3:]
    sharp = np.einsum("kd,kd->k", normals[:, 0], normals[:, 1]) < SHARP
    ridge = np.einsum("kd,kd->k", centers[:, 1] - centers[:, 0], normals[:, 0]) < 0.0
    frames = facet_frames(group.kind, middle, group.reference, group.orientation)
    found = np.zeros((len(group) * count, 2, 3))
    local = np.einsum("kid,kad->kia", normals, frames[facet])
    found[two] = np.where((sharp & ridge)[:, None, None], local, 0.0)
    return found.reshape(len(group), count, 2, 3)
