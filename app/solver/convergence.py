"""Convergence: the residual of each field against the forces of that field, and failures in words.

The reference of a field is the larger of its external forces (reactions, loads, planes) and the forces out of balance
that the step began with. It is at least `FIELD_FLOOR` of the other field's, or a potential that nothing drives would be
solved to rounding. What rounding makes of the largest forces that the model could carry is subtracted.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.solver.outcome import SolveError

FIELD_FLOOR = 1e-3  # least reference of a field, share of the other field's


class Convergence:
    """Relative residuals of a problem's fields, displacements and potential. Every method is collective.

    tolerance: relative residual of a solution. reference (1 or 2,): norms of the forces out of balance at the start of
    the present solve, uN and scaled charges.
    """

    def __init__(self, problem: Problem, tolerance: float) -> None:
        self.problem = problem
        self.tolerance = tolerance
        self.reference = np.zeros(1 + problem.model.electric)

    def start(self) -> None:
        """Begin a solve: without forces out of balance as yet."""
        self.reference[:] = 0.0

    def add_reference(self, forces: PETSc.Vec) -> None:
        """Raise the reference to these forces out of balance."""
        self.reference = np.maximum(self.reference, self.problem.model.unknowns.norms(forces))

    def relative_residual(self, residual: PETSc.Vec) -> float:
        """Largest of the fields' relative residuals."""
        return float(self.relative_norms(self.problem.model.unknowns.norms(residual)).max())

    def relative_norms(self, norms: Array) -> Array:
        """The fields' norms (1 or 2,) over the reference of each."""
        problem = self.problem
        forces = np.maximum(self.reference, problem.external_forces())
        forces = np.maximum(forces, FIELD_FLOOR * forces.max())
        rounding = 2.0 * np.finfo(float).eps * problem.largest_force
        return np.maximum(norms[: len(forces)] - rounding, 0.0) / np.maximum(forces, rounding)

    def is_balanced(self, residual: PETSc.Vec) -> bool:
        """Whether this is the residual of a solution."""
        return self.relative_residual(residual) <= self.tolerance


def require_linear_solve(ksp: PETSc.KSP, failure: str) -> None:
    """Raise SolveError where the last linear solve failed: with the words `failure`, or the reason of a Krylov solver.

    Collective.
    """
    reason = ksp.getConvergedReason()
    if reason > 0:
        return
    message = f"the Krylov solver stopped after {ksp.getIterationNumber()} iterations (reason {reason})"
    raise SolveError(failure or message)


def require_convergence(snes: PETSc.SNES, residuals: list[float], max_iterations: int, linear_failure: str) -> None:
    """Raise SolveError, the reason in words, where SNES has not converged. Collective.

    residuals: relative residuals of the iterations. linear_failure: see `require_linear_solve`.
    """
    reason = snes.getConvergedReason()
    if reason > 0:
        return
    if reason == PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE:
        require_linear_solve(snes.getKSP(), linear_failure)
    last = residuals[-1] if residuals else float("nan")
    words = {
        PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT: f"Newton's method needs more than {max_iterations} iterations "
        f"(relative residual {last:.1e})",
        fenicsx.NOT_A_NUMBER: "the residual is not a number",
        PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH: f"no step reduces the residual (relative {last:.1e})",
    }
    raise SolveError(words.get(reason, f"Newton's method stopped (PETSc SNES reason {reason})"))
