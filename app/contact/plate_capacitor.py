"""Two planes that face each other: a plate capacitor, where no body lies between them.

With the area A that bodies leave free in the undeformed state, the distance g and the voltage V its enthalpy is
-1/2 eps A / g V^2. Potentials and distance are given, or unknowns of reference nodes: see `RigidPlane`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.contact.nodal_state import NodalState
from piezomat.contact.rigid_plane import RigidPlane
from piezomat.contact.terms import ContactTerms
from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.laws.response import ENERGIES

PARALLEL = 1e-6  # how far the cosine of two normals may be from -1


@dataclass
class PlateCapacitor:
    """Electrodes on two planes. No method is collective; one rank evaluates it.

    first, second: the planes, after their own evaluation
    area: um2 (2D: um); permittivity: pC/(V um)
    here: whether this rank evaluates it
    """

    first: RigidPlane
    second: RigidPlane
    area: float
    permittivity: float
    here: bool

    @staticmethod
    def is_between(first: RigidPlane, second: RigidPlane) -> bool:
        """Whether two planes are electrodes that face each other."""
        electric = first.law.has_charges and second.law.has_charges
        return electric and first.normal @ second.normal < PARALLEL - 1.0 and _distance(first, second) > 0.0

    @property
    def planes(self) -> tuple[RigidPlane, RigidPlane]:
        """Both planes."""
        return self.first, self.second

    @property
    def field(self) -> float:
        """Field between them at the last evaluation, V/um."""
        return abs(self._voltage) / _distance(*self.planes)

    @property
    def _voltage(self) -> float:
        return self.second.potential - self.first.potential

    def energies(self) -> Array:
        """The `ENERGIES` (4,) of the last evaluation, pJ (2D: per um of depth); zero on other ranks."""
        electric = 0.5 * self.capacitance * self._voltage**2 * self.here
        return np.array([electric * (name == "electric") for name in ENERGIES])

    @property
    def capacitance(self) -> float:
        """Of the free area at the present distance, pC/V (2D: per um of depth)."""
        return self.permittivity * self.area / _distance(*self.planes)

    def nodes(self, count: int) -> Integers:
        """Its reference nodes, numbered as in `SeenNodes`, as the row (1, count) of a pair of facets; or none."""
        places = np.concatenate([p.places for p in self.planes])
        if not (len(places) and self.here):
            return np.zeros((0, count), np.int64)
        return np.concatenate([places, np.repeat(places[:1], count - len(places))])[None]

    def evaluate(self, at: NodalState, count: int, *, tangent: bool) -> ContactTerms:
        """Terms of a pair with `count` nodes; the planes take up its force and charge."""
        if not self.here:
            return ContactTerms.none(count, at.block_size, tangent=tangent)
        g, c, voltage = _distance(*self.planes), self.capacitance, self._voltage
        pull = 0.5 * c / g * voltage**2
        for plane, charge in zip(self.planes, (-c * voltage, c * voltage), strict=True):
            plane.add(-pull * plane.normal, charge)
        nodes = self.nodes(count)
        first = np.zeros((2, count, at.block_size))  # variations of distance and voltage
        second = np.array([[-2.0 * pull / g, c / g * voltage], [c / g * voltage, -c]])
        offset = 0
        for plane, sign in zip(self.planes, (-1.0, 1.0), strict=True):
            if plane.reference_node is not None:
                first[1, offset, -1] = sign * at.scale
            if plane.travel_node is not None:
                first[0, offset + len(plane.places) - 1, 0] = sign * (plane.direction @ self.first.normal)
            offset += len(plane.places)
        vectors = np.tensordot(np.array([pull, -c * voltage]), first, axes=1)
        flat: Array = first.reshape(2, -1)
        return ContactTerms(
            nodes, vectors[None][: len(nodes)], (flat.T @ second @ flat)[None][: len(nodes)] if tangent else None
        )


def _distance(first: RigidPlane, second: RigidPlane) -> float:
    return float((second.start + second.offset - first.start - first.offset) @ first.normal)
