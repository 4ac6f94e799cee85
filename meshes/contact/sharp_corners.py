"""Sharp edges and vertices with which a body faces another one in the undeformed state.

Points inside facets do not see them: they lie a fifth of a facet behind what comes first. So the facets that meet there
get points at their corners too. A facet that lies flat on the other surface needs none, since its own points are as
deep, and at the rim of a flat contact such a point would be beside the other body by rounding. Flat and round contacts
keep their points: a corner counts if only plane faces meet there, two of them at more than 50 degrees, and the
direction to the other body is tilted from each of their normals by more than a quarter of a degree and lies in the
cone of these normals, or less than 10 degrees beside it. The rims of round fibers do not count: in a mat some are near
other fibers, and with such points a step of a coarse mat did not converge that does without.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.forms.contact.facets import Facets, corner_kind
from piezomat.forms.contact.gap import point_normals
from piezomat.meshes import parallel
from piezomat.meshes.contact.facet_bounds import TIE
from piezomat.meshes.contact.global_search import CandidatePairs, PairingRule
from piezomat.meshes.contact.nodal_normals import SHARP, corner_normals, nodal_normals, normals_at_nodes
from piezomat.meshes.contact.signed_distance import relevant_pairs
from piezomat.meshes.contact.surface import Surface, global_numbers

PLANE = 1e-3  # radians between a facet and the mean of its neighbours, up to which they are of one plane face
TILT = np.radians(0.25)  # at less the points of a facet are at most 0.001 facets behind its corner
BESIDE = np.radians(10.0)  # loads turn edges and vertices a little


@dataclass(frozen=True)
class SharpNodes:
    """Nodes of this rank's outside facets where plane faces meet at sharp edges, with their facets on all ranks.

    node (s,): local numbers, ascending; reference (s, d): um
    normals (s, k, d): unit normals of the facets at the node, means over those without a sharp edge between them
    """

    node: Integers
    reference: Array
    normals: Array

    @classmethod
    def of(cls, space: Any, outside: Surface) -> SharpNodes:
        """The sharp nodes of the outside of all bodies. Collective."""
        count = len(corner_kind(outside.kind).nodes)
        nodes = outside.nodes[:, :count]
        corner = corner_normals(outside.kind, outside.reference, outside.orientation)[:, :count]
        numbers, comm = global_numbers(space, nodes), space.mesh.comm
        means, _ = nodal_normals(comm, numbers, outside.key, corner)
        middle = np.tile(outside.kind.middle, (len(nodes), 1))
        own = point_normals(outside.kind, middle, outside.reference, outside.orientation)
        plane = np.linalg.norm(means - own[:, None], axis=2, keepdims=True) < PLANE
        there, data = normals_at_nodes(comm, numbers, outside.key, np.concatenate([means, plane], axis=2))
        node, place = np.unique(nodes, return_index=True)
        number = numbers.ravel()[place]
        first, last = (np.searchsorted(there, number, side=side) for side in ("left", "right"))
        most = int((last - first).max(initial=1))
        meeting = data[np.minimum(first[:, None] + np.arange(most), last[:, None] - 1)]
        meeting, plane = meeting[..., :-1], (meeting[..., -1] > 0.0).all(axis=1)
        sharp = plane & (np.einsum("skd,sld->skl", meeting, meeting).min(axis=(1, 2), initial=1.0) < SHARP)
        reference = outside.reference[:, :count].reshape(-1, outside.reference.shape[2])[place]
        return cls(node[sharp].astype(np.int64), reference[sharp], meeting[sharp])

    def of_facets(self, group: Surface) -> Integers:
        """Place (f, c) among the sharp nodes of each corner of the facets of a surface, -1 for none."""
        nodes = group.nodes[:, : len(corner_kind(group.kind).nodes)]
        if not len(self.node):
            return np.full(nodes.shape, -1)
        place = np.minimum(np.searchsorted(self.node, nodes), len(self.node) - 1)
        return np.where(self.node[place] == nodes, place, -1)

    def point_to(self, some: Integers, direction: Array) -> Booleans:
        """Whether the edge or vertex at some nodes (m,) points to what lies in the direction (m, d)."""
        cosine = np.einsum("mkd,md->mk", self.normals[some], direction).max(axis=1, initial=-1.0)
        points = (cosine < np.cos(TILT)) & (cosine > 0.0)
        if points.any():
            from scipy.optimize import nnls  # here: it takes a twentieth of the time of a small scene
        for row in np.flatnonzero(points):
            _, away = nnls(self.normals[some[row]].T, direction[row])
            points[row] = away < np.sin(BESIDE)
        return points


def corners_towards(
    comm: MPI.Comm,
    sharp: SharpNodes,
    slave: Surface,
    slave_component: Integers,
    master: Surface,
    master_component: Integers,
    reach: float,
    rule: PairingRule,
) -> Booleans:
    """Corners (f, c) of the slave facets here that point to the nearest facets of a body within `reach`, um.

    Each component of the master counts by itself, but not the own one; components (f,) of the facets here. Collective.
    """
    place = sharp.of_facets(slave)
    facet, corner = np.nonzero(place >= 0)
    found = np.zeros(place.shape, bool)
    if not comm.allreduce(len(facet)):
        return found
    each = np.stack([place[facet, corner], slave_component[facet]], axis=1)
    each, back = np.unique(each, axis=0, return_inverse=True)
    x = sharp.reference[each[:, 0]]
    # To the ranks whose master facets come near, and back with the nearest facets of each component.
    low, high = master.reference.min(axis=(0, 1), initial=np.inf), master.reference.max(axis=(0, 1), initial=-np.inf)
    parcels = []
    for there_low, there_high in comm.allgather((low, high)):
        near = np.flatnonzero(((x >= there_low - reach) & (x <= there_high + reach)).all(axis=1))
        parcels.append((near, x[near], each[near, 1]))
    asked = comm.alltoall(parcels)
    answers = comm.alltoall([_nearest(row, at, of, master, master_component, reach, rule) for row, at, of in asked])
    row, component, distance, size, normal = (np.concatenate(part) for part in zip(*answers, strict=True))
    if len(row):
        _, group = np.unique(np.stack([row, component], axis=1), axis=0, return_inverse=True)
        least = np.full(int(group.max()) + 1, np.inf)
        np.minimum.at(least, group.ravel(), distance)
        tied = np.flatnonzero(distance <= least[group.ravel()] + TIE * size)
        towards = np.zeros(len(each), bool)
        np.logical_or.at(towards, row[tied], sharp.point_to(each[row[tied], 0], -normal[tied]))
        found[facet, corner] = towards[back.ravel()]
    return found


def corners_towards_plane(
    comm: MPI.Comm, sharp: SharpNodes, slave: Surface, start: Array, normal: Array, reach: float
) -> Booleans:
    """Corners (f, c) of the slave facets here that point to a plane. Collective.

    start, normal (d,): a point of the plane and its normal, which points to the bodies; reach: um, beyond the corner
    that is nearest to the plane
    """
    gap = (slave.reference - start) @ normal
    near = parallel.least(comm, np.array([gap.min(initial=np.inf)]))[0] + reach
    place = sharp.of_facets(slave)
    facet, corner = np.nonzero((place >= 0) & (gap[:, : place.shape[1]] <= near))
    found = np.zeros(place.shape, bool)
    found[facet, corner] = sharp.point_to(place[facet, corner], np.tile(-normal, (len(facet), 1)))
    return found


def _nearest(
    row: Integers,
    points: Array,
    component: Integers,
    master: Surface,
    master_component: Integers,
    reach: float,
    rule: PairingRule,
) -> tuple[Integers, Integers, Array, Array, Array]:
    """Nearest facets here of each component: number of the point, component, distance, size (k,), normal (k, d)."""
    none = np.zeros(0, np.int64)
    every = [(none, none, np.zeros(0), np.zeros(0), np.zeros((0, points.shape[1])))]
    pairs = CandidatePairs.near(points, component, master.reference, master_component, reach, rule)
    for number, same_part, facets, near in zip(*vars(pairs).values(), strict=True):
        if same_part or not len(near):
            continue
        some = Facets(master.kind, master.reference[facets], master.orientation[facets], master.key[facets])
        seen, _ = relevant_pairs(points[near], np.zeros_like(points[near]), some, reach, None, facing=False)
        seen = seen[seen.distance <= seen.least(len(near))[seen.row] + TIE * seen.size]
        # Beside the end of a facet, what it faces is not what the corner points to.
        seen = seen[np.abs(seen.gap) >= np.cos(BESIDE) * seen.distance - TIE * seen.size]
        at = row[near[seen.row]]
        every.append((at, np.full(len(at), number), seen.distance, seen.size, seen.normal))
    return tuple(np.concatenate(part) for part in zip(*every, strict=True))
