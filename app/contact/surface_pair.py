"""Contact passes: the points of a slave surface against a master surface, what they remember and how they are told."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from piezomat.contact.nodal_state import NodalState
from piezomat.forms.arrays import Array
from piezomat.forms.contact.augmentation import Multipliers
from piezomat.forms.contact.facets import Facets
from piezomat.forms.contact.gap import Projection, project
from piezomat.forms.contact.integrals import SlavePoints, first_changes
from piezomat.forms.contact.laws.interface import InterfaceLaw
from piezomat.forms.contact.laws.response import History, Response
from piezomat.forms.contact.laws.viscous import ViscousBonds
from piezomat.forms.contact.segments import nearest_points, segment_points
from piezomat.forms.contact.smoothing import rounded, spread
from piezomat.meshes.contact.global_search import CandidatePairs, GhostFacets, PairingRule
from piezomat.meshes.contact.load_balance import SlaveFacets
from piezomat.meshes.contact.local_search import facing_pairs, near_pairs
from piezomat.meshes.contact.self_contact import Candidates, ReferenceFacets, SelfContact

# Segments are cut anew once a point has slid by this share of a facet since: a kink that is missed by so much costs
# the square of it.
CUT_DRIFT = 1e-3
# How much further than its nodes a point of a facet may move, by the facet's order: Lebesgue's constant of triangles.
LARGEST_SHAPE = {1: 1.0, 2: 5.0 / 3.0}
EVERY = slice(None)


@dataclass(frozen=True)
class Pairs:
    """How pairs are numbered and named: those of the scene in their order, or two bodies i < j as i * count + j.

    listed: the pairs that have columns in the history, and their numbers in the contact points written.
    """

    bodies: tuple[str, ...]
    given: tuple[str, ...] | None
    listed: dict[int, str]

    def name(self, number: int) -> str:
        """The name of a pair."""
        if self.given is not None:
            return self.given[number]
        return "-".join(self.bodies[i] for i in divmod(number, len(self.bodies)))

    def of_bodies(self, first: NDArray[np.int64], second: NDArray[np.int64]) -> NDArray[np.int64]:
        """Numbers of pairs of bodies."""
        return np.minimum(first, second) * len(self.bodies) + np.maximum(first, second)


@dataclass
class SurfacePair:
    """One pass: points of the slave surface, each against the facets of the master surface that it may meet.

    A pass is of one pair of surfaces, or of all bodies of one kind against all of another: `rule` then says by
    their components which facets may meet. `slave` are those whose points this rank evaluates, `master` those whose
    cells it holds, `first` whether the slave is the first of its pair. `share` is the pass's share of the contact
    enthalpy (1/2 each with two passes). `meets`: which points can meet anything, as pieces that no master facet
    covers cannot. After a pairing, `rows` are the points near the master, `candidates` for each of the `meetings`
    the facets of their own part that they may meet, or None if it is not their own, `facet` and `xi` their
    partners in `visible` and where, `met` those of the rows that have one, and `found_beyond` the share of a facet
    by which a point that did not touch was beyond its partner when that was found; all else is further off than
    `clear` - `approach` (um), which is how much nearer things may have come, growing from search to search. The
    last evaluation is kept, with `force` and `position` (m, d) of the points that met a facet, and `gap` (m,),
    which the law sees: that of `projection` and the multipliers' `shift`. foreseen (2, m): changes of gap and jump
    after which the law is to answer, see `foresight`.
    size (m,): size of each point's slave facet, um. depth: a point further inside a body than this (um) has come from
    its far side and meets nothing; own_depth: the same in its own part, thinner than it seems if it is bent.

    With `segments`, points are those of the slave facets' pieces, anew at every pairing; penalties and adhesion are a
    facet's, and a new point takes the history of the nearest one that its facet had at the last converged step.
    """

    pair: int
    slave: SlaveFacets
    master: GhostFacets
    master_bodies: frozenset[int]
    rule: PairingRule
    points: SlavePoints
    law: InterfaceLaw
    share: float
    first: bool
    facet_size: Array
    depth: float
    self_depth: float
    segments: bool = False
    covered: NDArray[np.bool_] = field(init=False)
    history: History = field(init=False)
    multipliers: Multipliers = field(init=False)
    viscous_bonds: ViscousBonds = field(init=False)
    candidate_pairs: CandidatePairs = field(init=False)
    self_candidates: list[Candidates | None] = field(init=False)
    ghost_facets: GhostFacets = field(init=False)
    self_contact: SelfContact | None = field(init=False, default=None)
    near_points: NDArray[np.int64] = field(init=False)
    master_facet: NDArray[np.int64] = field(init=False)
    master_xi: Array = field(init=False)
    initial_overshoot: Array = field(init=False)
    distance_bound: Array = field(init=False)
    motion_since_search: Array = field(init=False)
    slave_nodes: NDArray[np.int64] = field(init=False)
    master_nodes: NDArray[np.int64] = field(init=False)
    projected: NDArray[np.int64] = field(init=False)
    projection: Projection | None = field(init=False, default=None)
    gap: Array = field(init=False)
    response: Response | None = field(init=False, default=None)
    jump: Array | None = field(init=False, default=None)
    force: Array = field(init=False)
    position: Array = field(init=False)
    predicted: Array | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        first = np.searchsorted(self.points.facet, np.arange(len(self.slave)))
        self._of_facets = (self.law[first], self.facet_size[first]) if self.segments else None
        self.covered = np.ones(len(self.points.weight), bool)
        self.history = History.virgin(len(self.points.weight))
        self.multipliers = Multipliers.none(self.slave.kind, len(self.slave))
        self.viscous_bonds = ViscousBonds.none(len(self.points.weight))
        self.mark_converged()

    @property
    def projected_points(self) -> NDArray[np.int64]:
        """Numbers of the projected points among all points, (projected,)."""
        return self.near_points[self.projected]

    @property
    def partner(self) -> NDArray[np.int64]:
        """The master facet of each projected point, (projected,)."""
        return self.master_facet[self.projected]

    def mark_converged(self) -> None:
        """Take points and history for those of the last converged step."""
        self._converged = self.snapshot()

    def snapshot(self) -> tuple[SlavePoints, History, Multipliers]:
        """What is remembered of a converged step: points, their history, their multipliers."""
        return self.points, self.history.copy(), self.multipliers.copy()

    def restore(self, memory: tuple[SlavePoints, History, Multipliers]) -> None:
        """Go back to what was remembered."""
        self._take(memory[0])
        self.history, self.multipliers, self._converged = memory[1].copy(), memory[2].copy(), memory

    def restore_multipliers(self) -> None:
        """Go back to the multipliers of the last converged step: those of a solve that failed are worth nothing."""
        self.multipliers = self._converged[2].copy()

    def cut_segments(self, position: Array, reach: float) -> None:
        """Cut the slave facets along the edges of master facets within `reach`, nodes being at `position`."""
        kind = self.slave.kind
        slave = Facets(kind, self.slave_at(position), self.slave.orientation, self.slave.key)
        master = Facets(kind, self.master_at(position), self.ghost_facets.orientation, self.ghost_facets.key)
        pairs = facing_pairs(slave, master, reach)
        allowed = self.may_meet(*pairs)
        pairs = pairs[0][allowed], pairs[1][allowed]
        before, (converged, history, _) = self.points, self._converged
        points, meets = segment_points(self.slave.reference, slave, master, pairs)
        drag = self.viscous_bonds[nearest_points(points.facet, points.xi, before)]
        self._take(points)
        self.covered, self.viscous_bonds = meets, drag
        self._whole = ~np.isin(points.facet, pairs[0])
        self.history = history[nearest_points(points.facet, points.xi, converged)]

    def reference_self_contact(self, reference: Array, geodesic: Array) -> SelfContact:
        """The surface in the undeformed state; nodes are at `reference` (n, d), with `geodesic` distances (n,)."""
        kind, slave, visible = self.slave.kind, self.slave_at(reference), self.master_at(reference)
        ours, theirs = geodesic[self.slave_nodes], geodesic[self.master_nodes]
        return SelfContact(
            ReferenceFacets.of(kind, slave, self.slave.orientation, ours, self.slave_nodes, self.slave.key),
            ReferenceFacets.of(
                kind, visible, self.ghost_facets.orientation, theirs, self.master_nodes, self.ghost_facets.key
            ),
        )

    def may_meet(self, slave: NDArray[np.int64], master: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether points of slave facets may meet visible master facets, (k,) each."""
        ours, theirs = self.slave.component[slave], self.ghost_facets.component[master]
        may = self.rule.allows(ours, theirs)
        if self.self_contact is not None:
            joined = np.flatnonzero(may & self.rule.same_part(ours, theirs))
            pairs = slave[joined], master[joined]
            may[joined] = self.self_contact.may_meet(*pairs)
            if self.rule.ordered:
                may[joined] &= (ours != theirs)[joined] | self.self_contact.precedes(*pairs)
        return may

    def near_self_candidates(
        self, position: Array, slaves: NDArray[np.int64], facets: NDArray[np.int64], margin: float
    ) -> Candidates:
        """Those `facets` of their own part that points of slave facets may meet and that come within `margin`."""
        i, j = near_pairs(self.slave_at(position, slaves), self.master_at(position, facets), margin)
        may = self.may_meet(slaves[i], facets[j])
        return Candidates.of(slaves[i[may]], j[may], len(self.slave))

    def slave_at(self, position: Array, facet: NDArray | slice = EVERY) -> Array:
        """Nodes (f, n, d) of slave facets, those of curved ones that have no number included, nodes at `position`."""
        return rounded(self.slave.kind, position[self.slave_nodes[facet]], self.slave.rounding[facet])

    def master_at(self, position: Array, facet: NDArray | slice = EVERY) -> Array:
        """The same of the visible master facets."""
        return rounded(self.slave.kind, position[self.master_nodes[facet]], self.ghost_facets.rounding[facet])

    def largest_motions(self, change: Array, bodies: int) -> Array:
        """How far (bodies,) the facets of each body that are seen here have moved at most, nodes by `change` (n, d)."""
        length = LARGEST_SHAPE[self.slave.kind.order] * np.linalg.norm(change, axis=1)
        found = np.zeros(bodies)
        for component, nodes in (
            (self.slave.component, self.slave_nodes),
            (self.ghost_facets.component, self.master_nodes),
        ):
            np.maximum.at(found, self.rule.body(component), length[nodes].max(axis=1, initial=0.0))
        return found

    def add_motion(self, motions: Array) -> None:
        """Note that bodies have moved by these distances (b,)."""
        others = np.zeros(len(self.near_points))
        for near, component in zip(self.candidate_pairs.points, self.candidate_pairs.component, strict=True):
            others[near] = np.maximum(others[near], motions[self.rule.body(component)])
        self.motion_since_search += (
            motions[self.rule.body(self.slave.component[self.points.facet[self.near_points]])] + others
        )

    def potentials_at(self, potentials: Array, slave: NDArray, master: NDArray) -> tuple[Array, Array]:
        """Nodal potentials (m, n) of slave and of master facets."""
        kind = self.slave.kind
        return (
            spread(kind, potentials[self.slave_nodes[slave]], self.slave.rounding[slave]),
            spread(kind, potentials[self.master_nodes[master]], self.ghost_facets.rounding[master]),
        )

    def first_changes(self, at: NodalState, change: Array) -> Array:
        """First-order changes (2, m), um and V, of gaps and jumps with those (n, block_size) of the nodes' unknowns."""
        rows, partner = self.projected_points, self.partner
        facet, there = self.points.facet[rows], None
        if self.jump is not None:
            there = self.potentials_at(at.potentials, facet, partner)[1]
        nodes = np.concatenate([self.slave_nodes[facet], self.master_nodes[partner]], axis=1)
        roundings = self.slave.rounding[facet], self.ghost_facets.rounding[partner]
        kind, shape = self.slave.kind, self.points.shape[rows]
        changes = first_changes(kind, self.projection, shape, change[nodes], there, roundings=roundings)
        return changes * [[1.0], [at.scale or 0.0]]

    def has_slid(self, before: Array, reach: float) -> bool:
        """Whether points that answer have slid since the nodes were at `before`, or are on facets never cut."""
        answers = (self.projection.gap < reach) | (self.response.slope != 0.0)
        rows, met = self.near_points[self.projected[answers]], self.projected[answers]
        facet, master = self.points.facet[rows], self.master_facet[met]
        points = np.einsum("mk,mkd->md", self.points.shape[rows], self.slave_at(before, facet))
        nodes, sign, xi = self.master_at(before, master), self.ghost_facets.orientation[master], self.master_xi[met]
        slide = np.abs(project(self.slave.kind, points, nodes, sign, xi).xi - xi).max(initial=0.0)
        return bool(slide > CUT_DRIFT or self._whole[rows].any())

    def _take(self, points: SlavePoints) -> None:
        self.points, self.covered = points, np.ones(len(points.weight), bool)
        self.viscous_bonds = ViscousBonds.none(len(points.weight))
        if self.segments:
            law, size = self._of_facets
            self.law, self.facet_size = law[points.facet], size[points.facet]

    def partner_component(self) -> NDArray[np.int64]:
        """The component that each point of the last evaluation met, (met,)."""
        return self.ghost_facets.component[self.partner]

    def is_self_contact(self) -> NDArray[np.bool_]:
        """Whether each point of the last evaluation met a facet of its own connected part, (met,)."""
        return self.rule.same_part(
            self.slave.component[self.points.facet[self.projected_points]], self.partner_component()
        )

    def pair_numbers(self, pairs: Pairs) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Number of the pair that each point met belongs to, and whether the point is on the first of the two.

        Of a body and itself the first is what comes first along it.
        """
        if pairs.given is not None:
            return np.full(len(self.projected), self.pair), np.full(len(self.projected), self.first)
        slave = self.rule.body(self.slave.component[self.points.facet[self.projected_points]])
        master = self.rule.body(self.partner_component())
        first = slave < master
        if self.self_contact is not None:
            same = np.flatnonzero(slave == master)
            first[same] = self.self_contact.precedes(
                self.points.facet[self.near_points[self.projected[same]]], self.master_facet[self.projected[same]]
            )
        return pairs.of_bodies(slave, master), first

    def keys(self) -> NDArray[np.int64]:
        """(m, 4) numbers of the points that do not depend on the partition: pair, pass, facet, place."""
        return self._keys(self.points.facet, self.points.place)

    def corner_keys(self) -> NDArray[np.int64]:
        """(facets * corners, 4) numbers of the corners of the facets."""
        return self._keys(*(index.ravel() for index in np.indices(self.multipliers.gap.shape)))

    def possible_keys(self, places: int) -> NDArray[np.int64]:
        """Keys of all points that the facets could have, so many places each."""
        facet, place = np.divmod(np.arange(len(self.slave) * places), places)
        return self._keys(facet, place)

    def restore_points(self, xi: Array, found: NDArray[np.bool_], places: int) -> None:
        """Take the points of a checkpoint, asked for by `every_key`; their weights come when they are cut anew."""
        facet, place = np.divmod(np.flatnonzero(found), places)
        none = np.zeros(len(facet))
        self._take(SlavePoints(facet, place, xi[found], self.slave.kind.shape(xi[found]), none, none))
        self.history = History.virgin(len(facet))

    def _keys(self, facet: NDArray[np.int64], place: NDArray[np.int64]) -> NDArray[np.int64]:
        same = np.ones(len(facet), np.int64)
        return np.stack([self.pair * same, int(self.first) * same, self.slave.key[facet], place], axis=1)
