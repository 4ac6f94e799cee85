"""Which points of a surface are looked at: those of the method, and of facets at sharp corners the corners too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from mpi4py import MPI

from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.forms.contact.facets import corner_kind
from piezomat.forms.contact.integrals import SlavePoints, nodal_points, quadrature_points, with_closed_points
from piezomat.meshes.contact.global_search import PairingRule, ReversedRule
from piezomat.meshes.contact.load_balance import SlaveFacets
from piezomat.meshes.contact.sharp_corners import SharpNodes, corners_towards
from piezomat.meshes.contact.surface import Surface
from piezomat.scene.sections import Contact as ContactKeys


def has_corner_points(keys: ContactKeys, group: Surface | SlaveFacets) -> bool:
    """Whether the method has a point at every corner; the corners of 6-node triangles have no area of a node."""
    curved = group.rounding.shape[1] > 0
    return keys.method == "node" and (curved or group.kind.name != "tri6" or keys.nodal_weight == "unit")


def facets_at_corners(
    comm: MPI.Comm,
    keys: ContactKeys,
    sharp: SharpNodes,
    slave: tuple[Surface, Integers],
    master: tuple[Surface, Integers],
    reach: float,
    rule: PairingRule,
) -> tuple[Booleans, bool]:
    """Slave facets (f,) here with points at their corners, and whether corners of the master that have none point back.

    slave, master: surfaces and components of their facets; reach: see `corners_towards`. Collective.
    """
    closed, unseen = np.zeros(len(slave[0]), bool), False
    if not has_corner_points(keys, slave[0]):
        closed = corners_towards(comm, sharp, *slave, *master, reach, rule).any(axis=1)
    if keys.passes == 1:
        back = corners_towards(comm, sharp, *master, *slave, reach, ReversedRule(**vars(rule)))
        unseen = bool(comm.allreduce(int(back.sum())))
    return closed, unseen


def slave_points(keys: ContactKeys, group: SlaveFacets, closed: Booleans, shared: Array | None = None) -> SlavePoints:
    """The points of facets that the method asks for; of nodes those with unknowns alone.

    closed (f,): facets with points at their corners whatever the method; see `meshes.contact.sharp_corners`
    shared: the `multiplicity` of `nodal_points`. Segments begin as whole facets.
    """
    if keys.method != "node":
        points = quadrature_points(group.kind, group.reference)
    elif not group.rounding.shape[1]:
        points = nodal_points(group.kind, group.reference, shared)
    else:
        flat = corner_kind(group.kind)
        points = nodal_points(flat, group.reference[:, : len(flat.nodes)], shared)
        points = replace(points, shape=group.kind.shape(points.xi))
    return with_closed_points(points, group.kind, group.reference, closed)[0] if closed.any() else points
