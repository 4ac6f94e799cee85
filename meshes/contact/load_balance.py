"""Load balance: slave facets redistributed so that every rank has as much contact, wherever their cells are."""

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

BALANCE_CLUSTER = 8  # largest number of neighbouring facets of a component that are moved together
ALONE = 0.01  # cost of a facet without another body near it, over one in contact
UNEVEN = 1.2  # largest work of a rank over the mean up to which facets stay with their cells


@dataclass(frozen=True)
class SlaveFacets:
    """Facets of a slave surface whose points this rank evaluates; every facet is on exactly one rank.

    nodes (f, n): global node numbers; component (f,), body (f,): their numbers; other attributes as of `Surface`.
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
        """Facets of a surface, on the ranks that hold their cells."""
        nodes, s = global_numbers(space, surface.nodes), surface
        return cls(s.kind, nodes, s.reference, s.orientation, s.key, s.rounding, component, np.asarray(body, np.int64))

    def __len__(self) -> int:
        return len(self.nodes)

    def redistributed(self, comm: MPI.Comm, rank: NDArray[np.int32]) -> SlaveFacets:
        """Facets that this rank receives when every facet goes to its `rank` (f,). Collective."""
        names = [field.name for field in fields(self) if field.name != "kind"]
        return replace(self, **{name: redistributed(comm, getattr(self, name), rank) for name in names})


def balanced_ranks(
    comm: MPI.Comm, slave: SlaveFacets, master: GhostFacets, master_reference: Array, margin: float, rule: PairingRule
) -> NDArray[np.int32]:
    """Rank (f,) for each slave facet such that all ranks have equally many facets near another body. Collective.

    master, master_reference (f, n, d): master facets that this rank holds, and their undeformed nodes, um
    margin: distance in the undeformed state up to which facets are near, um, positive
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
    # Facets in self-contact are near their own part everywhere.
    meets = rule.allows(clusters.component[i], component[j]) & ~rule.same_part(clusters.component[i], component[j])
    i, j = i[meets], j[meets]
    apart = np.maximum(boxes[j, 0] - clusters.boxes[i, 1], clusters.boxes[i, 0] - boxes[j, 1]).max(axis=1, initial=0.0)
    # Nearer facets are in contact for more of the motion.
    share = np.full(len(clusters.members), ALONE)
    np.maximum.at(share, i, 1.0 - apart / margin)
    work = share * np.array([len(members) for members in clusters.members])
    works = comm.allgather(work)
    shares = np.array([part.sum() for part in works])
    if shares.max() <= UNEVEN * shares.mean():
        return rank
    places = np.concatenate(comm.allgather(clusters.boxes.mean(axis=1)))
    groups = bisected(places, np.concatenate(works), comm.size)
    for members, there in zip(clusters.members, groups[sum(map(len, works[: comm.rank])) :], strict=False):
        rank[members] = there
    return rank


def bisected(places: Array, work: Array, count: int) -> NDArray[np.int32]:
    """Group (n,) of each place (n, d), out of `count` groups of equal `work` (n,), neighbours in the same if possible.

    Recursive bisection across the longer side of the work's distribution (Berger and Bokhari, IEEE Trans. Computers
    C-36 (1987) 570-580).
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
