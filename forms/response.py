"""Strain, stress and electric displacement in the cells, as the laws of their materials have them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import ufl
from numpy.typing import NDArray

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.forms.constitutive import ConstitutiveLaw, Plane, in_space
from piezomat.forms.enthalpy import Region
from piezomat.forms.evaluation import center_expression
from piezomat.forms.kinematics import Kinematics, strain_and_field
from piezomat.forms.materials import Material, Response


class CenterResponse:
    """Response of the materials at the centres of the cells of this rank, for the w of the forms.

    With finite kinematics these are the referential quantities: Green-Lagrange strain, second Piola-Kirchhoff stress.
    """

    def __init__(
        self,
        w: Any,
        regions: Sequence[Region],
        materials: Sequence[ConstitutiveLaw],
        cell_material: NDArray[np.int32],
        kinematics: Kinematics,
        plane: Plane,
        potential_scale: float | None,
        axes: Mapping[int, Array] | None = None,
    ) -> None:
        """Collective. Arguments: see `piezomat.forms.enthalpy.regions`."""
        self._mesh = w.function_space.mesh
        self._materials, self._cell_material = materials, cell_material
        self._plane, self._scale, self._axes = plane, potential_scale, axes or {}
        state = strain_and_field(w, kinematics)
        self._state = center_expression(state, self._mesh)
        # A linear law is evaluated from the strain, with the strain out of the plane in plane stress.
        self._of_laws = {}
        for region in regions:
            if not isinstance(region.law, Material):
                full = in_space(state)
                gradient = region.law.gradient(full, region.numbers)
                entries = [*(full[i] for i in range(6)), *(gradient[i] for i in range(len(full)))]
                self._of_laws[type(region.law)] = center_expression(ufl.as_vector(entries), self._mesh)

    def evaluate(self) -> tuple[Response, Array]:
        """The response of each cell, and its field (cells, 3), V/um: E, zero without a potential."""
        dim, count = self._mesh.geometry.dim, len(self._cell_material)
        strains = dim * (dim + 1) // 2
        state = fenicsx.at_centers(self._state, self._mesh)
        of_laws = {kind: fenicsx.at_centers(e, self._mesh) for kind, e in self._of_laws.items()}
        field = np.zeros((count, 3))
        if self._scale is not None:
            field[:, :dim] = self._scale * state[:, strains:]
        strain, stress, density = np.zeros((count, 6)), np.zeros((count, 6)), np.zeros((count, 3))
        for number, material in enumerate(self._materials):
            rows = self._cell_material == number
            if isinstance(material, Material):
                given = state[rows, :strains], field[rows, :dim]
                if number in self._axes:
                    response = material.response_in(self._axes[number], *given)
                else:
                    response = material.response(*given, dim, self._plane)
                strain[rows], stress[rows], density[rows] = response
                continue
            values = of_laws[type(material)][rows]
            strain[rows], stress[rows] = values[:, :6], values[:, 6:12]
            if self._scale is not None:
                density[rows] = -values[:, 12:] / self._scale
        return Response(strain, stress, density), field
