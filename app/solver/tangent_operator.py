"""The tangent as an operator: its product with a vector, without a matrix of bulk and contact together."""

from __future__ import annotations

from petsc4py import PETSc

from piezomat.assembly.problem import Problem


class TangentOperator:
    """The tangent of a problem's last linearization, its prescribed unknowns eliminated, as PETSc's shell matrix.

    matrix: that shell. Every method is collective.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self._free = problem.state.duplicate()
        sizes = problem.state.getSizes()
        self.matrix = PETSc.Mat().createPython((sizes, sizes), self, comm=problem.comm)
        self.matrix.setUp()

    def close(self) -> None:
        """Part from PETSc's matrix: each holds the other."""
        self.matrix.destroy()

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, result: PETSc.Vec) -> None:
        """result = tangent times x."""
        fixed = self.problem.model.constraints.fixed
        x.copy(self._free)
        self._free.array[fixed] = 0.0
        self.problem.multiply(self._free, result)
        result.array[fixed] = x.array_r[fixed]
