"""Global search: the master facets that a rank needs, and the candidate pairs of points and facets.

A component is a connected part of one body. Points never meet facets of their own body or of their own connected part,
except in self-contact, where `SelfContact` decides which facets of one part may meet. The search works with boxes
around small clusters of neighbouring facets of one component, so that its cost is proportional to the surface and not
to the number of pairs of bodies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from piezomat.forms.arrays import Array, Booleans, Integers

SEARCH_CLUSTER = 64  # largest number of facets or points in a box


@dataclass(frozen=True)
class PairingRule:
    """Which components may meet. The number of a component is body * parts + part.

    parts: number of connected parts; ordered: only slaves of the body with the lower number meet masters of the other;
    self_contact: whether facets of one part may meet.
    """

    parts: int = 1
    ordered: bool = False
    self_contact: bool = False

    def component(self, body: NDArray, part: NDArray) -> Integers:
        """Numbers (n,) of the components of bodies (n,) and parts (n,)."""
        return np.asarray(body, np.int64) * self.parts + part

    def body(self, component: Integers) -> Integers:
        """Body of each component."""
        return component // self.parts

    def allows(self, slave: Integers, master: Integers) -> Booleans:
        """Whether points of slave components may meet facets of master components."""
        may = np.full(np.broadcast(slave, master).shape, self.self_contact)
        may |= (self.body(slave) != self.body(master)) & ~self.same_part(slave, master)
        return may & (slave <= master) if self.ordered else may

    def same_part(self, slave: Integers, master: Integers) -> Booleans:
        """Whether components belong to the same connected part."""
        return slave % self.parts == master % self.parts


@dataclass(frozen=True)
class ReversedRule(PairingRule):
    """The rule of the same fields for the masters as slaves."""

    def allows(self, slave: Integers, master: Integers) -> Booleans:
        """Whether the points of these would be met as masters."""
        return super().allows(master, slave)


# Rule for two named surfaces: every slave facet may meet every master facet. They are encoded as part 0 of a fictitious
# body 0 and part 1 of a fictitious body 1, so as components 0 and 3.
ONE_TO_ONE = PairingRule(parts=2)
SLAVE, MASTER = 0, 3


@dataclass(frozen=True)
class GhostFacets:
    """Master facets of all ranks that this rank needs.

    nodes (f, n): global node numbers; component (f,); body (f,); orientation (f,), key (f,), rounding (f, k, d) as of
    `Surface`.
    """

    nodes: Integers
    orientation: Array
    key: Integers
    component: Integers
    body: Integers
    rounding: Array

    def __len__(self) -> int:
        return len(self.nodes)

    def __getitem__(self, rows: NDArray) -> GhostFacets:
        return GhostFacets(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class Clusters:
    """Groups of neighbours of one component: boxes (b, 2, d) with corners low and high, component (b,), members."""

    boxes: Array
    component: Integers
    members: list[Integers]

    @classmethod
    def of(cls, low: Array, high: Array, component: Integers, size: int = SEARCH_CLUSTER) -> Clusters:
        """Clusters of at most `size` items with least and largest coordinates low, high (n, d)."""
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
        if not members:
            return cls(np.zeros((0, 2, low.shape[1])), np.zeros(0, np.int64), members)
        joined, size = np.concatenate(members), [len(group) for group in members]
        first = np.cumsum(size) - size
        boxes = np.stack([np.minimum.reduceat(low[joined], first), np.maximum.reduceat(high[joined], first)], axis=1)
        return cls(boxes, component[joined[first]].astype(np.int64), members)


def overlapping(first: Array, second: Array, margin: float) -> tuple[Integers, Integers]:
    """Pairs of boxes (a, 2, d) and (b, 2, d) that are within `margin` of each other along every axis."""
    if not len(first) or not len(second):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    pairs = []
    half = [0.5 * np.ptp(boxes, axis=1).max(axis=1) for boxes in (first, second)]
    # Boxes are searched in classes of size, so that a few long ones do not widen the search for all.
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
    """Master facets of all ranks that are within `margin` of slave facets of this rank and may meet them. Collective.

    Facets are sent to ranks with a box of slave facets near them, so that a rank receives little more than its
    neighbourhood.

    slave_positions (f, n, d), master_positions (f, n, d): current nodes of the facets that this rank holds, um
    slave_component (f,): components of the slave facets
    master: the master facets that this rank holds
    margin: um
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
    """Points near each component of master facets that may meet it.

    For each item: component, the number of the master component; same_part, whether the points belong to the same
    connected part; facets, the facets of the component; points, the points. A component has one item for points of its
    part and one for others.
    """

    component: Integers
    same_part: Booleans
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
        """Points (m, d) and facets (f, n, d) whose boxes are within `margin`, where the rule allows it."""
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
