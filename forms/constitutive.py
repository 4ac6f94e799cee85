"""What a material law is: the enthalpy density of a body in UFL, and what else is asked of a body's material.

s is the strain in Voigt order (engineering shears) and, where the model has a potential, the electric field over the
potential's scale: 3 + 2 entries in 2D, 6 + 3 in 3D, see `piezomat.forms.kinematics.strain_and_field`. The numbers of a
material are given to UFL as constants of each cell, so that all materials of one class share their compiled forms.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, Literal, Protocol

import numpy as np
import ufl
from numpy.typing import ArrayLike

from piezomat.forms.arrays import Array

Plane = Literal["strain", "stress"]


class ConstitutiveLaw(Protocol):
    """The law of a body's material. A subclass has `numbers`, `density`, and the means at least.

    is_linear: whether the density is quadratic in s; with small strains the tangent is then constant
    has_plane_stress: whether the law can be that of plane stress; else a 2D model is one of plane strain
    conductor: whether a body of it is a metal, of one potential
    """

    conductor: bool = False
    is_linear: bool = False
    has_plane_stress: bool = False

    @property
    def is_piezoelectric(self) -> bool:
        """Whether the material is poled, so that the direction of its axes matters."""
        return False

    @property
    def electric(self) -> bool:
        """Whether the material carries a potential."""
        return self.mean_permittivity > 0.0

    def rotated(self, poling: ArrayLike, axis1: ArrayLike | None = None) -> ConstitutiveLaw:
        """The material with its axis 3 along `poling`, see `Material.rotated`; an isotropic one is the same."""
        return self

    @property
    @abstractmethod
    def mean_stiffness(self) -> float:
        """Stiffness at uniaxial strain about the undeformed state, mean over all directions, MPa."""

    @property
    @abstractmethod
    def mean_permittivity(self) -> float:
        """Mean of the permittivities along the axes, pC/(V um); 0 without a potential."""

    @property
    @abstractmethod
    def poisson_ratio(self) -> float:
        """That of the undeformed state."""

    @abstractmethod
    def numbers(self, dim: int, plane: Plane, potential_scale: float | None) -> Array:
        """The material's constants (n,) for `density`, as many for all materials of a class.

        potential_scale: V, by which the field in s is to be multiplied; None: s has no field.
        """

    def numbers_in(self, axes: Array, potential_scale: float | None) -> Array:
        """The `numbers` (k, n) in 3D of the material with its axes along the columns of rotations (k, 3, 3).

        An isotropic one has the same in all.
        """
        return np.tile(self.numbers(3, "strain", potential_scale), (len(axes), 1))

    @abstractmethod
    def density(self, s: Any, numbers: Any) -> Any:
        """UFL enthalpy density of s, pJ/um3, with the `numbers` as a UFL vector and nothing else of the material."""

    def gradient(self, s: Any, numbers: Any) -> Any:
        """UFL vector dH/ds: stress, and minus the electric displacement times the potential's scale."""
        state = ufl.variable(s)
        return ufl.diff(self.density(state, numbers), state)

    def stored_energies(self, s: Any, numbers: Any) -> tuple[Any, Any | None]:
        """UFL densities of the elastic energy, that without field, and the electric energy; None without a potential.

        Their sum is the internal energy H + E.D.
        """
        if len(s) in (3, 6):
            return self.density(s, numbers), None
        strains = 3 if len(s) == 5 else 6
        fields = range(strains, len(s))
        elastic = self.density(ufl.as_vector([s[i] if i < strains else 0.0 for i in range(len(s))]), numbers)
        gradient = self.gradient(s, numbers)
        return elastic, self.density(s, numbers) - sum(gradient[i] * s[i] for i in fields) - elastic


def in_space(s: Any) -> Any:
    """UFL vector s of 3D, of 6 or 9 entries; that of 2D with the zeros of plane strain."""
    zero = ufl.as_ufl(0.0)
    if len(s) in (6, 9):
        return s
    return ufl.as_vector([s[0], s[1], zero, zero, zero, s[2], *([s[3], s[4], zero] if len(s) == 5 else [])])


def tensors(s: Any) -> tuple[Any, Any]:
    """UFL strain tensor (3, 3) and field (3,) of s; in 2D those of plane strain. The field is zero where s has none."""
    s = in_space(s)
    strain = ufl.as_tensor([[s[0], s[5] / 2, s[4] / 2], [s[5] / 2, s[1], s[3] / 2], [s[4] / 2, s[3] / 2, s[2]]])
    return strain, ufl.as_vector([s[6], s[7], s[8]] if len(s) == 9 else [ufl.as_ufl(0.0)] * 3)
