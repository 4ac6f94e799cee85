"""Charges across open gaps: facets that face each other through the medium, beyond where contact looks closely.

There are many such points and they matter little each, so they must cost little. Partners, closest points and normals
are found at a detection and kept until the next one: gap and jump are then linear in the unknowns of the nodes. A facet
has one point, in its middle; facets nearer to the other side than their size have all points of the quadrature.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezomat.contact.detected_facets import DetectedFacets
from piezomat.contact.nodal_state import NodalState
from piezomat.contact.pair_laws import PairLaws
from piezomat.contact.terms import ContactTerms
from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.facets import Facets
from piezomat.forms.contact.gap import point_normals
from piezomat.forms.contact.integrals import SlavePoints, facet_areas, quadrature_points
from piezomat.forms.contact.laws.law import ContactLaw
from piezomat.forms.contact.laws.response import ENERGIES, Response
from piezomat.forms.contact.smoothing import to_corners
from piezomat.meshes.contact.facet_bounds import near_points
from piezomat.meshes.contact.global_search import CandidatePairs
from piezomat.meshes.contact.load_balance import SlaveFacets
from piezomat.meshes.contact.open_gaps import closest_across

CLOSE = 1.0  # facet sizes: gap below which a facet has all points of the quadrature
# Gap up to which partners are found, over that of the law: it gives the pattern of the tangent and the nodes that a
# bulk is condensed to room for those that come within reach in later steps.
AHEAD = 1.2


@dataclass(frozen=True)
class _Partners:
    """What a detection has found of m points: gap = gap_rows . x + gap_shift, jump = jump_rows . potential.

    facet, master (m,): slave and master facet; gap (m,): at the detection, um
    weight (m,): um2 (2D: um), with the share of the pass
    nodes (m, n): of both facets, slave first, numbered as in `SeenNodes`
    gap_rows (m, n, d), gap_shift (m,): um; jump_rows (m, n)
    """

    facet: Integers
    master: Integers
    gap: Array
    weight: Array
    nodes: Integers
    gap_rows: Array
    gap_shift: Array
    jump_rows: Array

    def __getitem__(self, rows: NDArray) -> _Partners:
        return _Partners(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def followed_by(self, more: _Partners) -> _Partners:
        """These points, then more."""
        both = ((getattr(self, name), getattr(more, name)) for name in self.__dataclass_fields__)
        return _Partners(*(np.concatenate(parts) for parts in both))


@dataclass
class GapExchange:
    """Exchange of charges of slave facets with the master facets that they face. No method is collective.

    Given:
    slave: slave facets (f,) whose points this rank evaluates
    laws: of which the medium, less what the points of contact have of it, is the law of the points
    facet_size (f,): um
    share: share of the enthalpy, 1/2 for each of two passes
    rest_gap: gap of surfaces at rest, um

    Valid after an evaluation:
    q (m, 2): gap, um, and potential jump, V; response (m,): of the law, with the mode of the evaluation
    force (m, d): force that each point exerts on the master, uN
    """

    slave: SlaveFacets
    laws: PairLaws
    facet_size: Array
    share: float
    rest_gap: float

    def __post_init__(self) -> None:
        kind = self.slave.kind
        area = facet_areas(kind, self.slave.reference)
        facets, middle = np.arange(len(self.slave)), np.tile(kind.middle, (len(self.slave), 1))
        self._middles = SlavePoints(facets, 0 * facets, middle, kind.shape(middle), area, area)
        self._every = quadrature_points(kind, self.slave.reference)
        self.response: Response | None = None

    @property
    def search_range(self) -> float:
        """Gap up to which partners are found, um."""
        return AHEAD * (self.rest_gap + self.laws.medium.reach)

    # --- Detection ---

    def detect(self, facets: DetectedFacets, position: Array, depth: float) -> None:
        """Find the partners of all facets with the seen nodes at `position` (n, d); depth: accepted penetration, um."""
        middles = self._partners(facets, position, depth, self._middles)
        near = np.zeros(len(self.slave), bool)
        near[middles.facet[np.abs(middles.gap) < CLOSE * self.facet_size[middles.facet]]] = True
        rows = np.flatnonzero(near[self._every.facet])
        points = SlavePoints(*(getattr(self._every, name)[rows] for name in SlavePoints.__dataclass_fields__))
        self._found = middles[~near[middles.facet]].followed_by(self._partners(facets, position, depth, points))
        self._law = self._law_of_points(facets)
        self._masters = max(len(facets.master), 1)
        self.response = None

    def _law_of_points(self, facets: DetectedFacets) -> ContactLaw:
        kind, facet = self.laws.kind, self._found.facet
        master = kind[facets.master.body[self._found.master]]
        return self.laws.rest(self.facet_size[facet], kind[self.slave.body[facet]], master, self.rest_gap)

    def _partners(self, facets: DetectedFacets, position: Array, depth: float, points: SlavePoints) -> _Partners:
        """The points that face a master facet, each with the nearest one."""
        kind, reach = self.slave.kind, self.search_range
        corners = facets.slave_at(position, points.facet)
        here = np.einsum("mk,mkd->md", points.shape, corners)
        normals = point_normals(kind, points.xi, corners, self.slave.orientation[points.facet])
        masters, component = facets.master_at(position), facets.slave.component[points.facet]
        given = here, component, masters, facets.master.component, reach, facets.rule
        near = CandidatePairs.near(*given)
        master, gap = np.full(len(here), -1), np.full(len(here), np.inf)
        xi, way = np.zeros((len(here), kind.dim)), np.zeros_like(here)
        for rows, targets, same_part in zip(near.points, near.facets, near.same_part, strict=True):
            own = facets.self_candidates(position, np.unique(points.facet[rows]), targets, reach) if same_part else None
            rows = rows[near_points(here[rows], masters[targets], reach)]
            surface = Facets(kind, masters[targets], facets.master.orientation[targets], facets.master.key[targets])
            pairs = own.of_points(points.facet[rows]) if own is not None else None
            found, *closest = closest_across(here[rows], normals[rows], surface, reach, depth, pairs)
            nearer = (found >= 0) & (np.abs(closest[1]) < np.abs(gap[rows]))
            rows = rows[nearer]
            master[rows] = targets[found[nearer]]
            xi[rows], gap[rows], way[rows] = (values[nearer] for values in closest)
        some = np.flatnonzero(master >= 0)
        return self._kinematics(facets, position, points, some, master[some], xi[some], gap[some], way[some])

    def _kinematics(
        self,
        facets: DetectedFacets,
        position: Array,
        points: SlavePoints,
        some: Integers,
        master: Integers,
        xi: Array,
        gap: Array,
        way: Array,
    ) -> _Partners:
        """Gap and jump of some points, as linear functions of the nodes' positions and potentials."""
        facet, d = points.facet[some], way.shape[1]
        sides = points.shape[some], -self.slave.kind.shape(xi)
        rows = []
        for shape, offsets in zip(sides, facets.roundings_of(facet, master), strict=True):
            each = np.zeros((len(shape), 2, shape.shape[1], d + 1))
            each[:, 0, :, :d] = shape[:, :, None] * way[:, None, :]
            each[:, 1, :, d] = shape
            rows.append(to_corners(self.slave.kind, each, offsets))
        both = np.concatenate(rows, axis=2)
        gap_rows, jump_rows = both[:, 0, :, :d], both[:, 1, :, d]
        nodes = facets.nodes_of(facet, master)
        shift = gap - np.einsum("mnd,mnd->m", gap_rows, position[nodes])
        return _Partners(facet, master, gap, self.share * points.weight[some], nodes, gap_rows, shift, jump_rows)

    def facet_pairs(self) -> tuple[Integers, Integers]:
        """Slave and master facet (m,) of each point."""
        return self._found.facet, self._found.master

    def nodes(self) -> Integers:
        """Nodes (k, n) of the pairs of facets that exchange charges or may soon do so."""
        return np.unique(self._found.nodes, axis=0)

    # --- Evaluation ---

    def evaluate(self, at: NodalState, *, tangent: bool) -> ContactTerms:
        """Terms of the points at a state."""
        p, d = self._found, at.position.shape[1]
        gap = np.einsum("mnd,mnd->m", p.gap_rows, at.position[p.nodes]) + p.gap_shift
        jump = at.scale * np.einsum("mn,mn->m", p.jump_rows, at.potentials[p.nodes])
        self.q = np.stack([gap, jump], axis=1)
        r = self.response = self._law.respond(self.q, self._law.virgin(len(gap)), at.mode)
        self.force = (p.weight * r.traction)[:, None] * -p.gap_rows[:, : p.gap_rows.shape[1] // 2].sum(axis=1)
        live = np.flatnonzero(r.acts)
        order, first = self._pairs_of(live)
        p, n, b = p[live[order]], p.nodes.shape[1], at.block_size
        gradient = p.weight[:, None] * r.gradient[live[order]]
        hessian = p.weight[:, None, None] * r.hessian[live[order]]
        jump = at.scale * p.jump_rows
        vectors = np.zeros((len(first), n, b))
        vectors[:, :, d] = _sums(gradient[:, 1, None] * jump, first)
        matrices = np.zeros((len(first), n, b, n, b)) if tangent else None
        if tangent:
            matrices[:, :, d, :, d] = _sums(hessian[:, 1, 1, None, None] * _outer(jump, jump), first)
        if gradient[:, 0].any() or hessian[:, 0].any():
            vectors[:, :, :d] = _sums(gradient[:, 0, None, None] * p.gap_rows, first)
            if tangent:
                flat = p.gap_rows.reshape(len(live), n * d)
                second = _sums(hessian[:, 0, 0, None, None] * _outer(flat, flat), first)
                matrices[:, :, :d, :, :d] = second.reshape(-1, n, d, n, d)
                cross = _sums(hessian[:, 0, 1, None, None] * _outer(flat, jump), first).reshape(-1, n, d, n)
                matrices[:, :, :d, :, d] = cross
                matrices[:, :, d, :, :d] = np.moveaxis(cross, 3, 1)
        if tangent:
            matrices = matrices.reshape(-1, n * b, n * b)
        return ContactTerms(p.nodes[first], vectors, matrices)

    def field(self) -> Array:
        """Field (m,) of the last evaluation, V/um, zero where a gap is closed, see `Medium.field`."""
        return self._law.field(self.q)

    def _pairs_of(self, live: Integers) -> tuple[Integers, Integers]:
        """Order (l,) of some points by their pairs of facets, and where in it each pair begins."""
        pair = self._found.facet[live] * self._masters + self._found.master[live]
        order = np.argsort(pair, kind="stable")
        return order, np.unique(pair[order], return_index=True)[1]

    def energies(self) -> Array:
        """The `ENERGIES` (4,) of the last evaluation, pJ (2D: per um of depth)."""
        return np.array([self._found.weight @ self.response.energy(name) for name in ENERGIES])


def _sums(values: Array, first: Integers) -> Array:
    """Sums of values (l, ...) from each of the places `first` to the next."""
    return np.add.reduceat(values, first) if len(first) else values


def _outer(left: Array, right: Array) -> Array:
    """Outer products (m, i, j) of (m, i) and (m, j)."""
    return left[:, :, None] * right[:, None, :]
