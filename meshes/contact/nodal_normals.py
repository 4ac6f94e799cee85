"""Normals at the nodes of a surface of flat facets, and the curved facets that follow from them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from mpi4py import MPI

from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.forms.contact.facets import FacetKind
from piezomat.forms.contact.gap import point_normals
from piezomat.forms.contact.smoothing import curved_kind, rounded, rounding
from piezomat.meshes.contact.surface import Surface, global_numbers

SHARP = 0.64  # cosine of 50 degrees: sharper edges are not smoothed


def smoothed(space: Any, group: Surface) -> Surface:
    """Surface of curved facets on the nodes of a surface of order 1 of the mesh of `space`. Collective."""
    numbers = global_numbers(space, group.nodes)
    corner = corner_normals(group.kind, group.reference, group.orientation)
    normals, alone = nodal_normals(space.mesh.comm, numbers, group.key, corner)
    kind = curved_kind(group.kind)
    offsets = rounding(kind, group.reference, normals, alone)
    return replace(group, kind=kind, reference=rounded(kind, group.reference, offsets), rounding=offsets)


def corner_normals(kind: FacetKind, nodes: Array, orientation: Array) -> Array:
    """Outward normals (f, n, d) at the corners of facets; their lengths are their weights in the mean at a node.

    With these weights the mean is the normal of the circle or sphere through the nodes, if there is one (Max, J.
    Graphics Tools 4 (1999) 1-6).
    """
    ring = [0, 1] if kind.dim == 1 else [0, 1, 2] if kind.simplex else [0, 1, 3, 2]
    found = np.zeros_like(nodes)
    for place, corner in enumerate(ring):
        xi = np.tile(kind.nodes[corner], (len(nodes), 1))
        first, last = (nodes[:, ring[(place + s) % len(ring)]] - nodes[:, corner] for s in (1, -1))
        squares = (first**2).sum(axis=1), (last**2).sum(axis=1)
        length = 1.0 / np.sqrt(squares[0])
        if kind.dim == 2:
            length = np.linalg.norm(np.cross(first, last), axis=1) / (squares[0] * squares[1])
        found[:, corner] = point_normals(kind, xi, nodes, orientation) * length[:, None]
    return found


def nodal_normals(comm: MPI.Comm, numbers: Integers, key: Integers, corner: Array) -> tuple[Array, Booleans]:
    """Unit normals (f, n, d) at the corners of facets, and whether only one facet contributes (f, n). Collective.

    A normal is the mean over the facets of all ranks that meet at the node without a sharp edge, in the same order on
    all ranks.

    numbers (f, n): global nodes; key (f,): of the facets; corner (f, n, d): their normals, see `corner_normals`
    """
    node = numbers.ravel()
    there, normals = normals_at_nodes(comm, numbers, key, corner)
    first, last = np.searchsorted(there, node), np.searchsorted(there, node, side="right")
    own = corner.reshape(len(node), corner.shape[2])
    own = own / np.linalg.norm(own, axis=1, keepdims=True)
    total, count = np.zeros_like(own), np.zeros(len(node), int)
    for k in range(int((last - first).max(initial=0))):
        row = np.minimum(first + k, len(there) - 1)
        other = normals[row]
        cosine = np.einsum("md,md->m", own, other) / np.linalg.norm(other, axis=1)
        joins = (first + k < last) & (cosine > SHARP)
        total += joins[:, None] * other
        count += joins
    total /= np.linalg.norm(total, axis=1, keepdims=True)
    return total.reshape(corner.shape), (count == 1).reshape(numbers.shape)


def normals_at_nodes(comm: MPI.Comm, numbers: Integers, key: Integers, corner: Array) -> tuple[Integers, Array]:
    """Nodes (k,), ascending, of the facets of all ranks that meet at nodes of this rank, and their normals (k, d).

    A node appears once for each of its facets, in the order of their keys. Arguments as `nodal_normals`; of each corner
    there may be more numbers than the normal's. Collective.
    """
    node = numbers.ravel()
    mine = (node, np.repeat(key, numbers.shape[1]), corner.reshape(len(node), corner.shape[2]))
    # Data at a node are collected on the rank given by its number and returned to all ranks that have the node.
    at = node % comm.size
    received = comm.alltoall([tuple(part[at == rank] for part in mine) for rank in range(comm.size)])
    every = [np.concatenate(parts) for parts in zip(*received, strict=True)]
    wanted = [np.isin(every[0], nodes) for nodes, _, _ in received]
    returned = comm.alltoall([tuple(part[rows] for part in every) for rows in wanted])
    there, keys, normals = (np.concatenate(parts) for parts in zip(*returned, strict=True))
    order = np.lexsort((keys, there))
    return there[order], normals[order]
