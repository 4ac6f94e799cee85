"""Nodal loads: what tractions, pressures and charges add to the residual, and to the tangent where they follow."""

from __future__ import annotations

import dolfinx
import dolfinx.fem.petsc
from petsc4py import PETSc

from piezomat.discretization.model import Model
from piezomat.forms.loads import load_tangent


class NodalLoads:
    """The loads of a model at the load factors that its constants have. Every method is collective.

    vector: what the loads add to the residual, minus the nodal forces and charges; of the last `assemble`
    exist: whether the scene has loads, beside prescribed displacements and potentials
    follow_state: whether they depend on the state (pressure in finite kinematics), which makes the tangent unsymmetric
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        self.vector = model.new_vector()
        form = model.loads.form(model.trial_state, model.kinematics, model.potential_scale)
        tangent = None if form.empty() else load_tangent(form, model.trial_state)
        self.follow_state = tangent is not None
        self._form = None if form.empty() else dolfinx.fem.form(form)
        self._tangent_form = dolfinx.fem.form(tangent) if self.follow_state else None
        self._charged = any(row.charge is not None for row in model.scene.electrodes)
        self._pushed = len(model.constraints.motions) > 0
        self.exist = self._form is not None or self._charged or self._pushed

    def assemble(self) -> None:
        """Evaluate `vector` at the trial state of the model."""
        model = self._model
        if self._form is not None:
            model.assemble_vector(self._form, self.vector)
        if self._charged:
            model.constraints.potentials.set_values(self.vector, model.potential_scale * model.loads.charges)
        if self._pushed:
            model.constraints.motions.set_values(self.vector, -model.loads.forces)

    def add_tangent(self, matrix: PETSc.Mat) -> None:
        """Add their tangent at the trial state of the model to a matrix that is still to be assembled."""
        if self.follow_state:
            dolfinx.fem.petsc.assemble_matrix(matrix, self._tangent_form)
