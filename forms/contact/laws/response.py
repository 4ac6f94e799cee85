"""What a law of contact gives for points: energies per area, and the gradient and Hessian of the enthalpy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from piezomat.forms.arrays import Array

# Energies that laws store or dissipate, and their signs in the enthalpy: that of an electric field is negative.
ENERGIES = {"contact": 1.0, "adhesion": 1.0, "electric": -1.0, "dissipated": 1.0}


@dataclass(frozen=True)
class Response:
    """Response of m points at kinematics q = (gap, potential jump), of which k are there.

    energies: by their names in `ENERGIES`, each (m,), pJ/um2; those that are zero may be left out
    gradient (m, k): of the enthalpy by q: traction, MPa, negative in compression; charge, pC/um2
    hessian (m, k, k): of the enthalpy by q, MPa/um, pC/um3, pC/(V um2)
    """

    energies: Mapping[str, Array]
    gradient: Array
    hessian: Array

    @classmethod
    def of_gap(cls, q: Array, energies: Mapping[str, Array], traction: Array, stiffness: Array) -> Response:
        """Response at q (m, k) of a law of the gap alone: traction (m,), and its derivative (m,) by the gap."""
        gradient, hessian = np.zeros_like(q), np.zeros((*q.shape, q.shape[1]))
        gradient[:, 0], hessian[:, 0, 0] = traction, stiffness
        return cls(energies, gradient, hessian)

    @property
    def traction(self) -> Array:
        """Traction (m,), MPa."""
        return self.gradient[:, 0]

    @property
    def charge(self) -> Array:
        """Charge (m,), pC/um2; zero without potentials."""
        return self.gradient[:, 1] if self.gradient.shape[1] > 1 else np.zeros(len(self.gradient))

    @property
    def enthalpy(self) -> Array:
        """Enthalpy (m,), pJ/um2."""
        return sum((ENERGIES[name] * value for name, value in self.energies.items()), np.zeros(len(self.gradient)))

    def energy(self, name: str) -> Array:
        """Energy (m,) of this name, pJ/um2."""
        return self.energies.get(name, np.zeros(len(self.gradient)))

    @property
    def acts(self) -> Array:
        """Whether points (m,) have a force or a stiffness."""
        return self.gradient[:, 0].astype(bool) | np.einsum("mii->mi", self.hessian).any(axis=1)

    def extrapolated(self, change: Array) -> Array:
        """Gradient (m, k), extrapolated linearly by a change (m, k) of q."""
        return self.gradient + np.einsum("mij,mj->mi", self.hessian, change)

    def __getitem__(self, rows: Array) -> Response:
        energies = {name: value[rows] for name, value in self.energies.items()}
        return Response(energies, self.gradient[rows], self.hessian[rows])

    def __add__(self, other: Response) -> Response:
        names = {**self.energies, **other.energies}
        both = {
            name: self.energies[name] + other.energies[name]
            if name in self.energies and name in other.energies
            else value
            for name, value in names.items()
        }
        return Response(both, self.gradient + other.gradient, self.hessian + other.hessian)
