"""Rigid planes without a mesh, which the bodies' surfaces meet: platens that press, walls, electrodes.

A point of a surface at x has the gap g = (x - p).n from the plane through p whose normal n points to the bodies and,
where the plane is an electrode, the potential jump j = phi - V. The interface law is that of contact between bodies;
n is constant, so the variations of g and j are those of x and phi alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from piezomat.contact.active_set import linearized_response, response
from piezomat.contact.nodal_state import NodalState
from piezomat.forms.arrays import Array
from piezomat.forms.contact.augmentation import Multipliers
from piezomat.forms.contact.gap import point_normals
from piezomat.forms.contact.integrals import SlavePoints
from piezomat.forms.contact.laws.interface import InterfaceLaw
from piezomat.forms.contact.laws.response import History, Response
from piezomat.forms.contact.laws.viscous import ViscousBonds
from piezomat.forms.contact.smoothing import rounded, spread, to_corners
from piezomat.meshes.contact.load_balance import SlaveFacets
from piezomat.meshes.contact.local_search import FACING
from piezomat.scene.sections import Plane


@dataclass
class PlaneProjection:
    """Gaps (m,) of points from a plane, and its normal at each (m, d)."""

    gap: Array
    normal: Array

    def __getitem__(self, rows: NDArray) -> PlaneProjection:
        return PlaneProjection(self.gap[rows], self.normal[rows])


@dataclass
class RigidPlane:
    """The points of the bodies' surfaces against one plane; what it has in common with `SurfacePair` is called alike.

    start, normal (d,): the plane at the beginning. offset (d,) and potential: its motion (um) and, of an electrode,
    its potential (V) at the present load level. `rows` are the points near it that face it. Of the last evaluation:
    `force` (uN) and `charge` (pC) that this rank's points take from the plane, and `position` (m, d) of its points, and
    `gap` (m,), which the law sees.
    """

    pair: int
    plane: Plane
    start: Array
    normal: Array
    slave: SlaveFacets
    points: SlavePoints
    law: InterfaceLaw
    facet_size: Array
    share: float = 1.0
    offset: Array = field(init=False)
    potential: float | None = field(init=False)
    history: History = field(init=False)
    multipliers: Multipliers = field(init=False)
    viscous_bonds: ViscousBonds = field(init=False)
    near_points: NDArray[np.int64] = field(init=False)
    projected: NDArray[np.int64] = field(init=False)
    slave_nodes: NDArray[np.int64] = field(init=False)
    position: Array = field(init=False)
    projection: PlaneProjection | None = field(init=False, default=None)
    gap: Array = field(init=False)
    response: Response | None = field(init=False, default=None)
    jump: Array | None = field(init=False, default=None)
    surface_potential: Array | None = field(init=False, default=None)
    predicted: Array | None = field(init=False, default=None)
    force: Array = field(init=False)
    charge: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        self.history = History.virgin(len(self.points.weight))
        self.multipliers = Multipliers.none(self.slave.kind, len(self.slave))
        self.viscous_bonds = ViscousBonds.none(len(self.points.weight))
        self.mark_converged()
        self.move({})
        self.force = np.zeros(len(self.normal))

    @property
    def name(self) -> str:
        """Name of the plane."""
        return self.plane.name

    def move(self, factors: dict[str, float]) -> None:
        """Go to a load level; without factors to the start."""
        plane = self.plane
        self.offset = plane.motion_share(factors) * np.asarray(plane.motion or np.zeros(len(self.start)), float)
        self.potential = plane.potential
        if plane.potential is not None and plane.potential_follows is not None:
            self.potential *= factors.get(plane.potential_follows, 0.0)

    @property
    def projected_points(self) -> NDArray[np.int64]:
        """Numbers of the projected points among all points, (projected,)."""
        return self.near_points[self.projected]

    def mark_converged(self) -> None:
        """Take history and multipliers for those of the last converged step."""
        self._converged = self.snapshot()

    def snapshot(self) -> tuple[History, Multipliers]:
        """What is remembered of a converged step: history and multipliers of the points."""
        return self.history.copy(), self.multipliers.copy()

    def restore(self, memory: tuple[History, Multipliers]) -> None:
        """Go back to what was remembered."""
        self.history, self.multipliers, self._converged = memory[0].copy(), memory[1].copy(), memory

    def restore_multipliers(self) -> None:
        """Go back to the multipliers of the last converged step."""
        self.multipliers = self._converged[1].copy()

    def keys(self) -> NDArray[np.int64]:
        """(m, 4) numbers of the points that do not depend on the partition: pair, pass, facet, place."""
        return self._keys(self.points.facet, self.points.place)

    def corner_keys(self) -> NDArray[np.int64]:
        """(facets * corners, 4) numbers of the corners of the facets."""
        return self._keys(*(index.ravel() for index in np.indices(self.multipliers.gap.shape)))

    def _keys(self, facet: NDArray[np.int64], place: NDArray[np.int64]) -> NDArray[np.int64]:
        same = np.ones(len(facet), np.int64)
        return np.stack([self.pair * same, 2 * same, self.slave.key[facet], place], axis=1)

    def detect(self, position: Array, margin: float) -> None:
        """Find the points within `margin` (um) of the plane whose surface faces it, nodes being at `position`."""
        nodes = rounded(self.slave.kind, position[self.slave_nodes], self.slave.rounding)
        facet = self.points.facet
        points = np.einsum("mk,mkd->md", self.points.shape, nodes[facet])
        near = np.flatnonzero(self._gap(points) <= margin)
        facet = facet[near]
        outward = point_normals(self.slave.kind, self.points.xi[near], nodes[facet], self.slave.orientation[facet])
        self.near_points = near[outward @ self.normal < FACING]
        self.projected = np.arange(len(self.near_points))

    def evaluate(
        self, at: NodalState, *, tangent: bool
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], Array, Array | None]:
        """Facet (k,), nodes (k, n), vectors (k, n, c) and matrices (k, n * c, n * c) of the points that answer.

        Of facets curved by `rounding` the nodes are the corners.
        """
        rows, d = self.near_points, len(self.normal)
        shape, facet = self.points.shape[rows], self.points.facet[rows]
        nodes = self.slave_nodes[facet]
        kind, offsets = self.slave.kind, self.slave.rounding[facet]
        self.position = np.einsum("mk,mkd->md", shape, rounded(kind, at.position[nodes], offsets))
        gap = self._gap(self.position)
        self.projection = PlaneProjection(gap, np.tile(self.normal, (len(rows), 1)))
        self.jump = self.surface_potential = None
        if at.potentials is not None:
            self.surface_potential = at.scale * np.einsum(
                "mk,mk->m", shape, spread(kind, at.potentials[nodes], offsets)
            )
            if self.potential is not None and self.law.electric_penalty is not None:
                self.jump = self.surface_potential - self.potential
        shift = self.multipliers.at(kind, facet, self.points.xi[rows])
        self.gap = gap + shift[0]
        r = self.response = response(self, at, shift)
        weight = self.points.weight[rows]
        self.force = -(weight @ r.slope) * self.normal
        self.charge = float(weight @ r.charge)

        active = (r.slope != 0.0) | (r.curvature != 0.0) | (r.electric_curvature != 0.0)
        shape, nodes, weight = shape[active], nodes[active], weight[active]
        m, n = shape.shape
        first = np.zeros((m, 2, n, at.block_size))  # variations of gap and jump
        first[:, 0, :, :d] = shape[:, :, None] * self.normal
        if self.jump is not None:
            first[:, 1, :, d] = at.scale * shape
        first = to_corners(kind, first, offsets[active])
        slopes = np.stack(linearized_response(self), axis=1)[active]
        vectors = np.einsum("m,mr,mrnc->mnc", weight, slopes, first)
        if not tangent:
            return facet[active], nodes, vectors, None
        second = np.stack([r.curvature, r.mixed, r.mixed, r.electric_curvature], axis=1)[active].reshape(m, 2, 2)
        flat = first.reshape(m, 2, nodes.shape[1] * at.block_size)
        matrices = np.swapaxes(flat, 1, 2) @ (weight[:, None, None] * second @ flat)
        return facet[active], nodes, vectors, matrices

    def first_changes(self, at: NodalState, change: Array) -> Array:
        """Changes (2, m), um and V, of gaps and jumps with those (n, block_size) of the nodes' unknowns."""
        facet, kind, d = self.points.facet[self.near_points], self.slave.kind, len(self.normal)
        shape, nodes, offsets = self.points.shape[self.near_points], self.slave_nodes[facet], self.slave.rounding[facet]
        before, after = (rounded(kind, x[nodes], offsets) for x in (at.position, at.position + change[:, :d]))
        changes = np.zeros((2, len(self.near_points)))
        changes[0] = np.einsum("mk,mkd,d->m", shape, after - before, self.normal)
        if self.jump is not None:
            changes[1] = at.scale * np.einsum("mk,mk->m", shape, spread(kind, change[nodes, d], offsets))
        return changes

    def _gap(self, points: Array) -> Array:
        return (points - self.start - self.offset) @ self.normal
