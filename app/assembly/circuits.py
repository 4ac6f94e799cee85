"""Circuits between electrodes: capacitances, which hold a share of the charge that the bodies give."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from piezomat.discretization.model import Model
from piezomat.discretization.term import AssembledTerm
from piezomat.forms.arrays import Array


class Circuits(AssembledTerm):
    """The circuits of a model in residual and tangent: unknowns of the electrodes' reference nodes alone.

    matrix (electrodes, electrodes), pC/V (2D: per um of depth): charges that flow into the circuits over voltages
    exist: whether the scene has circuits
    """

    def __init__(self, model: Model) -> None:
        names = model.electrode_names
        self.matrix: Array = np.zeros((len(names),) * 2)
        self.exist = bool(model.scene.circuits)
        for circuit in model.scene.circuits:
            ends = np.zeros(len(names))
            ends[[names.index(name) for name in circuit.between]] = 1.0, -1.0
            self.matrix += circuit.capacitance * np.outer(ends, ends)
        # Charges are minus the residual, potentials are scaled: see `Model.potential_scale`.
        self._scale = model.potential_scale if model.potential_scale is not None else 1.0
        self._tangent = -(self._scale**2) * self.matrix
        self._potentials = model.constraints.potentials
        self._holds_references = model.unknowns.references_here > 0

    def add_tangent(self, matrix: PETSc.Mat) -> None:
        """See `AssembledTerm.add_tangent`. Collective."""
        if not self.exist:
            return
        if self._holds_references:
            numbers = self._potentials.numbers.astype(PETSc.IntType)
            matrix.setValues(numbers, numbers, self._tangent, addv=PETSc.InsertMode.ADD_VALUES)
        matrix.assemble()

    def add_residual(self, x: PETSc.Vec, result: PETSc.Vec) -> None:
        """Add the charges that the circuits hold at x. Collective."""
        if not self.exist:
            return
        self._potentials.add_values(result, self._tangent @ self._potentials.values(x))

    def charges(self, x: PETSc.Vec) -> Array:
        """Charges (electrodes,) that have flowed into the circuits at x, pC (2D: per um of depth). Collective."""
        return self._scale * self.matrix @ self._potentials.values(x)
