"""Start value of Newton's method: one linear step from the converged state that takes up the prescribed change.

Without it a boundary would jump while the rest stays, and the first residual would be that of a torn body. With u the
free and v the prescribed unknowns, K the tangent and R the residual at the converged state, the step solves

    K_uu du = -R_u - K_uv dv,   dv = prescribed values - v.
"""

from __future__ import annotations

from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.contact.interfaces import Interfaces
from piezomat.discretization.evaluation_mode import EvaluationMode
from piezomat.solver.active_set_prediction import ActiveSetPrediction
from piezomat.solver.convergence import Convergence
from piezomat.solver.first_contact import settle
from piezomat.solver.linear import LinearSolver
from piezomat.solver.linear_solve import solve
from piezomat.solver.outcome import NewtonReport


class StartValue:
    """Takes one linear step of a problem to its load level. Every method is collective."""

    def __init__(
        self,
        problem: Problem,
        contact: Interfaces | None,
        linear: LinearSolver,
        snes: PETSc.SNES,
        convergence: Convergence,
        prediction: ActiveSetPrediction,
    ) -> None:
        self.problem = problem
        self._contact = contact
        self.linear = linear
        self.snes = snes
        self.convergence = convergence
        self.prediction = prediction
        self._right = problem.state.duplicate()
        self._change = problem.state.duplicate()

    def step(self, report: NewtonReport, mode: EvaluationMode, *, closely: bool = False) -> None:
        """Change the problem's state by the solution of the tangent there; SolveError where the linear solve fails.

        Contact is evaluated in this mode.
        closely: with the close tolerance of a Krylov solver, not that of a start value.
        """
        problem, right, step = self.problem, self._right, self._change
        settle(problem, self._contact, mode)
        fixed = problem.model.constraints.fixed
        self.linear.equations.residual(problem.state, right, mode)
        right.scale(-1.0)
        prescribed = problem.prescribed_change()
        self.linear.linearize(problem.state, mode)
        problem.multiply(prescribed, step)
        problem.model.constraints.reduce(step)
        right.axpy(-1.0, step)
        self.convergence.add_reference(right)
        right.array[fixed] = prescribed.array_r[fixed]
        tolerance = self.linear.close_tolerance if closely else self.linear.start_tolerance
        solve(problem, self.linear, self.snes, right, step, tolerance)
        report.add(self.snes.getKSP().getIterationNumber(), iterations=1)
        if self.prediction.is_cheap:
            # From here on contact alone is out of balance: its prediction takes no solve inside the bodies.
            right.waxpy(1.0, step, problem.state)
            self.linear.equations.reduce(right)
        self.prediction.correct(problem.state, step, 1.0, report, mode)
        problem.state.axpy(1.0, step)
        problem.take_prescribed_values()
