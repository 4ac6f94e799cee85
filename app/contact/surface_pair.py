"""Contact of a slave surface with master surfaces: one pass of a pair of surfaces, or of many bodies."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from piezomat.contact.closest_points import ClosestPoints, SearchLimits
from piezomat.contact.contact_points import ContactPoints, Snapshot
from piezomat.contact.detected_facets import DetectedFacets
from piezomat.contact.gap_exchange import GapExchange
from piezomat.contact.nodal_state import NodalState
from piezomat.contact.pair_laws import PairLaws
from piezomat.contact.pairs import Pairs
from piezomat.contact.seen_nodes import SeenNodes
from piezomat.contact.shared_points import SharedPoints, force_on_master
from piezomat.contact.terms import ContactTerms
from piezomat.discretization.state import Points, ReadPoints
from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.forms.contact.blending import blended_changes
from piezomat.forms.contact.integrals import (
    FacetPairs,
    PointForces,
    SlavePoints,
    contact_vectors,
    first_changes,
)
from piezomat.forms.contact.laws.law import ContactLaw
from piezomat.meshes.contact.global_search import GhostFacets, PairingRule


@dataclass(kw_only=True)
class SurfacePair(ContactPoints):
    """Points of slave facets against the master facets that they may meet.

    One pass of a pair of surfaces that the scene names, or of all bodies against all.

    Given, besides what `ContactPoints` has:
    master: master facets whose cells this rank holds
    master_bodies: bodies that the master facets of all ranks belong to
    laws: by the two bodies that meet; `law` is that with the body that a point meets, or has met last
    rule: which connected components may meet
    first: whether the slave is the first surface of its pair
    depth: penetration (um) beyond which a point has come from the far side of a body and meets nothing
    self_depth: the same in its own part, which is thinner than it seems if it is bent
    closed (f,): slave facets with points at their corners
    sharp (f, c): whether there is a sharp edge at each corner of the slave facets
    unseen_corners: whether edges or vertices of the master point to the slave, which has the only points
    blending: width over which master facets share points near their edges, see `SharedPoints`; 0: they do not
    exchange: charges across open gaps, which the points leave out; None without a medium

    Valid after a detection:
    covered (m,): points that can meet something; pieces of a facet that no master facet covers cannot
    facets: slave facets and the master facets within the search radius
    closest: near points and their closest points

    Valid after an evaluation:
    master_facet (r,): master facet of each projected point
    shared: the projected points that several master facets share; they are numbered by their place among these
    force (r, d): force that each projected point exerts on the master, uN
    """

    master: GhostFacets
    master_bodies: frozenset[int]
    laws: PairLaws
    rule: PairingRule
    first: bool
    depth: float
    self_depth: float
    closed: Booleans
    sharp: Booleans
    unseen_corners: bool = False
    blending: float = 0.0
    exchange: GapExchange | None = None
    covered: Booleans = field(init=False)
    facets: DetectedFacets = field(init=False)
    closest: ClosestPoints = field(init=False)
    master_facet: Integers = field(init=False)
    shared: SharedPoints = field(init=False)
    force: Array = field(init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.covered = np.ones(len(self.points.weight), bool)
        self._start_history()
        self._keep()

    @property
    def possible_laws(self) -> list[ContactLaw]:
        """The law of all points with each kind of body that they may meet."""
        kinds = np.unique(self.laws.kind[sorted(self.master_bodies)])
        size, own = self.facet_size, self._own_kind()
        return [self.laws.at(size, own, np.full(len(size), kind)) for kind in kinds]

    @property
    def side(self) -> int:
        """1 for the first surface of the pair, 0 for the second one."""
        return int(self.first)

    # --- Search ---

    def detect(
        self,
        masters: GhostFacets,
        nodes: SeenNodes,
        position: Array,
        geodesic: Array | None,
        radius: float,
        cut_distance: float,
        penetration: float,
    ) -> None:
        """Start with the master facets that come near, at these positions (n, d) of the seen nodes.

        geodesic (n,): distances of the nodes along their part, with self-contact. radius: search radius, um.
        cut_distance: see `SegmentedPair`, um. penetration: that is accepted, um.
        """
        self.facets = DetectedFacets.of(self.slave, masters, self.rule, nodes, geodesic)
        self.slave_nodes = self.facets.slave_nodes
        self._cut(position, cut_distance)
        depth = self.depth, self.self_depth
        given = self.facets, self.points, self.covered, depth, position, radius
        self.closest = ClosestPoints(*given, blending=self.blending, shared=self._shared_facets())
        self.near_points = self.closest.near
        if self.exchange is not None:
            self.exchange.detect(self.facets, position, penetration)

    @property
    def search_range(self) -> float:
        """Gap, um, up to which master facets must be seen whatever moves."""
        return self.exchange.search_range if self.exchange is not None else 0.0

    def update_projections(self, position: Array, limits: SearchLimits) -> None:
        """Find the closest points with the seen nodes at `position` (n, d). LinAlgError: facets have collapsed."""
        projected, self.position, self.projection, self.shared = self.closest.update(position, limits)
        self.projected_points, self.master_facet = self.near_points[projected], self.closest.facet[projected]
        meets = self.met.copy()
        meets[self.projected_points] = self.laws.kind[self.facets.master.body[self.master_facet]]
        if not np.array_equal(meets, self._meets):
            self._take_law(meets)

    def _take_law(self, meets: Integers) -> None:
        """Take the law of points that meet bodies of these kinds (m,)."""
        self._meets, self.law = meets, self.laws.at(self.facet_size, self._own_kind(), meets)

    def _own_kind(self) -> Integers:
        """Kind (m,) of the body of each point."""
        return self.laws.kind[self.slave.body[self.points.facet]]

    def _cut(self, position: Array, distance: float) -> None:
        """Points stay where they are."""

    def _shared_facets(self) -> Booleans:
        """Slave facets (f,) whose points near an edge of the master several of its facets share."""
        return np.ones(len(self.slave), bool)

    # --- History ---

    def _start_history(self) -> None:
        """No point has met anything: the law is that with the softest body that it may meet."""
        count = len(self.points.weight)
        self._take_law(np.full(count, self.laws.softest(self.master_bodies)))
        self.history, self.met = self.law.virgin(count), self._meets

    def _set_points(self, points: SlavePoints) -> None:
        super()._set_points(points)
        self.covered = np.ones(len(points.weight), bool)

    def commit(self) -> None:
        """See `ContactPoints.commit`."""
        self.met = self._meets
        super().commit()

    def restore(self, snapshot: Snapshot) -> None:
        """See `ContactPoints.restore`."""
        super().restore(snapshot)
        self._take_law(self.met)

    def saved(self, *, augmented: bool) -> Points:
        """See `ContactPoints.saved`; with a history and bodies of several kinds also which of them points met last."""
        points = super().saved(augmented=augmented)
        if self._has_met:
            known = self.history.any(axis=1)
            points["met"] = self.keys()[known], self.met[known][:, None].astype(float)
        return points

    def resume(self, read: ReadPoints, *, augmented: bool) -> None:
        """See `ContactPoints.resume`."""
        super().resume(read, augmented=augmented)
        if self._has_met:
            met, found = read("met", self.keys(), 1)
            self.met = np.where(found, met[:, 0], self.met).astype(int)
        self._take_law(self.met)
        self._keep()

    @property
    def _has_met(self) -> bool:
        """Whether the history depends on what points have met."""
        return self.law.history_size > 0 and self.laws.several

    # --- Evaluation ---

    def evaluate(self, at: NodalState, *, tangent: bool) -> ContactTerms:
        """Terms of the projected points at the state that they were projected at."""
        rows = self.projected_points
        charged = at.potentials is not None and self.law.has_charges
        self._respond_at(at, self._jumps(at) if charged else None)
        forces, active = self._point_forces(at), self.response.acts
        self.force = np.zeros((len(rows), at.position.shape[1]))
        alone = active.copy()
        alone[self.shared.row] = False
        terms = [self._terms_of_one_facet(at, np.flatnonzero(alone), forces, tangent=tangent)]
        shared = self.shared[np.flatnonzero(active[self.shared.row])]
        if len(shared.row):
            given = self.facets, at, self.points.facet[rows], self.points.shape[rows], forces
            found, pushes = shared.terms(*given, tangent=tangent)
            np.add.at(self.force, shared.row[shared.point], pushes)
            terms += found
        if self.exchange is not None:
            terms.append(self.exchange.evaluate(at, tangent=tangent))
        return ContactTerms.joined(terms)

    def _jumps(self, at: NodalState) -> Array:
        """Potential jumps (r,), V; zero between bodies that exchange no charge."""
        kind, facet = self.slave.kind, self.points.facet[self.projected_points]
        here, there = self.facets.potentials_at(at.potentials, facet, self.master_facet)
        there = np.einsum("mk,mk->m", kind.shape(self.projection.xi), there)
        s = self.shared
        if len(s.row):
            there[s.row] = s.mean_potentials(self.facets, at.potentials, facet)
        jump = at.scale * (np.einsum("mk,mk->m", self.points.shape[self.projected_points], here) - there)
        return jump * self.laws.passes(self._own_kind(), self._meets)[self.projected_points]

    def _terms_of_one_facet(
        self, at: NodalState, some: Integers, forces: PointForces, *, tangent: bool
    ) -> ContactTerms:
        """Terms of `some` of the projected points, each on one master facet; forces: of all of them."""
        facet, master = self.points.facet[self.projected_points[some]], self.master_facet[some]
        vectors, matrices = contact_vectors(self._pairs(at, some), forces[some], tangent=tangent)
        self.force[some] = force_on_master(vectors, self.force.shape[1])
        pair = facet * max(len(self.facets.master), 1) + master
        return ContactTerms.summed(pair, self.facets.nodes_of(facet, master), vectors, matrices)

    def _pairs(self, at: NodalState, some: Integers) -> FacetPairs:
        """The pairs of facets of `some` of the projected points, each on one master facet."""
        rows, given = self.projected_points[some], (self.master_facet[some], self.projection[some])
        shape = self.points.shape[rows]
        return self.facets.pairs(at, self.points.facet[rows], *given, shape, charged=self.jump is not None)

    def first_changes(self, at: NodalState, change: Array) -> Array:
        """First-order changes (r, k) of the kinematics with those (n, block_size) of the unknowns."""
        rows, shared = self.projected_points, self.shared
        facet, changes = self.points.facet[rows], np.zeros_like(self.q)
        alone = np.ones(len(rows), bool)
        alone[shared.row] = False
        some = np.flatnonzero(alone)
        nodes = self.facets.nodes_of(facet[some], self.master_facet[some])
        changes[some] = first_changes(self._pairs(at, some), change[nodes])
        if len(shared.row):
            pairs = shared.pairs(self.facets, at, facet, self.points.shape[rows], charged=self.jump is not None)
            nodes = self.facets.nodes_of(facet[shared.row][shared.point], shared.facet)
            changes[shared.row] = blended_changes(pairs, shared.share, shared.point, change[nodes])
        return changes * self._units(at)

    def facet_pairs_within(self, distance: float) -> Integers:
        """Nodes (k, 2 n) of the pairs of facets with a gap below `distance` (um) plus half a facet."""
        near, shared = self._near_contact(distance), self.shared
        also = near[shared.row][shared.point]
        rows = np.concatenate([np.flatnonzero(near), shared.row[shared.point[also]]])
        master = np.concatenate([self.master_facet[near], shared.facet[also]])
        pairs = np.unique(np.stack([self.points.facet[self.projected_points[rows]], master], axis=1), axis=0)
        nodes = self.facets.nodes_of(pairs[:, 0], pairs[:, 1])
        return nodes if self.exchange is None else np.concatenate([nodes, self.exchange.nodes()])

    def energies(self) -> Array:
        """See `ContactPoints.energies`."""
        exchanged = self.exchange.energies() if self.exchange is not None else 0.0
        return super().energies() + exchanged

    # --- Bodies and pairs ---

    def master_component(self) -> Integers:
        """Connected component (r,) that each projected point meets."""
        return self.facets.master.component[self.master_facet]

    def is_self_contact(self) -> Booleans:
        """Whether each projected point (r,) meets its own connected part."""
        return self.facets.same_part(self.points.facet[self.projected_points], self.master_facet)

    def touching_bodies(self, pairs: Pairs) -> set[int]:
        """Bodies in contact with other connected parts."""
        closed = (self.gap <= self.law.equilibrium_gap) & ~self.is_self_contact()
        found = set(np.unique(self.slave.body[self.points.facet[self.projected_points[closed]]]).tolist())
        if pairs.named is None:
            return found | set(self.rule.body(self.master_component()[closed]).tolist())
        return found | self.master_bodies if closed.any() else found

    def pair_numbers(self, pairs: Pairs) -> tuple[Integers, Booleans]:
        """Number of each projected point's pair, and whether the point is on the first of the two, (r,) each.

        Of a body and itself the first is the one with the smaller geodesic distance.
        """
        return self.pairs_of_facets(pairs, self.points.facet[self.projected_points], self.master_facet)

    def across_gaps(self, pairs: Pairs) -> tuple[Integers, Array, Array]:
        """Pairs (m,) of the points that exchange charges across gaps; forces (m, d) on the first, uN; fields, V/um."""
        if self.exchange is None:
            return np.zeros(0, np.int64), np.zeros_like(self.force[:0]), np.zeros(0)
        number, first = self.pairs_of_facets(pairs, *self.exchange.facet_pairs())
        return number, np.where(first, 1.0, -1.0)[:, None] * self.exchange.force, self.exchange.field()

    def pairs_of_facets(self, pairs: Pairs, facet: Integers, master_facet: Integers) -> tuple[Integers, Booleans]:
        """Number of the pair of slave and master facets (r,), and whether the slave is the first of the two."""
        if pairs.named is not None:
            return np.full(len(facet), self.pair), np.full(len(facet), self.first)
        component = self.facets.master.component[master_facet]
        slave, master = self.rule.body(self.slave.component[facet]), self.rule.body(component)
        first = slave < master
        if self.facets.self_contact is not None:
            same = np.flatnonzero(slave == master)
            first[same] = self.facets.self_contact.precedes(facet[same], master_facet[same])
        return pairs.of_bodies(slave, master), first

    def numbers_in_results(self, pairs: Pairs) -> Integers:
        """Number (r,) that the pair of each projected point has in the results."""
        return pairs.in_results(self.pair_numbers(pairs)[0])
