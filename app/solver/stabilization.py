"""Parts that only contact can hold, brought to equilibrium: the springs on them are stronger for a while, or for good.

What next to nothing holds is thrown about by Newton's method. Where a load acts on such a part, its springs are made
strong at first and then weaker, down to where they bear nothing. Where no load does, as in a mat that planes press,
a hundred times stronger ones may stay, as long as their work is small; in a mat of many fibers they are there at once.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.solver.outcome import NewtonReport, SolveError

log = logging.getLogger("piezomat")

CARRIED = 1e-4  # share of the loads that the springs of a floating part may carry in the end
STRONGEST, FALL, LEAST_FALL = 1e7, 10.0, 1.3  # how strong they are at first; by what they weaken, at most, at least
THROUGH = 0.5  # share of the least thickness by which a floating part may move beyond what is prescribed in a step
MANY = 50  # loose parts, of which some are nearly always thrown about: their springs are stronger from the start
STRONGER, WORK = 100.0, 5e-4  # how strong springs may stay, and the share of the stored energy that they may then take
UNHELD = "nothing holds a body against the load on it: no boundary, and no contact"


class Springs:
    """Solves a problem some parts of which only contact can hold. Every method is collective.

    equilibrium(margin, report): Newton's method from the present state with the springs as they are.
    """

    def __init__(self, problem: Problem, equilibrium: Callable[[float, NewtonReport], None]) -> None:
        self.problem = problem
        self._equilibrium = equilibrium
        if problem.model.unconstrained[:, 0].sum() >= MANY and not problem.loads.exist:
            problem.set_stabilization(STRONGER)

    def solve(self, margin: float, prescribed: float, report: NewtonReport) -> None:
        """Bring the problem's state to equilibrium; SolveError (and a spoilt state) if that fails.

        margin: see `Newton.solve`. prescribed (um): how far boundaries and planes move in the step.
        """
        problem = self.problem
        try:
            self._solve(margin, prescribed, report)
            if problem.stabilization.load_share(problem.state, problem.loads.vector) <= CARRIED:
                return
        except SolveError as error:
            if not (problem.loads.exist or problem.model.has_unconstrained_bodies):
                raise
            log.info("loose bodies: %s", error)
        problem.converged_state.copy(problem.state)
        problem.pair(margin)
        if problem.loads.exist:
            self._let_down(margin, prescribed, report)
        else:
            problem.set_stabilization(STRONGER if problem.stabilization.factor == 1.0 else 1.0)
            self._solve(margin, prescribed, report)

    def _solve(self, margin: float, prescribed: float, report: NewtonReport) -> None:
        problem = self.problem
        self._equilibrium(margin, report)
        if self._flew(prescribed):
            raise SolveError(f"a body has flown: {THROUGH:g} of the thinnest one's thickness in one step")
        if problem.stabilization.factor == STRONGER:
            stored = sum(problem.bulk.energies(problem.state).values())
            if problem.stabilization.work(problem.state) > WORK * stored:
                raise SolveError("the springs that hold loose bodies take too much of the energy")

    def _let_down(self, margin: float, prescribed: float, report: NewtonReport) -> None:
        """Solve with strong springs of floating parts and ever weaker ones, so that no part leaps through another."""
        problem = self.problem
        here, last, fall = problem.state.copy(), STRONGEST * FALL, FALL
        try:
            while last > 1.0:
                factor = max(last / fall, 1.0)
                problem.set_stabilization(factor)
                try:
                    self._equilibrium(margin, report)
                    if self._flew(prescribed, here):
                        raise SolveError(UNHELD)
                except SolveError:
                    fall = fall**0.5
                    if fall < LEAST_FALL or last > STRONGEST:
                        raise
                    here.copy(problem.state)
                    problem.pair(margin)
                else:
                    problem.state.copy(here)
                    last, fall = factor, min(fall**2, FALL)
        finally:
            problem.set_stabilization(1.0)
        if problem.stabilization.load_share(problem.state, problem.loads.vector) > CARRIED:
            raise SolveError(UNHELD)

    def _flew(self, prescribed: float, since: PETSc.Vec | None = None) -> bool:
        """Whether a part may have flown through another: its springs are too weak to hold it or to tell."""
        problem = self.problem
        return problem.motion(since) > prescribed + THROUGH * problem.model.parts.thickness.min()
