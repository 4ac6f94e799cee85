"""Nodal loads: what tractions, pressures and charges add to the residual, and to the tangent where they follow."""

from __future__ import annotations

import dolfinx
import dolfinx.fem.petsc
from petsc4py import PETSc

from piezomat.discretization.model import Model
from piezomat.discretization.term import AssembledTerm
from piezomat.forms.loads import load_tangent


class NodalLoads(AssembledTerm):
    """The loads of a model at the load factors that its constants have. Every method is collective.

    vector: what the loads add to the residual, minus the nodal forces and charges; of the last evaluation
    exist: whether the scene has loads, beside prescribed displacements and potentials
    is_constant, is_symmetric: unless they depend on the state (pressure in finite kinematics)
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        self.vector = model.new_vector()
        form = model.loads.form(model.trial_state, model.kinematics, model.potential_scale)
        tangent = None if form.empty() else load_tangent(form, model.trial_state)
        self.is_constant = self.is_symmetric = tangent is None
        self._form = None if form.empty() else dolfinx.fem.form(form)
        self._tangent_form = dolfinx.fem.form(tangent) if tangent is not None else None
        self._charged = any(row.charge is not None for row in model.scene.electrodes)
        self._pushed = len(model.constraints.motions) > 0
        self.exist = self._form is not None or self._charged or self._pushed

    def set_loads(self, factors: dict[str, float]) -> None:
        """Go to a load level, and evaluate `vector` at the trial state of the model."""
        self._model.loads.set_factors(factors)
        self._evaluate()

    def add_residual(self, x: PETSc.Vec, result: PETSc.Vec) -> None:
        """See `AssembledTerm.add_residual`."""
        if not self.is_constant:
            self._evaluate()
        result.axpy(1.0, self.vector)

    def add_constant_residual(self, result: PETSc.Vec) -> None:
        """Add `vector`."""
        result.axpy(1.0, self.vector)

    def add_external_forces(self, result: PETSc.Vec) -> None:
        """Add `vector`."""
        result.axpy(1.0, self.vector)

    def _evaluate(self) -> None:
        model = self._model
        if self._form is not None:
            model.assemble_vector(self._form, self.vector)
        if self._charged:
            model.constraints.potentials.set_values(self.vector, model.potential_scale * model.loads.charges)
        if self._pushed:
            model.constraints.motions.set_values(self.vector, -model.loads.forces)

    def add_tangent(self, matrix: PETSc.Mat) -> None:
        """See `AssembledTerm.add_tangent`."""
        if not self.is_constant:
            dolfinx.fem.petsc.assemble_matrix(matrix, self._tangent_form)
            matrix.assemble()
