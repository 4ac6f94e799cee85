"""Contact of a slave surface with master surfaces: one pass of a pair of surfaces, or of many bodies."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from piezomat.contact.closest_points import FINAL_PROJECTION_TOLERANCE, ClosestPoints, SearchLimits
from piezomat.contact.contact_points import ContactPoints
from piezomat.contact.detected_facets import DetectedFacets
from piezomat.contact.gap_exchange import GapExchange
from piezomat.contact.nodal_state import NodalState
from piezomat.contact.pairs import Pairs
from piezomat.contact.seen_nodes import SeenNodes
from piezomat.contact.shared_points import SharedPoints, force_on_master
from piezomat.contact.terms import ContactTerms
from piezomat.discretization.state import Points, ReadPoints
from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.forms.contact.blending import blended_changes
from piezomat.forms.contact.facets import Facets
from piezomat.forms.contact.gap import project
from piezomat.forms.contact.integrals import (
    FacetPairs,
    PointForces,
    SlavePoints,
    contact_vectors,
    first_changes,
    nodes_of,
)
from piezomat.forms.contact.segments import nearest_points, segment_points
from piezomat.meshes.contact.facet_bounds import facing_pairs
from piezomat.meshes.contact.global_search import GhostFacets, PairingRule

# Segments are cut anew once a point has slid by this share of a facet since: a kink that is missed by so much costs
# the square of it.
CUT_DRIFT = 1e-3
CLOSE = 0.25  # facets: a node may be inside the other body if a point of its facet has a gap below this


@dataclass(frozen=True)
class PenetratingNodes:
    """Nodes inside another body: pair (k,), depth (k,), and size of their facets (k,), um."""

    pair: Integers
    depth: Array
    facet_size: Array


@dataclass(kw_only=True)
class SurfacePair(ContactPoints):
    """Points of slave facets against the master facets that they may meet.

    One pass of a pair of surfaces that the scene names, or of all bodies of one kind against all of another. With
    `segments` the points are those of the segments of the slave facets, cut at every detection. Law and size are
    then a facet's, and a new point takes the history of the nearest one that its facet had at the last converged step.

    Given, besides what `ContactPoints` has:
    master: master facets whose cells this rank holds
    master_bodies: bodies that the master facets of all ranks belong to
    rule: which connected components may meet
    first: whether the slave is the first surface of its pair
    depth: penetration (um) beyond which a point has come from the far side of a body and meets nothing
    self_depth: the same in its own part, which is thinner than it seems if it is bent
    segments: whether slave facets are cut into segments
    blended: whether master facets share points near their edges, see `SharedPoints`
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
    rule: PairingRule
    first: bool
    depth: float
    self_depth: float
    segments: bool = False
    blended: bool = False
    exchange: GapExchange | None = None
    covered: Booleans = field(init=False)
    facets: DetectedFacets = field(init=False)
    closest: ClosestPoints = field(init=False)
    master_facet: Integers = field(init=False)
    shared: SharedPoints = field(init=False)
    force: Array = field(init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        first = np.searchsorted(self.points.facet, np.arange(len(self.slave)))
        self._of_facets = (self.law[first], self.facet_size[first]) if self.segments else None
        self.covered = np.ones(len(self.points.weight), bool)

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

        geodesic (n,): distances of the nodes along their part, with self-contact. radius: search radius, um. Segments
        are cut along the master facets that come nearer than cut_distance, um. penetration: that is accepted, um.
        """
        self.facets = DetectedFacets.of(self.slave, masters, self.rule, nodes, geodesic)
        self.slave_nodes = self.facets.slave_nodes
        if self.segments:
            self._cut_segments(position, cut_distance)
        depth = self.depth, self.self_depth
        given = self.facets, self.points, self.covered, depth, position, radius
        self.closest = ClosestPoints(*given, blended=self.blended)
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

    def penetrating_nodes(self, pairs: Pairs, position: Array, depth: float) -> PenetratingNodes:
        """Nodes of the facets with points in contact or nearly so that lie inside the other body.

        position (n, d): of the seen nodes, at which the points are projected; depth: see `SearchLimits`.
        """
        points, size = self.points, np.zeros(len(self.slave))
        rows = self.projected_points
        size[points.facet] = self.facet_size
        facets = np.unique(points.facet[rows[self.projection.gap < CLOSE * self.facet_size[rows]]])
        nodes = nodes_of(self.slave.kind, facets)
        depths = self.depth, self.self_depth
        closest = ClosestPoints(self.facets, nodes, np.ones(len(nodes.facet), bool), depths, position, max(depths))
        limits = SearchLimits(FINAL_PROJECTION_TOLERANCE, True, 0.0, 0.0, 0.0, depth, 0.0)
        found, _, projection, _ = closest.update(position, limits)
        facet = nodes.facet[closest.near[found]]
        pair, _ = self._pairs_of_facets(pairs, facet, closest.facet[found])
        return PenetratingNodes(pair, -projection.gap, size[facet])

    # --- Segments ---

    def _cut_segments(self, position: Array, distance: float) -> None:
        """Cut the slave facets along the edges of the master facets that come nearer than `distance`."""
        facets, kind = self.facets, self.slave.kind
        slave = Facets(kind, facets.slave_at(position), self.slave.orientation, self.slave.key)
        master = Facets(kind, facets.master_at(position), facets.master.orientation, facets.master.key)
        pairs = facing_pairs(slave, master, distance)
        allowed = facets.may_meet(*pairs)
        pairs = pairs[0][allowed], pairs[1][allowed]
        points, covered = segment_points(self.slave.reference, slave, master, pairs)
        bonds = self.viscous_bonds[nearest_points(points.facet, points.xi, self.points)]
        converged = self._converged
        self._set_points(points)
        self.covered, self.viscous_bonds = covered, bonds
        self._uncut = ~np.isin(points.facet, pairs[0])
        self.history = converged.history[nearest_points(points.facet, points.xi, converged.points)]

    def _set_points(self, points: SlavePoints) -> None:
        super()._set_points(points)
        self.covered = np.ones(len(points.weight), bool)
        if self.segments:
            law, size = self._of_facets
            self.law, self.facet_size = law[points.facet], size[points.facet]

    def has_stale_segments(self, before: Array, interaction_range: float) -> bool:
        """Whether points in contact have slid since the cut, with the nodes at `before`, or are on uncut facets."""
        if not self.segments:
            return False
        acts = (self.projection.gap < interaction_range) | (self.response.traction != 0.0)
        rows, master, xi = self.projected_points[acts], self.master_facet[acts], self.projection.xi[acts]
        facets, facet = self.facets, self.points.facet[rows]
        points = np.einsum("mk,mkd->md", self.points.shape[rows], facets.slave_at(before, facet))
        nodes, orientation = facets.master_at(before, master), facets.master.orientation[master]
        slide = np.abs(project(facets.kind, points, nodes, orientation, xi).xi - xi).max(initial=0.0)
        return bool(slide > CUT_DRIFT or self._uncut[rows].any())

    # --- Checkpoints ---

    def saved(self, *, augmented: bool) -> Points:
        """See `ContactPoints.saved`; of segments also where points lie, which follows from states before this one."""
        places = {"place": (self.keys(), self.points.xi)} if self.segments else {}
        return super().saved(augmented=augmented) | places

    def resume_points(self, read: ReadPoints, points_per_facet: int) -> None:
        """Take up the points of segments that a checkpoint holds, their weights left to the next cut. Collective.

        points_per_facet: largest number of points of a facet.
        """
        if not self.segments:
            return
        facet, place = np.divmod(np.arange(len(self.slave) * points_per_facet), points_per_facet)
        xi, found = read("place", self._keys(facet, place), self.points.xi.shape[1])
        facet, place, xi, none = facet[found], place[found], xi[found], np.zeros(found.sum())
        self._set_points(SlavePoints(facet, place, xi, self.slave.kind.shape(xi), none, none))
        self.history = self.law.virgin(len(facet))

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
        """Potential jumps (r,), V."""
        kind, facet = self.slave.kind, self.points.facet[self.projected_points]
        here, there = self.facets.potentials_at(at.potentials, facet, self.master_facet)
        there = np.einsum("mk,mk->m", kind.shape(self.projection.xi), there)
        s = self.shared
        if len(s.row):
            there[s.row] = s.mean_potentials(self.facets, at.potentials, facet)
        return at.scale * (np.einsum("mk,mk->m", self.points.shape[self.projected_points], here) - there)

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
        return self._pairs_of_facets(pairs, self.points.facet[self.projected_points], self.master_facet)

    def across_gaps(self, pairs: Pairs) -> tuple[Integers, Array, Array]:
        """Pairs (m,) of the points that exchange charges across gaps; forces (m, d) on the first, uN; fields, V/um."""
        if self.exchange is None:
            return np.zeros(0, np.int64), np.zeros_like(self.force[:0]), np.zeros(0)
        number, first = self._pairs_of_facets(pairs, *self.exchange.facet_pairs())
        return number, np.where(first, 1.0, -1.0)[:, None] * self.exchange.force, self.exchange.field()

    def _pairs_of_facets(self, pairs: Pairs, facet: Integers, master_facet: Integers) -> tuple[Integers, Booleans]:
        """The same of slave and master facets (r,)."""
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
