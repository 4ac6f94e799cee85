"""One linear solve with the tangent of a problem, outside PETSc's Newton iterations."""

from __future__ import annotations

from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.solver.convergence import require_linear_solve
from piezomat.solver.linear import LinearSolver


def solve(
    problem: Problem,
    linear: LinearSolver,
    snes: PETSc.SNES,
    right: PETSc.Vec,
    result: PETSc.Vec,
    tolerance: float | None,
    *,
    guess: bool = False,
) -> None:
    """result = solution with the operators of `linear`, tied unknowns included. Collective.

    tolerance: relative, of a Krylov solver; None: the one that it has. guess: whether it begins at `result`. SolveError
    where the solve fails.
    """
    ksp, inexact = snes.getKSP(), snes.getUseEW()
    ksp.setOperators(*linear.operators)
    if tolerance is not None:
        # Eisenstat and Walker's rule is for Newton's steps, and would change the tolerance of this solve too.
        snes.setUseEW(False)
        ksp.setTolerances(rtol=tolerance)
    ksp.setInitialGuessNonzero(guess)
    with problem.timer("linear_solve"), linear.callback_errors.raised():
        ksp.solve(right, result)
    ksp.setInitialGuessNonzero(False)
    snes.setUseEW(inexact)
    require_linear_solve(ksp, linear.failure)
    problem.model.constraints.expand(result)
