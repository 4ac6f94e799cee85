"""Nodes of a master surface that lie inside the slave's body where the slave alone has contact points."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from piezomat.contact.surface_pair import SurfacePair
from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.facets import Facets
from piezomat.meshes.contact.facet_bounds import TIE
from piezomat.meshes.contact.global_search import CandidatePairs, ReversedRule
from piezomat.meshes.contact.signed_distance import PointFacetPairs, relevant_pairs


def penetrating_master_nodes(
    comm: MPI.Comm, p: SurfacePair, position: Array, reach: float
) -> tuple[Integers, Integers, Array]:
    """Slave and master facet (k,) of each such node seen here, and its depth (k,), um.

    position (n, d): of the seen nodes; reach: um, depth up to which nodes are looked for. The nearest facet of all
    ranks decides, so the deepest one is the same on any number of them. Collective.
    """
    facets, master = p.facets, p.facets.master
    component = np.repeat(master.component, master.nodes.shape[1])
    key = np.stack([master.nodes.ravel(), component], axis=1)
    nodes, place = np.unique(key, axis=0, return_index=True)
    x, slaves = position[facets.master_nodes.ravel()[place]], facets.slave_at(position)
    rule = ReversedRule(**vars(p.rule))
    keys, found = [np.zeros((0, 3), np.int64)], [(np.zeros((2, 0), np.int64), np.zeros((3, 0)))]
    near = CandidatePairs.near(x, nodes[:, 1], slaves, facets.slave.component, reach, rule)
    for number, same_part, targets, rows in zip(*vars(near).values(), strict=True):
        if same_part or not len(rows):
            continue
        some = Facets(facets.kind, slaves[targets], facets.slave.orientation[targets], facets.slave.key[targets])
        seen, _ = relevant_pairs(x[rows], np.zeros_like(x[rows]), some, reach, None, facing=False)
        seen = _nearest(seen, len(rows))
        row = rows[seen.row]
        keys.append(np.column_stack([nodes[row], np.full(len(row), number)]))
        of = np.stack([targets[seen.facet], place[row] // master.nodes.shape[1]])
        found.append((of, np.stack([seen.gap, seen.distance, seen.size])))
    key = np.concatenate(keys)
    (slave, of_master), (gap, distance, size) = (np.concatenate(part, axis=1) for part in zip(*found, strict=True))
    asked = np.unique(np.concatenate(comm.allgather(key[gap < 0.0])), axis=0)
    order = {tuple(one): i for i, one in enumerate(asked.tolist())}
    at = np.array([order.get(tuple(one), -1) for one in key.tolist()], np.int64)
    mine = np.flatnonzero(at >= 0)
    least = np.full(len(asked), np.inf)
    least[at[mine]] = distance[mine]
    comm.Allreduce(MPI.IN_PLACE, least, op=MPI.MIN)
    mine = mine[distance[mine] <= least[at[mine]] + TIE * size[mine]]
    largest = np.zeros(len(asked))
    largest[at[mine]] = np.abs(gap[mine])
    comm.Allreduce(MPI.IN_PLACE, largest, op=MPI.MAX)
    inside = mine[(gap[mine] < 0.0) & (np.abs(gap[mine]) >= largest[at[mine]])]
    return slave[inside], of_master[inside], -gap[inside]


def _nearest(seen: PointFacetPairs, points: int) -> PointFacetPairs:
    """The pair of each point with its nearest facet; of equally near ones with the largest gap, or depth."""
    tied = seen[seen.distance <= seen.least(points)[seen.row] + TIE * seen.size]
    order = np.lexsort((-np.abs(tied.gap), tied.row))
    _, first = np.unique(tied.row[order], return_index=True)
    return tied[order[first]]
