"""The bulk: residual, tangent and stored energies of the bodies' material, from compiled forms."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import dolfinx
import dolfinx.fem.petsc
import numpy as np
from petsc4py import PETSc

from piezomat.discretization.model import Model
from piezomat.discretization.term import AssembledTerm
from piezomat.discretization.unknowns import Unknowns
from piezomat.forms.enthalpy import internal_form, stored_energies, tangent_form
from piezomat.forms.evaluation import integral


class Bulk(AssembledTerm):
    """The derivatives of the bodies' enthalpy at the state of a model. Every method is collective.

    is_constant: in small kinematics with linear laws
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        self.is_constant = model.kinematics == "small" and all(region.law.is_linear for region in model.regions)
        arguments = model.trial_state, model.regions, model.kinematics
        self._tangent_form = dolfinx.fem.form(tangent_form(*arguments))
        self._work = model.new_vector()
        self._energy_forms = [None if e is None else dolfinx.fem.form(e) for e in stored_energies(*arguments)]

    def new_matrix(self) -> PETSc.Mat:
        """A matrix with the places of the tangent's entries."""
        matrix = dolfinx.fem.petsc.create_matrix(self._tangent_form)
        if not self._model.unknowns.references:
            return matrix
        self.add_tangent(matrix)  # without values it has no places
        return with_reference_nodes(matrix, self._model.unknowns)

    def add_tangent(self, matrix: PETSc.Mat) -> None:
        """See `AssembledTerm.add_tangent`."""
        dolfinx.fem.petsc.assemble_matrix(matrix, self._tangent_form)
        matrix.assemble()

    def add_residual(self, x: PETSc.Vec, result: PETSc.Vec) -> None:
        """See `AssembledTerm.add_residual`."""
        self._model.assemble_vector(self._residual_form, self._work)
        result.axpy(1.0, self._work)

    @cached_property
    def _residual_form(self) -> Any:
        """Compiled when it is needed: the residual of a constant tangent is it times the state."""
        model = self._model
        return dolfinx.fem.form(internal_form(model.trial_state, model.regions, model.kinematics))

    def energies(self, x: PETSc.Vec) -> dict[str, float]:
        """Stored energies at x, pJ (2D: per um of depth): elastic, electric."""
        self._model.set_trial_state(x)
        elastic, electric = self._energy_forms
        return {
            "elastic": integral(elastic),
            "electric": integral(electric) if electric is not None else 0.0,
        }


def with_reference_nodes(matrix: PETSc.Mat, unknowns: Unknowns) -> PETSc.Mat:
    """A matrix with the places of an assembled one, which it replaces, and those of reference nodes. Collective."""
    b, rows = unknowns.block, unknowns.references_here * unknowns.block
    pointer, columns, _ = matrix.getValuesCSR()
    # All reference nodes are coupled, by circuits; they are of one rank.
    every = np.tile(unknowns.total + np.arange(rows), rows)
    columns = np.concatenate([columns, every]).astype(PETSc.IntType)
    pointer = np.concatenate([pointer, pointer[-1] + rows * np.arange(1, rows + 1)]).astype(PETSc.IntType)
    sizes = (len(pointer) - 1, unknowns.total + unknowns.references * b)
    csr = pointer, columns, np.zeros(len(columns))
    result = PETSc.Mat().createAIJ((sizes, sizes), bsize=b, csr=csr, comm=matrix.comm.tompi4py())
    result.setLGMap(*matrix.getLGMap())  # forms are assembled by the local numbers of the mesh's nodes
    matrix.destroy()
    return result
