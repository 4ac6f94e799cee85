"""Checks of the state where Newton's iterations have ended: each finds nothing, or repairs and lets the solve go on.

1. The interior of a condensed bulk is recovered, and the whole is in balance.
2. No surface has moved further than the contact search allows: else search again, twice as far.
3. Newton's method has converged: else SolveError.
4. No penetration is deeper than half of what the search looked at: else search again, four times as deep.
5. No segment has moved off the facets that it was cut at: else cut anew.
"""

from __future__ import annotations

from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.contact.interfaces import Interfaces
from piezomat.solver.convergence import Convergence, require_convergence
from piezomat.solver.linear import LinearSolver
from piezomat.solver.outcome import NewtonReport, SolveError

MAX_SEGMENT_REPAIRS = 4  # of one solve
FLOWN = 4.0  # a part that moves by more than this times the largest part's size has flown away


class EndChecks:
    """The conditions on the end of a solve. Every method is collective.

    search_radius (um): of the last contact search.
    """

    def __init__(
        self,
        problem: Problem,
        contact: Interfaces | None,
        linear: LinearSolver,
        snes: PETSc.SNES,
        convergence: Convergence,
        max_iterations: int,
    ) -> None:
        self.problem = problem
        self._contact = contact
        self.linear = linear
        self.snes = snes
        self.convergence = convergence
        self.max_iterations = max_iterations
        self.search_radius = 0.0
        self._segment_repairs = 0
        self._residual = problem.state.duplicate()

    def start(self, search_radius: float) -> None:
        """Begin a solve whose contact search has looked this far (um)."""
        self.search_radius = search_radius
        self._segment_repairs = MAX_SEGMENT_REPAIRS

    def repair(self, report: NewtonReport) -> bool:
        """Repair the first condition that does not hold; whether there was one, and the solve must go on.

        SolveError where a condition cannot be repaired.
        """
        if self._repair_interior() or self._repair_search_radius():
            return True
        require_convergence(self.snes, report.residuals, self.max_iterations, self.linear.failure)
        return self._repair_penetration() or self._repair_segments()

    def _repair_interior(self) -> bool:
        """Recover what reduced equations have left behind; go on where contact was more than they can hold."""
        problem, equations = self.problem, self.linear.equations
        if not equations.can_be_reduced:
            return False
        if equations.recover(problem.state):
            return True
        if self.snes.getConvergedReason() <= 0:
            return False
        problem.residual(problem.state, self._residual)
        return not self.convergence.is_balanced(self._residual)

    def _repair_search_radius(self) -> bool:
        contact = self._contact
        ended = self.snes.getConvergedReason() == PETSc.SNES.ConvergedReason.DIVERGED_FUNCTION_DOMAIN
        if contact is None or not (ended and contact.search_radius_exceeded):
            return False
        self._search_again(2.0 * self.search_radius)
        return True

    def _repair_penetration(self) -> bool:
        contact = self._contact
        penetration = contact.penetration() if contact is not None else 0.0
        if penetration <= 0.5 * self.search_radius:
            return False
        self._search_again(4.0 * penetration)
        return True

    def _repair_segments(self) -> bool:
        contact = self._contact
        if contact is None or not self._segment_repairs or not contact.has_stale_segments():
            return False
        self._segment_repairs -= 1
        self._search_again(self.search_radius)
        return True

    def _search_again(self, search_radius: float) -> None:
        problem, self.search_radius = self.problem, search_radius
        if problem.motion() > FLOWN * problem.model.parts.size.max():
            raise SolveError("a body flies away: it moves by more than its size in one step")
        problem.pair(search_radius)
