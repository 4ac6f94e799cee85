"""Slave facets shared out over the ranks: contact is work where surfaces are near each other, wherever cells are."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.facets import FacetKind
from piezomat.meshes.contact.global_search import Clusters, GhostFacets, PairingRule, overlapping
from piezomat.meshes.contact.surface import Surface, global_numbers
from piezomat.meshes.parallel import redistributed

BALANCE_CLUSTER = 8  # neighbouring facets of a component that stay together
ALONE = 0.01  # what a facet that no other body is near costs, over one in contact
UNEVEN = 1.2  # most work of a rank over the mean: what is more even stays where its cells are


@dataclass(frozen=True)
class SlaveFacets:
    """Facets of a slave surface whose points this rank evaluates; every facet is with exactly one rank.

    nodes (f, n): global node numbers; component (f,) and body (f,) that they belong to; all else as of `Surface`.
    """

    kind: FacetKind
    nodes: Integers
    reference: Array
    orientation: Array
    key: Integers
    rounding: Array
    component: Integers
    body: Integers

    @classmethod
    def of(cls, space: Any, surface: Surface, component: Integers, body: Integers) -> SlaveFacets:
        """The facets of a surface, with the ranks that hold their cells."""
        nodes, s = global_numbers(space, surface.nodes), surface
        return cls(s.kind, nodes, s.reference, s.orientation, s.key, s.rounding, component, np.asarray(body, np.int64))

    def __len__(self) -> int:
        return len(self.nodes)

    def redistributed(self, comm: MPI.Comm, rank: NDArray[np.int32]) -> SlaveFacets:
        """The facets that come to this rank when every facet goes to its `rank` (f,). Collective."""
        names = [field.name for field in fields(self) if field.name != "kind"]
        return replace(self, **{name: redistributed(comm, getattr(self, name), rank) for name in names})


def balanced_ranks(
    comm: MPI.Comm, slave: SlaveFacets, master: GhostFacets, master_reference: Array, margin: float, rule: PairingRule
) -> NDArray[np.int32]:
    """The rank (f,) where each slave facet should go for all ranks to have as many that another body is near.

    master, master_reference (f, n, d): this rank's own master facets and their nodes. Near is within `margin` (um, not
    zero) in the undeformed state. Collective.
    """
    rank = np.full(len(slave), comm.rank, np.int32)
    if comm.size == 1:
        return rank
    clusters, masters = (
        Clusters.of(nodes.min(axis=1), nodes.max(axis=1), component, BALANCE_CLUSTER)
        for nodes, component in ((slave.reference, slave.component), (master_reference, master.component))
    )
    boxes, component = (
        np.concatenate(parts) for parts in zip(*comm.allgather((masters.boxes, masters.component)), strict=True)
    )
    i, j = overlapping(clusters.boxes, boxes, margin)
    # What meets its own part is near itself everywhere.
    meets = rule.allows(clusters.component[i], component[j]) & ~rule.same_part(clusters.component[i], component[j])
    i, j = i[meets], j[meets]
    apart = np.maximum(boxes[j, 0] - clusters.boxes[i, 1], clusters.boxes[i, 0] - boxes[j, 1]).max(axis=1, initial=0.0)
    # What is nearer has contact for more of the motion.
    share = np.full(len(clusters.members), ALONE)
    np.maximum.at(share, i, 1.0 - apart / margin)
    work = share * np.array([len(members) for members in clusters.members])
    works = comm.allgather(work)
    shares = np.array([part.sum() for part in works])
    if shares.max() <= UNEVEN * shares.mean():
        return rank
    places = np.concatenate(comm.allgather(clusters.boxes.mean(axis=1)))
    dealt = bisected(places, np.concatenate(works), comm.size)
    for members, there in zip(clusters.members, dealt[sum(map(len, works[: comm.rank])) :], strict=False):
        rank[members] = there
    return rank


def bisected(places: Array, work: Array, count: int) -> NDArray[np.int32]:
    """Which of `count` groups of equal work each of some places (n, d) belongs to, neighbours to the same if possible.

    Recursive bisection across the longer side of where the work is (Berger and Bokhari, IEEE Trans. Computers C-36
    (1987) 570-580).
    """
    group = np.zeros(len(places), np.int32)
    parts = [(np.arange(len(places)), 0, count)]
    while parts:
        index, first, size = parts.pop()
        group[index] = first
        if size == 1 or not len(index):
            continue
        mean = np.average(places[index], axis=0, weights=work[index])
        axis = np.average((places[index] - mean) ** 2, axis=0, weights=work[index]).argmax()
        index = index[np.argsort(places[index, axis], kind="stable")]
        upto = np.cumsum(work[index])
        cut = np.searchsorted(upto - 0.5 * work[index], upto[-1] * (size // 2) / size)
        parts += [(index[:cut], first, size // 2), (index[cut:], first + size // 2, size - size // 2)]
    return group
