"""Surfaces of many bodies: which facets a rank must see, and which bodies' facets each point must be tried against.

A component is a connected piece of one body. Points never meet facets of their own body, or of their own connected
part, unless self-contact is asked for: `SelfContact` then says which facets of one part may meet. Everything goes by
boxes around small clusters of neighbouring facets of one component, so that the work is proportional to the surface and
not to the number of pairs of bodies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from piezomat.forms.arrays import Array, Integers

SEARCH_CLUSTER = 64  # facets, or points, in a box of the coarse search


@dataclass(frozen=True)
class PairingRule:
    """Which components may meet. A component's number is body * parts + part.

    `ordered`: slaves of the lower body alone; `self_contact`: with self-contact.
    """

    parts: int = 1
    ordered: bool = False
    self_contact: bool = False

    def component(self, body: NDArray, part: NDArray) -> Integers:
        """Numbers of components."""
        return np.asarray(body, np.int64) * self.parts + part

    def body(self, component: Integers) -> Integers:
        """The body of each component."""
        return component // self.parts

    def allows(self, slave: Integers, master: Integers) -> NDArray[np.bool_]:
        """Whether points of the slave components may meet facets of the master components."""
        may = np.full(np.broadcast(slave, master).shape, self.self_contact)
        may |= (self.body(slave) != self.body(master)) & ~self.same_part(slave, master)
        return may & (slave <= master) if self.ordered else may

    def same_part(self, slave: Integers, master: Integers) -> NDArray[np.bool_]:
        """Whether components belong to the same connected part."""
        return slave % self.parts == master % self.parts


# One surface against another, whatever bodies they belong to: they stand for part 0 of body 0 and part 1 of body 1.
ONE_TO_ONE = PairingRule(parts=2)
SLAVE, MASTER = 0, 3


@dataclass(frozen=True)
class GhostFacets:
    """Master facets that a rank can see, from every rank.

    nodes (f, n) global, orientation (f,), key (f,), component (f,), rounding (f, k, d) as of `Surface`.
    """

    nodes: Integers
    orientation: Array
    key: Integers
    component: Integers
    rounding: Array

    def __len__(self) -> int:
        return len(self.nodes)

    def __getitem__(self, rows: NDArray) -> GhostFacets:
        return GhostFacets(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class Clusters:
    """Groups of neighbours of one component: boxes (b, 2, d), component (b,), and the members of each."""

    boxes: Array
    component: Integers
    members: list[Integers]

    @classmethod
    def of(cls, low: Array, high: Array, component: Integers, size: int = SEARCH_CLUSTER) -> Clusters:
        """Clusters of at most `size` things with extents low, high (n, d)."""
        middle = 0.5 * (low + high)
        order = np.argsort(component, kind="stable")
        groups = np.split(order, np.flatnonzero(np.diff(component[order])) + 1) if len(order) else []
        members = []
        while groups:
            group = groups.pop()
            if len(group) <= size:
                members.append(group)
                continue
            axis = np.ptp(middle[group], axis=0).argmax()
            group = group[np.argsort(middle[group, axis], kind="stable")]
            groups += [group[: len(group) // 2], group[len(group) // 2 :]]
        boxes = [np.stack([low[group].min(axis=0), high[group].max(axis=0)]) for group in members]
        numbers = np.array([component[group[0]] for group in members], np.int64)
        return cls(np.reshape(boxes, (-1, 2, low.shape[1])), numbers, members)


def overlapping(first: Array, second: Array, margin: float) -> tuple[Integers, Integers]:
    """Pairs of boxes (a, 2, d) and (b, 2, d) that come within `margin` of each other along every axis."""
    if not len(first) or not len(second):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    pairs = []
    half = [0.5 * np.ptp(boxes, axis=1).max(axis=1) for boxes in (first, second)]
    # Boxes are tried by size, so that a few long ones do not make the search wide for all.
    classes = [np.ceil(np.log2(np.maximum(h / max(h.max(), 1e-300), 2.0**-30))).astype(int) for h in half]
    for i in np.unique(classes[0]):
        a = np.flatnonzero(classes[0] == i)
        tree = cKDTree(first[a].mean(axis=1))
        for j in np.unique(classes[1]):
            b = np.flatnonzero(classes[1] == j)
            reach = half[0][a].max() + half[1][b].max() + margin
            found = tree.query_ball_point(second[b].mean(axis=1), reach, p=np.inf)
            near = np.concatenate([np.asarray(f, np.int64) for f in found])
            pairs.append(np.stack([a[near], np.repeat(b, [len(f) for f in found])]))
    a, b = np.concatenate(pairs, axis=1)
    near = np.all((first[a, 0] <= second[b, 1] + margin) & (first[a, 1] >= second[b, 0] - margin), axis=1)
    return a[near], b[near]


def share_facets(
    comm: MPI.Comm,
    slave_positions: Array,
    slave_component: Integers,
    master: GhostFacets,
    master_positions: Array,
    margin: float,
    rule: PairingRule,
) -> GhostFacets:
    """Master facets of all ranks that come within `margin` of slave facets of this rank that may meet them. Collective.

    slave_positions (f, n, d) and master_positions (f, n, d): current nodes of this rank's own facets; `master` are
    this rank's own. Facets are sent where they are near a box of slave facets, so a rank sees little more than its
    own neighbourhood.
    """
    slaves = Clusters.of(slave_positions.min(axis=1), slave_positions.max(axis=1), slave_component)
    low, high = master_positions.min(axis=1), master_positions.max(axis=1)
    masters = Clusters.of(low, high, master.component)
    parcels = []
    for boxes, component in comm.allgather((slaves.boxes, slaves.component)):
        theirs, mine = overlapping(boxes, masters.boxes, margin)
        allowed = rule.allows(component[theirs], masters.component[mine])
        near = np.zeros(len(master), bool)
        for box, cluster in zip(theirs[allowed], mine[allowed], strict=True):
            members = masters.members[cluster]
            inside = (low[members] <= boxes[box, 1] + margin) & (high[members] >= boxes[box, 0] - margin)
            near[members] |= inside.all(axis=1)
        parcels.append(master[near])
    received = comm.alltoall(parcels)
    names = GhostFacets.__dataclass_fields__
    return GhostFacets(*(np.concatenate([getattr(part, name) for part in received]) for name in names))


@dataclass(frozen=True)
class CandidatePairs:
    """What points are near: for each component of facets its number, its facets, and the points that may meet it.

    Points that are of the same connected part, `same_part`, come by themselves.
    """

    component: Integers
    same_part: NDArray[np.bool_]
    facets: list[Integers]
    points: list[Integers]

    @classmethod
    def near(
        cls,
        points: Array,
        point_component: Integers,
        facets: Array,
        facet_component: Integers,
        margin: float,
        rule: PairingRule,
    ) -> CandidatePairs:
        """Of points (m, d) and facets (f, n, d), all whose boxes come within `margin` of each other."""
        mine = Clusters.of(points, points, point_component)
        theirs = Clusters.of(facets.min(axis=1), facets.max(axis=1), facet_component)
        a, b = overlapping(mine.boxes, theirs.boxes, margin)
        allowed = rule.allows(mine.component[a], theirs.component[b])
        a, component = a[allowed], theirs.component[b[allowed]]
        same_part = rule.same_part(mine.component[a], component)
        if not len(component):
            return cls(component, same_part, [], [])
        by_component = np.argsort(facet_component, kind="stable")
        numbers, first = np.unique(facet_component[by_component], return_index=True)
        of_component = dict(zip(numbers.tolist(), np.split(by_component, first[1:]), strict=True))
        found = np.unique(np.stack([component, same_part, a], axis=1), axis=0)
        met, start = np.unique(found[:, :2], axis=0, return_index=True)
        boxes = np.split(found[:, 2], start[1:])
        near = [np.concatenate([mine.members[box] for box in group]) for group in boxes]
        return cls(met[:, 0], met[:, 1] > 0, [of_component[int(number)] for number in met[:, 0]], near)
