"""The tangent as an operator: its product with a vector, without a matrix of bulk and contact together."""

from __future__ import annotations

from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.solver.callbacks import CallbackErrors, callback, not_numbers


class TangentOperator:
    """The tangent of a problem's last linearization, as PETSc's shell matrix.

    matrix: that shell; callback_errors: those of `mult`, which PETSc calls. Every method is collective.
    """

    def __init__(self, problem: Problem, callback_errors: CallbackErrors) -> None:
        self.problem = problem
        self.callback_errors = callback_errors
        self._free = problem.state.duplicate()
        sizes = problem.state.getSizes()
        self.matrix = PETSc.Mat().createPython((sizes, sizes), self, comm=problem.comm)
        self.matrix.setUp()

    def close(self) -> None:
        """Part from PETSc's matrix: each holds the other."""
        self.matrix.destroy()

    @callback(instead=not_numbers)
    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, result: PETSc.Vec) -> None:
        """result = T^T K T x, and x at the eliminated unknowns."""
        constraints = self.problem.model.constraints
        x.copy(self._free)
        self._free.array[constraints.eliminated] = 0.0
        constraints.expand(self._free)
        self.problem.multiply(self._free, result)
        constraints.reduce(result)
        result.array[constraints.eliminated] = x.array_r[constraints.eliminated]
