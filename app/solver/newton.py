"""Newton's method (PETSc SNES) for the equilibrium of one load level.

    start value      one linear step that takes up the prescribed change         start_value
    iteration        residual, test of convergence                               convergence
                     tangent, linear solve                                       linear (condensation, multigrid)
                     correction of the step by predicted contact forces          active_set_prediction
                     length of the step                                          line_search
    end              conditions on the solution; repairs, after which it goes on end_checks

One iteration, as SNES goes through it:

    R = _residual_at(x)
    end if _test_convergence(R)      near equilibrium contact is evaluated completely, far from it not
    _tangent_at(x)                   K
    solve K s = R
    s = _adapt_step(x, s)            predicted, then shortened
    x = x - s

What contact leaves out far from equilibrium is its `EvaluationMode`, an argument of every evaluation. Whether x is all
unknowns or those of the nodes of contact is known to `linear.equations` alone.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace

import numpy as np
from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.assembly.terms import Terms
from piezomat.discretization.evaluation_mode import COMPLETE, EvaluationMode
from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.scene.errors import SceneError
from piezomat.scene.sections import Solver
from piezomat.solver.active_set_prediction import ActiveSetPrediction
from piezomat.solver.callbacks import callback, not_numbers, nothing
from piezomat.solver.capacitance import Capacitance
from piezomat.solver.convergence import Convergence
from piezomat.solver.end_checks import EndChecks
from piezomat.solver.line_search import LineSearch
from piezomat.solver.linear import linear_solver
from piezomat.solver.options import SolverOptions
from piezomat.solver.outcome import NewtonReport, SolveError
from piezomat.solver.start_value import StartValue
from piezomat.solver.step_watch import StepWatch

# Relative residual below which contact is evaluated completely. Further from equilibrium tractions and jumps are wrong
# by much more than what is left out is worth: of the tangent the geometric stiffness and the negative stiffness of the
# electric attraction, which make it indefinite for nothing (kept once it was there, half discs at 1e7 MPa/um failed),
# and, where bodies are loose, the attraction, which throws them about. That is then kept: it may raise the residual.
NEAR_EQUILIBRIUM = 1e-2
# Relative residual below which what surfaces face across open gaps is found anew in each iteration, and the most times
# of one solve on the way and in all. With what they face where a step begins the charge of half discs depends on the
# size of the step by 1 %; without the last times, which are those of converged states, the potential of crossed fibers
# by 1e-5. From 1e-2 on, Newton's method fails in a deep flattened disc and takes 66 for 63 iterations in an array; at
# the end alone 75.
RENEWAL = 1e-4
MAX_RENEWALS, MAX_RENEWALS_IN_ALL = 4, 8
MAX_REFINEMENTS = 5  # of a linear problem
MAX_REPAIRS = 12  # of one solve


class Newton:
    """Solves a `Problem` at its present load level, starting from its present state. Every method is collective.

    linear: how the tangent's systems are solved; snes: PETSc's Newton method, which calls the methods here;
    watch: the load step that the solves are for: it counts their iterations, and may end one;
    callback_errors: exceptions on their way through PETSc;
    convergence, line_search, prediction, start_value, checks: the parts of an iteration that have modules of their own.
    """

    def __init__(self, problem: Problem, terms: Terms, keys: Solver, watch: StepWatch | None = None) -> None:
        """terms: those of the problem."""
        self.problem = problem
        self._contact = contact = terms.contact
        self._stabilization = terms.stabilization
        self.keys = keys
        self.watch = watch or StepWatch()
        self.linear = linear_solver(problem, contact, keys)
        self.callback_errors = self.linear.callback_errors
        self._options = SolverOptions({"snes_linesearch_type": "basic", **self.linear.options()}, keys.petsc)
        self.snes = PETSc.SNES().create(problem.comm)
        self.snes.setOptionsPrefix(self._options.prefix)
        self.snes.setType(PETSc.SNES.Type.NEWTONLS)
        self.convergence = Convergence(problem, keys.tolerance)
        self.line_search = LineSearch(problem, self.linear)
        self.prediction = ActiveSetPrediction(problem, contact, self.linear, self.snes, self.convergence)
        self.start_value = StartValue(problem, contact, self.linear, self.snes, self.convergence, self.prediction)
        self.checks = EndChecks(problem, contact, self.linear, self.snes, self.convergence, keys.max_iterations)
        self._capacitance = Capacitance(problem, terms.circuits, self.linear, self.snes)
        self._residual = problem.state.duplicate()
        self._report = NewtonReport()
        self._mode = COMPLETE  # in which contact is evaluated in the present iteration
        self._renewals = 0  # of the present solve
        self._timed_linear_solve = ExitStack()
        self.snes.setTolerances(max_it=keys.max_iterations)
        self.snes.setFunction(self._residual_at, self._residual)
        self.snes.setConvergenceTest(self._test_convergence)
        if contact is not None or problem.model.constraints.ties:
            self.snes.setLineSearchPreCheck(self._adapt_step)
        self._options_are_checked = False
        try:
            with self._options.blamed():
                self.linear.attach(self.snes.getKSP())
                self.snes.setFromOptions()
            self._options.check_used(problem.comm, ("snes_", "ksp_"))
        except SceneError:
            self.close()  # or Python calls methods of what is gone when it ends
            raise

    def close(self) -> None:
        """Take this solver's options out of PETSc's database. Not collective; ends its use."""
        self._options.remove()
        # SNES holds methods of this solver: with newer PETSc Python cannot find that the two hold only each other.
        self.snes.getDict().clear()
        self.linear.close()
        self.snes.destroy()

    def solve(self, search_radius: float, report: NewtonReport, *, settled: bool = False) -> None:
        """Bring the problem's state to equilibrium; SolveError, or StepAbandoned, and a spoilt state if that fails.

        search_radius (um): of the contact search at the start of the step. The effort is added to the report.
        settled: the state was in equilibrium, and what has changed since is weak: contact is evaluated as it is there.
        """
        self._report, first = report, len(report.residuals)
        before = self.linear.factor_solves
        try:
            with self._options.blamed():
                self._solve(search_radius, settled=settled)
            report.note_converged(first)
        finally:
            self.linear.equations.discard()  # of a solve that has failed on the way
            report.add_condensed(self.linear.factor_solves - before, self.linear.candidates)

    def capacitance(self) -> Array | None:
        """Capacitance matrix of the electrodes at the problem's state, see `Capacitance`; None without any."""
        with self._options.blamed():
            return self._capacitance.matrix()

    def _solve(self, search_radius: float, *, settled: bool) -> None:
        problem, report = self.problem, self._report
        for part in (self.convergence, self.line_search, self.prediction):
            part.start()
        self.checks.start(search_radius)
        attraction = settled or not (problem.model.has_unconstrained_bodies and problem.model.electric)
        self._mode, self._renewals = EvaluationMode(attraction=attraction, consistent=settled), 0
        self.watch.count()
        self.watch.end_step()
        self.start_value.step(report, self._mode, closely=problem.is_linear or settled)
        started = report.iterations
        if not self._options_are_checked:  # the parts of the linear solver are set up now, which the others are read by
            self._options.check_used(problem.comm, ("",))
            self._options_are_checked = True
        if problem.is_linear:
            self._refine()
            return
        for _ in range(MAX_REPAIRS):
            self._iterate()
            if not self.checks.repair(report):
                if not settled or report.iterations > started:  # the start was as close
                    self._final_solve()
                return
        raise SolveError("the contact surfaces kept moving further than the contact search had looked")

    def _iterate(self) -> None:
        """Newton's iterations from the present state to convergence, failure, or the end of the search radius."""
        self.snes.setJacobian(self._tangent_at, *self.linear.operators)
        with self._timed_linear_solve, self.callback_errors.raised():
            self.snes.solve(None, self.problem.state)
        number = self.snes.getIterationNumber()
        self._report.add(self.snes.getLinearSolveIterations(), iterations=number, linear_solves=number)
        self.watch.end_step()

    @callback(instead=not_numbers)
    def _residual_at(self, snes: PETSc.SNES, x: PETSc.Vec, result: PETSc.Vec) -> None:
        self.line_search.residual(x, result, self._mode)

    @callback(instead=lambda *_: fenicsx.NOT_A_NUMBER)
    def _test_convergence(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        """Converged, diverged (not a number, or contact beyond the search or the equations), or neither."""
        contact, equations = self._contact, self.linear.equations
        x, residual = snes.getSolution(), snes.getFunction()[0]
        if equations.is_exceeded or (contact is not None and contact.search_radius_exceeded):
            return PETSc.SNES.ConvergedReason.DIVERGED_FUNCTION_DOMAIN
        relative = self.convergence.relative_residual(residual)
        is_near = relative <= max(NEAR_EQUILIBRIUM, self.convergence.tolerance)
        if is_near and self._complete(x, relative):
            equations.residual(x, residual, self._mode)
            relative = self.convergence.relative_residual(residual)
        self._report.residuals.append(relative)
        if not np.isfinite(relative):
            return fenicsx.NOT_A_NUMBER
        if relative <= self.convergence.tolerance:
            return PETSc.SNES.ConvergedReason.CONVERGED_FNORM_RELATIVE
        if self.watch.count(relative):
            return PETSc.SNES.ConvergedReason.DIVERGED_FUNCTION_COUNT
        if iteration >= self.keys.max_iterations:
            return PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT
        return PETSc.SNES.ConvergedReason.ITERATING

    def _complete(self, x: PETSc.Vec, relative: float) -> bool:
        """Let the attraction act, and find anew what surfaces face at the state x; whether the residual changes."""
        contact, before, tolerance = self._contact, self._mode, self.convergence.tolerance
        if contact is None:
            return False
        self._mode, renewed = replace(before, attraction=True), False
        if relative <= max(RENEWAL, tolerance):
            self._renewals += 1
            most = MAX_RENEWALS if relative > tolerance else MAX_RENEWALS_IN_ALL
            renewed = self._renewals <= most and contact.renew_partners(x)
        return renewed or not before.attraction

    @callback(instead=nothing)
    def _tangent_at(self, snes: PETSc.SNES, x: PETSc.Vec, operator: PETSc.Mat, matrix: PETSc.Mat) -> None:
        linear = self.linear
        self._mode = replace(self._mode, consistent=self._report.residuals[-1] <= NEAR_EQUILIBRIUM)
        linear.linearize(x, self._mode)
        linear.equations.reduce(x)
        if [m.handle for m in linear.operators] != [operator.handle, matrix.handle]:
            snes.setJacobian(self._tangent_at, *linear.operators)
        self._timed_linear_solve.enter_context(self.problem.timer("linear_solve"))

    @callback(instead=nothing)
    def _adapt_step(self, x: PETSc.Vec, step: PETSc.Vec) -> None:
        """Complete SNES's step (x becomes x - step) at tied unknowns; correct it by predictions, and shorten it."""
        self._timed_linear_solve.close()
        self.problem.model.constraints.expand(step)
        if self._contact is None:
            return
        step.scale(-1.0)
        self.prediction.correct(x, step, self._report.residuals[-1], self._report, self._mode)
        step.scale(-1.0)
        self.prediction.note_step(self.line_search.search(x, step, self._residual, self._mode))

    def _final_solve(self) -> None:
        """Solve once more and closely: a residual does not show how far a part that next to nothing holds is off."""
        if self.linear.close_tolerance is not None and self._stabilization.is_active:
            self.start_value.step(self._report, self._mode, closely=True)
            self.problem.residual(self.problem.state, self._residual)

    def _refine(self) -> None:
        """Repeat a linear solve on the residual it leaves, as a Krylov solver or a bad condition may require."""
        residuals = self._report.residuals
        for _ in range(MAX_REFINEMENTS):
            self.problem.residual(self.problem.state, self._residual)
            residuals.append(self.convergence.relative_residual(self._residual))
            if residuals[-1] <= self.convergence.tolerance:
                return
            self.start_value.step(self._report, self._mode, closely=True)
        raise SolveError(f"the linear system was solved to a relative residual of {residuals[-1]:.1e} only")
