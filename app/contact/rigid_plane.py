"""Rigid planes without a mesh, which the bodies' surfaces meet: platens that press, walls, electrodes.

A point of a surface at x has the gap g = (x - p).n from the plane through p whose normal n points to the bodies and,
where the plane is an electrode, the potential jump j = phi - V. The interface law is that of contact between bodies;
n is constant, so the variations of g are those of x and p. V is prescribed, or an unknown of a reference node. So is p:
a plane by force moves along a direction e, by the first displacement component of a reference node.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from piezomat.contact.contact_points import ContactPoints
from piezomat.contact.nodal_state import NodalState
from piezomat.contact.pairs import Pairs
from piezomat.contact.seen_nodes import SeenNodes
from piezomat.contact.terms import ContactTerms
from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.forms.contact.gap import point_normals
from piezomat.forms.contact.laws.medium import Medium
from piezomat.forms.contact.smoothing import rounded, spread, to_corners
from piezomat.meshes.contact.facet_bounds import FACING
from piezomat.scene.sections import Plane


@dataclass(frozen=True)
class PlaneProjection:
    """Gaps (r,) of points from a plane, um, and its normal at each (r, d)."""

    gap: Array
    normal: Array


@dataclass(kw_only=True)
class RigidPlane(ContactPoints):
    """Points of the bodies' surfaces against one rigid plane.

    Given, besides what `ContactPoints` has:
    plane: the scene's section
    start (d,): a point of the plane at the beginning, um
    normal (d,): unit normal, which points to the bodies
    sharp (f, c): whether there is a sharp edge at each corner of the slave facets
    reference_node: global number of the node that has the potential of the plane's electrode; None without one
    travel_node: global number of the node that has the travel of a plane by force; None for a given motion
    direction (d,): of that travel, a unit vector

    Of the present load level:
    offset (d,): motion since the beginning, um; by force, of the last detection or evaluation
    potential: V, of an electrode; None of an insulator; with a reference node, of the last evaluation

    Valid after a detection:
    places (k,): of its reference nodes, numbered as in `SeenNodes`

    Valid after an evaluation; all near points are projected:
    surface_potential (r,): potential of the bodies' surfaces, V; None without potentials
    force (d,): of the plane on this rank's points, uN
    charge: charge of the plane, pC
    """

    plane: Plane
    start: Array
    normal: Array
    sharp: Booleans
    reference_node: int | None = None
    travel_node: int | None = None
    direction: Array | None = None
    offset: Array = field(init=False)
    places: Integers = field(init=False)
    potential: float | None = field(init=False, default=None)
    projection: PlaneProjection | None = field(init=False, default=None)
    surface_potential: Array | None = field(init=False, default=None)
    force: Array = field(init=False)
    charge: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.offset = np.zeros(len(self.start))
        self.move({})
        self.force = np.zeros(len(self.normal))

    @property
    def name(self) -> str:
        """Name of the plane."""
        return self.plane.name

    @property
    def side(self) -> int:
        """2: neither side of a pair of surfaces."""
        return 2

    def move(self, factors: dict[str, float]) -> None:
        """Move to a load level; without factors to the start."""
        plane = self.plane
        if self.travel_node is None:
            self.offset = plane.motion_share(factors) * np.asarray(plane.motion or np.zeros(len(self.start)), float)
        if self.reference_node is not None:
            return
        self.potential = plane.potential
        if plane.potential is not None and plane.potential_follows is not None:
            self.potential *= factors.get(plane.potential_follows, 0.0)

    @property
    def reference_nodes(self) -> list[int]:
        """Global numbers of the nodes that have its potential and its travel, as far as there are any."""
        return [node for node in (self.reference_node, self.travel_node) if node is not None]

    def least_gap(self, position: Array) -> float:
        """Least gap of this rank's facets, um, with the seen nodes at `position`; infinite without any."""
        nodes = rounded(self.slave.kind, position[self.slave_nodes], self.slave.rounding)
        return float(self._gap(nodes).min(initial=np.inf))

    def _travel_to(self, position: Array) -> None:
        if self.travel_node is not None:
            self.offset = position[self.places[-1], 0] * self.direction

    def detect(self, nodes: SeenNodes, position: Array, radius: float) -> None:
        """Find the points within `radius` (um) of the plane whose surface faces it, the seen nodes at `position`."""
        self.slave_nodes = nodes.places(self.slave.nodes)
        self.places = nodes.places(np.array(self.reference_nodes, np.int64))
        self._travel_to(position)
        corners = rounded(self.slave.kind, position[self.slave_nodes], self.slave.rounding)
        facet = self.points.facet
        points = np.einsum("mk,mkd->md", self.points.shape, corners[facet])
        near = np.flatnonzero(self._gap(points) <= radius)
        facet = facet[near]
        outward = point_normals(self.slave.kind, self.points.xi[near], corners[facet], self.slave.orientation[facet])
        self.near_points = self.projected_points = near[outward @ self.normal < FACING]

    def evaluate(self, at: NodalState, *, tangent: bool) -> ContactTerms:
        """Terms of the near points; a plane has no adhesion, and so no viscous bonds."""
        rows, d = self.projected_points, len(self.normal)
        shape, facet = self.points.shape[rows], self.points.facet[rows]
        nodes = self.slave_nodes[facet]
        kind, offsets = self.slave.kind, self.slave.rounding[facet]
        self._travel_to(at.position)
        self.position = np.einsum("mk,mkd->md", shape, rounded(kind, at.position[nodes], offsets))
        self.projection = PlaneProjection(self._gap(self.position), np.tile(self.normal, (len(rows), 1)))
        jump = self.surface_potential = None
        if self.reference_node is not None:
            self.potential = float(at.scale * at.potentials[self.places[0]])
        if at.potentials is not None:
            self.surface_potential = at.scale * np.einsum(
                "mk,mk->m", shape, spread(kind, at.potentials[nodes], offsets)
            )
            if self.potential is not None and self.law.has_charges:
                jump = self.surface_potential - self.potential
        self._respond_at(at, jump)
        r, weight = self.response, self.points.weight[rows]
        self.force = -(weight @ r.traction) * self.normal
        self.charge = float(weight @ r.charge)

        active = r.acts
        forces = self._point_forces(at)[active]
        shape, nodes = shape[active], nodes[active]
        m, n = shape.shape
        first = np.zeros((m, self.q.shape[1], n, at.block_size))  # variations of gap and jump
        first[:, 0, :, :d] = shape[:, :, None] * self.normal
        if jump is not None:
            first[:, 1, :, d] = shape
        first = to_corners(kind, first, offsets[active])
        if self.reference_nodes:
            nodes, n = self._with_references(nodes), first.shape[2]  # of curved facets the corners
            first = np.concatenate([first, np.zeros_like(first)], axis=2)
            if jump is not None and self.reference_node is not None:
                first[:, 1, n, d] = -1.0
            if self.travel_node is not None:
                first[:, 0, n + len(self.reference_nodes) - 1, 0] = -self.normal @ self.direction
        vectors = np.einsum("m,mr,mrnc->mnc", forces.weight, forces.residual, first)
        matrices = None
        if tangent:
            flat = first.reshape(m, first.shape[1], first.shape[2] * at.block_size)
            matrices = np.swapaxes(flat, 1, 2) @ (forces.weight[:, None, None] * forces.hessian @ flat)
        terms = ContactTerms.summed(facet[active], nodes, vectors, matrices)
        return terms if self.reference_nodes else _twice(terms)

    def first_changes(self, at: NodalState, change: Array) -> Array:
        """Changes (r, k) of the kinematics with those (n, block_size) of the unknowns."""
        rows, d = self.projected_points, len(self.normal)
        facet, kind = self.points.facet[rows], self.slave.kind
        shape, nodes, offsets = self.points.shape[rows], self.slave_nodes[facet], self.slave.rounding[facet]
        before, after = (rounded(kind, x[nodes], offsets) for x in (at.position, at.position + change[:, :d]))
        changes = np.zeros_like(self.q)
        changes[:, 0] = np.einsum("mk,mkd,d->m", shape, after - before, self.normal)
        if self.jump is not None:
            changes[:, 1] = at.scale * np.einsum("mk,mk->m", shape, spread(kind, change[nodes, d], offsets))
            if self.reference_node is not None:
                changes[:, 1] -= at.scale * change[self.places[0], d]
        if self.travel_node is not None:
            changes[:, 0] -= change[self.places[-1], 0] * (self.normal @ self.direction)
        return changes

    def facet_pairs_within(self, distance: float) -> Integers:
        """Nodes (k, 2 n) of the facets with a gap below `distance` (um) plus half a facet, each twice."""
        near = self._near_contact(distance)
        nodes = self.slave_nodes[np.unique(self.points.facet[self.projected_points[near]])]
        return self._with_references(nodes)

    def _with_references(self, nodes: Integers) -> Integers:
        """Nodes (k, 2 n): those (k, n) of facets twice, the first of the second half being the reference nodes."""
        twice, n = np.concatenate([nodes, nodes], axis=1), nodes.shape[1]
        twice[:, n : n + len(self.places)] = self.places
        return twice

    def add(self, force: Array, charge: float) -> None:
        """Take up the force (d,), uN, that the plane exerts on another plane, and its charge, pC, that faces that."""
        self.force = self.force + force
        self.charge += charge

    def field(self) -> Array:
        """Field (r,) in the open gaps of an electrode at the last evaluation, V/um; of an insulator (0,)."""
        media = [law for law in self.law.summands() if isinstance(law, Medium)]
        return media[0][self.projected_points].field(self.q) if media else np.zeros(0)

    def touching_bodies(self, pairs: Pairs) -> set[int]:
        """Bodies in contact with the plane."""
        closed = self.gap <= self.law.equilibrium_gap
        return set(np.unique(self.slave.body[self.points.facet[self.projected_points[closed]]]).tolist())

    def numbers_in_results(self, pairs: Pairs) -> Integers:
        """Number (r,) that the plane has in the results, for each point."""
        return np.full(len(self.projected_points), pairs.first_plane + self.pair - len(pairs.listed))

    def deepest_node(self, position: Array, corners: Booleans | None = None) -> tuple[float, float]:
        """Penetration of the deepest node of facets with near points, and size of its facet, um; 0 and 1 for none.

        position: of the seen nodes; corners (f, c): only these of the facets.
        """
        facet, first = np.unique(self.points.facet[self.near_points], return_index=True)
        nodes = rounded(self.slave.kind, position[self.slave_nodes[facet]], self.slave.rounding[facet])
        gap = self._gap(nodes)
        if corners is not None:
            gap = np.where(corners[facet], gap[:, : corners.shape[1]], np.inf)
        least = gap.min(axis=1)
        if not (least < 0.0).any():
            return 0.0, 1.0
        deepest = least.argmin()
        return float(-least[deepest]), float(self.facet_size[self.near_points[first[deepest]]])

    def _gap(self, points: Array) -> Array:
        return (points - self.start - self.offset) @ self.normal


def _twice(terms: ContactTerms) -> ContactTerms:
    """Terms of pairs of facets from those of facets alone.

    A plane has no nodes: the second half of a pair is the slave facet again, where nothing is added.
    """
    n, matrices = terms.nodes.shape[1], terms.matrices
    if matrices is not None:
        matrices = np.pad(matrices, ((0, 0), *((0, matrices.shape[1]),) * 2))
    nodes = np.concatenate([terms.nodes, terms.nodes], axis=1)
    return ContactTerms(nodes, np.pad(terms.vectors, ((0, 0), (0, n), (0, 0))), matrices)
