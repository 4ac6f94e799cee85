"""The bulk: residual, tangent and stored energies of the bodies' material, from compiled forms."""

from __future__ import annotations

from typing import Any

import dolfinx
import dolfinx.fem.petsc
from petsc4py import PETSc

from piezomat.discretization.model import Model
from piezomat.forms.enthalpy import internal_form, stored_energies, tangent_form
from piezomat.forms.evaluation import integral


class Bulk:
    """The derivatives of the bodies' enthalpy at the state of a model. Every method is collective.

    is_constant: whether the tangent is the same at any state (small kinematics); the residual is then tangent times
        state, and has no form
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        self.is_constant = model.kinematics == "small"
        arguments = model.trial_state, model.constitutive_field, model.kinematics
        self._tangent_form = dolfinx.fem.form(tangent_form(*arguments))
        self._residual_form = None if self.is_constant else dolfinx.fem.form(internal_form(*arguments))
        self._energy_forms = [None if e is None else dolfinx.fem.form(e) for e in stored_energies(*arguments)]

    def new_matrix(self) -> PETSc.Mat:
        """A matrix with the places of the tangent's entries."""
        return dolfinx.fem.petsc.create_matrix(self._tangent_form)

    def add_tangent(self, matrix: PETSc.Mat) -> None:
        """Add the tangent at the trial state of the model to a matrix that is still to be assembled."""
        dolfinx.fem.petsc.assemble_matrix(matrix, self._tangent_form)

    def assemble_residual(self, result: PETSc.Vec) -> None:
        """result = the residual at the trial state of the model; not for a constant tangent."""
        assemble_vector(result, self._residual_form)

    def energies(self, x: PETSc.Vec) -> dict[str, float]:
        """Stored energies at x, pJ (2D: per um of depth): elastic, electric."""
        self._model.set_trial_state(x)
        elastic, electric = self._energy_forms
        return {
            "elastic": integral(elastic),
            "electric": integral(electric) if electric is not None else 0.0,
        }


def assemble_vector(vector: PETSc.Vec, form: Any) -> None:
    """vector = the linear form, summed over the ranks. Collective."""
    with vector.localForm() as local:
        local.set(0.0)
    dolfinx.fem.petsc.assemble_vector(vector, form)
    vector.ghostUpdate(PETSc.InsertMode.ADD_VALUES, PETSc.ScatterMode.REVERSE)
