"""Continuation of the stabilization: how stiff the springs on unconstrained bodies are while a load level is solved.

A body that contact alone can hold is thrown about by Newton's method. Weak springs at all its unknowns, which start
from the last converged state, keep the tangent regular. Each step is tried with them. Where they do not hold a body,
there are two ways:

- With loads, stiff springs are reduced from solve to solve, down to the weak ones, which carry none of the load.
- Without, as in a mat pressed by planes, springs a hundred times stiffer stay, as long as they take next to no energy.

Where forces on planes or rigid boundaries press, the springs are let go after each solve until they carry nothing. What
each of the three is worth is in the README of this folder.
"""

from __future__ import annotations

import logging
from typing import Protocol

from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.assembly.terms import Terms
from piezomat.solver.outcome import NewtonReport, SolveError

log = logging.getLogger("piezomat")

LARGEST_LOAD_SHARE = 1e-4  # of the loads that the weak springs may carry
# Initial stabilization factor under a load; largest and smallest factor by which it is reduced from solve to solve.
INITIAL_FACTOR, LARGEST_REDUCTION, SMALLEST_REDUCTION = 1e7, 10.0, 1.3
HELD = 0.05  # share of the loads that springs carry, below which contact holds the bodies: weak ones are tried at once
FLOWN = 0.5  # share of the least thickness by which a body may move further in a step than what is prescribed
# Factor of springs that stay stiffer, and the share of the stored energy that they may take.
STIFFER, LARGEST_ENERGY_SHARE = 100.0, 5e-4
RELEASED = 1e-10  # share of the forces on planes and rigid boundaries that springs may carry, let go so often at most
MAX_RELEASES = 8
UNHELD = "nothing holds a body against the load on it: no boundary, and no contact"

# As a round body does that a load presses on another one, with no boundary to hold it sideways.
UNSTABLE = "weak springs do not keep a loose body where it is: under its load it slides, rolls or flies off"


class Solve(Protocol):
    """Newton's method with the springs as they are, see `Newton.solve`."""

    def __call__(self, search_radius: float, report: NewtonReport, *, settled: bool = False) -> None: ...


class StabilizationContinuation:
    """Solves a problem with unconstrained bodies by changing the stiffness of their springs. Methods are collective.

    Each solve but the first starts where the springs before it were in equilibrium with all else. Attraction stays
    on there: two crossed fibers under a plane by force take 2 iterations for each spring instead of 4.
    """

    def __init__(self, problem: Problem, terms: Terms, newton: Solve) -> None:
        self.problem = problem
        self.stabilization, self._loads, self._bulk = terms.stabilization, terms.loads, terms.bulk
        self.newton = newton

    def set_factor(self, factor: float) -> None:
        """Make the springs `factor` times as stiff as the weak ones."""
        springs = self.stabilization
        if factor != springs.factor:
            self.problem.change_tangent(lambda matrix: springs.set_factor(factor, matrix))

    def solve(self, search_radius: float, prescribed: float, report: NewtonReport) -> None:
        """Bring the problem's state to equilibrium; SolveError (and a spoilt state) if that fails.

        search_radius, report: see `Newton.solve`. prescribed (um): how far boundaries and planes move in the step.
        """
        problem = self.problem
        try:
            self._solve(search_radius, prescribed, report)
            self._release(search_radius, prescribed, report)
            if self._load_share() <= LARGEST_LOAD_SHARE:
                return
        except SolveError as error:
            if not (self._loads.exist or problem.model.has_unconstrained_bodies):
                raise
            log.info("loose bodies: %s", error)
        problem.return_to_converged_state()
        problem.pair(search_radius)
        if self._loads.exist:
            self._reduce(search_radius, prescribed, report)
        else:
            self.set_factor(STIFFER if self.stabilization.factor == 1.0 else 1.0)
            self._solve(search_radius, prescribed, report)

    def _solve(self, search_radius: float, prescribed: float, report: NewtonReport, *, settled: bool = False) -> None:
        """Solve with the springs as they are; SolveError where a body has flown or stiffer springs take energy."""
        problem = self.problem
        self.newton(search_radius, report, settled=settled)
        if self._has_flown(prescribed):
            raise SolveError(f"a body has flown: {FLOWN:g} of the thinnest one's thickness in one step")
        if self.stabilization.factor == STIFFER:
            stored = sum(self._bulk.energies(problem.state).values())
            if self.stabilization.work(problem.state) > LARGEST_ENERGY_SHARE * stored:
                raise SolveError("the springs that hold loose bodies take too much of the energy")

    def _load_share(self) -> float:
        return self.stabilization.load_share(self.problem.state, self._loads.vector)

    def _release(self, search_radius: float, prescribed: float, report: NewtonReport) -> None:
        """Let the springs go and solve again, as often as they carry a share of forces that must be exact."""
        problem = self.problem
        if not len(problem.model.constraints.motions):
            return
        for _ in range(MAX_RELEASES):
            if self._load_share() <= RELEASED:
                return
            self.stabilization.release(problem.state)
            self._solve(search_radius, prescribed, report, settled=True)

    def _reduce(self, search_radius: float, prescribed: float, report: NewtonReport) -> None:
        """Solve with stiff springs and then ever weaker ones, so that no body leaps through another."""
        problem = self.problem
        here, last, reduction = problem.state.copy(), INITIAL_FACTOR * LARGEST_REDUCTION, LARGEST_REDUCTION
        may_leap = True
        try:
            while last > 1.0:
                is_held = may_leap and last <= INITIAL_FACTOR and last * self._load_share() <= HELD
                factor = 1.0 if is_held else max(last / reduction, 1.0)
                self.set_factor(factor)
                try:
                    self.newton(search_radius, report, settled=last <= INITIAL_FACTOR)
                    if self._has_flown(prescribed, here):
                        raise SolveError(UNHELD)
                except SolveError as error:
                    reduction, may_leap = reduction**0.5, False
                    if last > INITIAL_FACTOR:
                        raise
                    if reduction < SMALLEST_REDUCTION:
                        raise SolveError(f"{error}; {UNSTABLE}") from error
                    here.copy(problem.state)
                    problem.pair(search_radius)
                else:
                    problem.state.copy(here)
                    last, reduction = factor, min(reduction**2, LARGEST_REDUCTION)
        finally:
            self.set_factor(1.0)
        self._release(search_radius, prescribed, report)
        if self._load_share() > LARGEST_LOAD_SHARE:
            raise SolveError(UNHELD)

    def _has_flown(self, prescribed: float, since: PETSc.Vec | None = None) -> bool:
        """Whether a body may have passed through another, which weak springs neither prevent nor show."""
        problem = self.problem
        return problem.motion(since) > prescribed + problem.travel(since) + FLOWN * problem.model.parts.thickness.min()
