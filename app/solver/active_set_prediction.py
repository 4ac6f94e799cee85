"""Active-set prediction: a linear solve is repeated with the contact law at the gaps that it predicts.

Contact laws have sharp bends, gaps have not: a Newton step along the law's tangent closes points that should have
opened, and the next step corrects a few of them. Here the gaps and jumps alone are linearized. The law responds at the
predicted ones, and the step is solved for again with this response until both agree: Newton's method within a step, on
the nodes that may touch (a semismooth one; with a penalty that of the primal-dual active set, Hintermueller, Ito and
Kunisch, SIAM J. Optim. 13 (2003) 865-888). Where the bulk is linear and condensed to these nodes, such a solve and an
evaluation of the law at predicted gaps are next to no work.

In the benchmark's half discs, driven by a boundary, it saves nothing; where a load drives them, 0.27 s become 0.49
without it, 0.36 0.63, and 0.17 0.43. The number of linear solves is the same; that of Newton iterations halves.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.contact.interfaces import Interfaces
from piezomat.discretization.evaluation_mode import EvaluationMode
from piezomat.solver.convergence import Convergence
from piezomat.solver.linear import LinearSolver
from piezomat.solver.outcome import NewtonReport

MAX_PREDICTIONS = 20  # of one step
PREDICTION_TOLERANCE = 0.01  # change of the predicted contact forces, share of the residual, at which a step is done
# Number of steps in one solve that leave more than half of the residual, after which no more are predicted: points go
# round corners, where contact responds otherwise than along the tangent, and a step predicted there comes to nothing.
MAX_POOR_STEPS, POOR_STEP = 2, 0.5
# Of the forces: a change that calls for more is rounding (a body that falls onto another: more than 1e6).
LARGEST_CHANGE = 1e15
# Most candidate unknowns for which it is done: their dense solves cost more than iterations where there are many (2,100
# in an array of fibers: 8 iterations a step instead of 17, and a third more time).
CANDIDATE_LIMIT = 1_500


class ActiveSetPrediction:
    """Corrects the linear solves of Newton's method by predicted contact forces. Every method is collective.

    poor_steps: steps of the present solve that left more than `POOR_STEP` of the residual.
    """

    def __init__(
        self,
        problem: Problem,
        contact: Interfaces | None,
        linear: LinearSolver,
        snes: PETSc.SNES,
        convergence: Convergence,
    ) -> None:
        self.problem = problem
        self._contact = contact
        self.linear = linear
        self.snes = snes
        self.convergence = convergence
        self.poor_steps = 0
        self._right = problem.state.duplicate()
        self._work = problem.state.duplicate()

    def start(self) -> None:
        """Begin a solve."""
        self.poor_steps = 0

    def note_step(self, left: float) -> None:
        """Take note of a whole step that left this share of the residual."""
        self.poor_steps += left > POOR_STEP

    @property
    def is_cheap(self) -> bool:
        """Whether a solve is for few candidates of contact alone."""
        candidates = self.linear.candidates * self.problem.model.unknowns.block
        return self.linear.equations.can_be_reduced and candidates <= CANDIDATE_LIMIT

    def correct(
        self, x: PETSc.Vec, change: PETSc.Vec, residual: float, report: NewtonReport, mode: EvaluationMode
    ) -> None:
        """Correct a linear solve's change of x until contact responds to it as predicted: the best that is found.

        Only where a solve is cheap. Bonds that break are left to small steps. residual: the relative one at x. mode:
        in which contact was linearized. The matrix of the last linear solve may be another one afterwards.
        """
        problem, contact, ksp = self.problem, self._contact, self.snes.getKSP()
        if not self.is_cheap or self.poor_steps >= MAX_POOR_STEPS or contact.adhesive or contact.evaluation_failed:
            return
        best, least = change.copy(), np.inf
        for _ in range(MAX_PREDICTIONS):
            if not self.is_cheap:
                break
            error = float(self.convergence.relative_norms(contact.predict(change)).max())
            if error < least:
                change.copy(best)
                least = error
            if not PREDICTION_TOLERANCE * residual < error < LARGEST_CHANGE:
                break
            # The bulk is linear, and stays in balance with the contact forces that were predicted before.
            problem.linearized_block_residual(change, self._right)
            self.linear.linearize(x, mode)
            if self.linear.equations.is_exceeded:
                self.linear.equations.discard()
                self.linear.linearize(x, mode)  # with more candidates
            problem.linearized_block_residual(change, self._work)
            self._right.axpy(-1.0, self._work)
            problem.model.constraints.reduce(self._right)
            with problem.timer("linear_solve"):
                ksp.setOperators(*self.linear.operators)
                with self.linear.callback_errors.raised():
                    ksp.solve(self._right, self._work)
            problem.model.constraints.expand(self._work)
            change.axpy(1.0, self._work)
            report.add(ksp.getIterationNumber())
        best.copy(change)
        contact.end_prediction()
