"""Terms of a user's script whose matrix is not that of their residual are refused: their answer would be wrong."""

from __future__ import annotations

import dolfinx
import dolfinx.fem.petsc
import pytest
import ufl
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.discretization.model import Model
from piezomat.discretization.term import AssembledTerm
from piezomat.simulation import run
from tests.scenes import pressed


class Kinks(AssembledTerm):
    """Resists kinks of the displacement between cells: it couples nodes that share no cell."""

    def __init__(self, model: Model) -> None:
        self._model = model
        kink = ufl.jump(ufl.grad(model.trial_state[0]))
        energy = 0.5 * ufl.inner(kink, kink) * ufl.dS
        residual = ufl.derivative(energy, model.trial_state, ufl.TestFunction(model.unknowns.space))
        self._residual = dolfinx.fem.form(residual)
        self._tangent = dolfinx.fem.form(ufl.derivative(residual, model.trial_state))

    def add_residual(self, x: PETSc.Vec, result: PETSc.Vec) -> None:
        self._model.assemble_vector(self._residual, result)

    def add_tangent(self, matrix: PETSc.Mat) -> None:
        dolfinx.fem.petsc.assemble_matrix(matrix, self._tangent)
        matrix.assemble()


class Couple(AssembledTerm):
    """Couples the first node of all to the last one, of another body."""

    def __init__(self, model: Model) -> None:
        self._size = model.unknowns.total

    def add_residual(self, x: PETSc.Vec, result: PETSc.Vec) -> None:
        """Not asked for."""

    def add_tangent(self, matrix: PETSc.Mat) -> None:
        if matrix.getOwnershipRange()[0] == 0:
            matrix.setValue(0, self._size - 1, 1.0, addv=True)
        matrix.assemble()


@pytest.mark.parametrize("term", [Kinks, Couple])
def test_a_tangent_that_is_not_that_of_the_residual_is_an_error(term: type[AssembledTerm]) -> None:
    with pytest.raises(
        ValueError, match=rf"{term.__name__}: its tangent is not that of its residual, or couples nodes"
    ):
        run(pressed(2), MPI.COMM_SELF, terms=[term])
