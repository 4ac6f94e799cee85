"""What Newton's method solves: the whole problem, or its reduced form while the interior of the bulk is in balance.

Both have the same interface, and Newton's method does not know which of them it has.
"""

from __future__ import annotations

from typing import Protocol

from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.discretization.evaluation_mode import EvaluationMode
from piezomat.solver.condensation import Condensation


class Equations(Protocol):
    """Equations of a state x. Every method is collective.

    can_be_reduced: whether a part of x may be left behind, so that the end of a solve is to be checked as a whole
    """

    can_be_reduced: bool

    @property
    def is_reduced(self) -> bool:
        """Whether a part of x is left behind: since `reduce`, until `recover` or `discard`."""

    @property
    def is_exceeded(self) -> bool:
        """Whether a linearization since `reduce` had more contact than the reduced equations can hold."""

    def residual(self, x: PETSc.Vec, result: PETSc.Vec, mode: EvaluationMode) -> None:
        """result = residual at x, see `Problem.residual`; zero where x has been left behind."""

    def reduce(self, x: PETSc.Vec) -> None:
        """Leave behind the part of x that is in balance, if all of it is, until `recover` or `discard`."""

    def recover(self, x: PETSc.Vec) -> bool:
        """Bring into balance the part of x that was left behind; whether there was too much contact to hold."""

    def discard(self) -> None:
        """Take the part that was left behind as it is."""


class WholeProblem:
    """The equations of a problem."""

    can_be_reduced = is_reduced = is_exceeded = False

    def __init__(self, problem: Problem) -> None:
        self._problem = problem

    def residual(self, x: PETSc.Vec, result: PETSc.Vec, mode: EvaluationMode) -> None:
        """See `Problem.residual`."""
        self._problem.residual(x, result, mode)

    def reduce(self, x: PETSc.Vec) -> None:
        """Leave nothing behind."""

    def recover(self, x: PETSc.Vec) -> bool:
        """Nothing was left behind."""
        return False

    def discard(self) -> None:
        """Nothing was left behind."""


class ReducedProblem:
    """The equations of a problem whose bulk is condensed to the nodes that may come into contact."""

    can_be_reduced = True

    def __init__(self, problem: Problem, condensation: Condensation) -> None:
        self._problem = problem
        self._condensation = condensation

    @property
    def is_reduced(self) -> bool:
        """Whether the interior is left behind."""
        return self._condensation.is_reduced

    @property
    def is_exceeded(self) -> bool:
        """Whether contact has spread beyond the candidates."""
        return self._condensation.candidates_exceeded

    def residual(self, x: PETSc.Vec, result: PETSc.Vec, mode: EvaluationMode) -> None:
        """See `Problem.residual`; that of the condensed bulk while it is reduced."""
        self._problem.residual(x, result, mode, self._condensation.residual if self.is_reduced else None)

    def reduce(self, x: PETSc.Vec) -> None:
        """See `Condensation.start`."""
        self._condensation.start(x)

    def recover(self, x: PETSc.Vec) -> bool:
        """See `Condensation.recover`."""
        with self._problem.timer("linear_solve"):
            return self._condensation.recover(x)

    def discard(self) -> None:
        """See `Condensation.discard`."""
        self._condensation.discard()
