"""Newton's method (PETSc SNES): its start value, line search and end, and what is tried where it fails."""

from __future__ import annotations

import itertools
import logging
from contextlib import ExitStack

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.contact import active_set
from piezomat.forms import fenicsx
from piezomat.scene.sections import Solver
from piezomat.solver.linear import linear_solver
from piezomat.solver.outcome import NewtonReport, SolveError
from piezomat.solver.stabilization import Springs

log = logging.getLogger("piezomat")

PREFIXES = (f"piezomat{number}_" for number in itertools.count())  # one run's options are not the next one's
FIELD_FLOOR = 1e-3  # a field's residual is measured against at least this share of the other field's forces
SLOPE_REDUCTION = 0.5  # share of the first slope at which a line search is content
CONVERGING = 0.1  # share of the residual that a whole step leaves at most if it is taken without a look at the slope
LINE_SEARCHES = 30
UPHILL_GROWTH = 10.0  # how much a step that leads uphill may increase the residual
SHORTEST_STEP = 1e-3
JUMP = 1e-2  # share of a step within which a line search leaves a jump of the slope
FLIPS = "a point flips between two facets: it is in equilibrium on neither (contact.smoothing joins flat ones)"
PULLING = 1e-3  # of the forces: out of balance by less, floating bodies feel how the electric contact pulls
REFINEMENTS = 5  # of a linear solve
FLOWN = 4.0  # a part that moves by more than this times the largest part's size has flown away
REPAIRINGS = 12  # how often one solve may pair its surfaces anew because they moved further than foreseen
RECHECKS = 3  # how often one solve goes on because points had kept facets that they have left
FORESIGHTS = 20  # how often a step is solved for again because contact answers otherwise than it was foreseen
FORESEEN = 0.01  # share of the residual that this may leave
# How often in one solve a step may leave more than half of the residual before no more are solved for again: points
# go round corners, where contact answers otherwise than along the tangent, and a step foreseen there comes to nothing.
MISSES, MISSED = 2, 0.5
WILD = 1e15  # of the forces: a change that calls for more is rounding (a body that falls onto another: more than 1e6)
# Most candidate unknowns for which it is done: their dense solves cost more than iterations where there are many (2,100
# in an array of fibers: 8 iterations a step instead of 17, and a third more time).
FORESEEN_LIMIT = 1_500
CUTS = 4  # how often one solve may cut segments anew where it has ended


class Newton:
    """Solves a `Problem` at its present load level, starting from its present state. Every method is collective."""

    def __init__(self, problem: Problem, keys: Solver) -> None:
        self.problem = problem
        self.keys = keys
        self.comm = problem.comm
        self._residual = problem.state.duplicate()
        self._right = problem.state.duplicate()
        self._change = problem.state.duplicate()
        self._trial = problem.state.duplicate()
        self._trial_is_next = False
        self._reference = np.zeros(1 + problem.model.electric)
        self._repair = False
        self._linear_solve = ExitStack()
        self._springs = Springs(problem, self._solve)
        prefix = next(PREFIXES)
        self.linear = linear_solver(problem, keys)
        options = {"snes_linesearch_type": "basic", **self.linear.options(), **keys.petsc}
        self._options = {prefix + name: value for name, value in options.items()}
        for name, value in self._options.items():
            PETSc.Options()[name] = value
        self.snes = PETSc.SNES().create(self.comm)
        self.snes.setOptionsPrefix(prefix)
        self.snes.setType(PETSc.SNES.Type.NEWTONLS)
        self.snes.setTolerances(max_it=keys.max_iterations)
        self.snes.setFunction(self._evaluate, self._residual)
        self.snes.setConvergenceTest(self._converged)
        if problem.contact is not None:
            self.snes.setLineSearchPreCheck(self._shorten)
        self.linear.attach(self.snes.getKSP())
        self.snes.setFromOptions()

    def close(self) -> None:
        """Take this solver's options out of PETSc's database, which holds 512 at most. Not collective; ends its use."""
        options = PETSc.Options()
        for name in self._options:
            options.delValue(name)
        # SNES holds methods of this solver: with newer PETSc Python cannot find that the two hold only each other.
        self.snes.getDict().clear()
        self.linear.close()
        self.snes.destroy()

    def solve(self, margin: float, prescribed: float) -> NewtonReport:
        """Bring the problem's state to equilibrium; SolveError (and a spoilt state) if that fails.

        margin (um): how far the contact search looked when the step's surfaces were paired. prescribed (um): how far
        boundaries and planes move in the step. A load on a part that only contact can hold would throw it away before
        it is held: its springs are then made strong at first.
        """
        report = self._report = NewtonReport()
        if self.problem.stabilization.is_active:
            self._springs.solve(margin, prescribed, report)
        else:
            self._solve(margin, report)
        return report

    def _solve(self, margin: float, report: NewtonReport) -> None:
        problem = self.problem
        self._reference[:] = 0.0
        self._misses = 0
        if problem.contact is not None:
            # What nothing holds is thrown about by potentials that are not yet those of bodies in equilibrium.
            problem.contact.attraction = not (problem.model.has_unconstrained_bodies and problem.model.electric)
            problem.contact.set_tolerance_and_tangent(0, np.inf, unconstrained=problem.has_weakly_held_bodies)
        self._predict(report, closely=problem.is_linear)
        if problem.is_linear:
            self._refine(report)
            return
        cuts, rechecks = CUTS, RECHECKS
        for _ in range(REPAIRINGS):
            self._repair = False
            self.snes.setJacobian(self._tangent, *self._operators)
            with self._linear_solve:
                self.snes.solve(None, problem.state)
            report.iterations += self.snes.getIterationNumber()
            report.krylov += self.snes.getLinearSolveIterations()
            if not self._complete():
                continue
            if not self._repair:
                self._check(self.snes.getConvergedReason())
                penetration = problem.contact.penetration() if problem.contact else 0.0
                if penetration > 0.5 * margin:
                    margin = 4.0 * penetration
                elif rechecks and self._overstayed():
                    rechecks -= 1
                    continue
                elif cuts and problem.contact is not None and problem.contact.has_stale_segments():
                    cuts -= 1
                elif rechecks:
                    self._polish(report)
                    return
                else:
                    raise SolveError(FLIPS)
            else:
                margin = 2.0 * margin
            if problem.motion() > FLOWN * problem.model.parts.size.max():
                raise SolveError("a body flies away: it moves by more than its size in one step")
            problem.pair(margin)
        raise SolveError("the contact surfaces kept moving further than the contact search had looked")

    def _complete(self) -> bool:
        """Let what a condensation has left behind follow; whether the solve has ended there for good."""
        problem, condensation = self.problem, self.linear.condensation
        if condensation is None:
            return True
        with problem.timer("linear_solve"):
            spread = condensation.complete(problem.state)
        if spread:
            return False
        converged = self.snes.getConvergedReason() > 0
        if converged:
            problem.residual(problem.state, self._residual)
        return not converged or self._relative(self._residual) <= self.keys.tolerance

    def _polish(self, report: NewtonReport) -> None:
        """Solve once more and closely: a residual does not show how far a part that next to nothing holds is off."""
        if self.linear.close_tolerance is not None and self.problem.stabilization.is_active:
            self._predict(report, closely=True)
            self.problem.residual(self.problem.state, self._residual)

    def _overstayed(self) -> bool:
        """Whether points had kept facets that they have left, and without them there is no equilibrium here."""
        problem = self.problem
        if problem.contact is None or not problem.contact.tighten_projection_tolerance():
            return False
        problem.residual(problem.state, self._residual)
        return self._relative(self._residual) > self.keys.tolerance

    def _predict(self, report: NewtonReport, *, closely: bool = False) -> None:
        """The start value: one linear step from the converged state that takes up the change of what is fixed.

        Without it a boundary would jump while the rest stays, and the first residual would be that of a torn body.
        """
        problem = self.problem
        fixed = problem.model.constraints.fixed
        problem.residual(problem.state, self._residual)
        change = problem.prescribed_change()
        self._residual.copy(self._right)
        self._right.scale(-1.0)
        self._operators = self.linear.linearize(problem.state)
        problem.multiply(change, self._change)
        self._right.axpy(-1.0, self._change)
        self._right.array[fixed] = 0.0
        self._reference = np.maximum(self._reference, problem.model.unknowns.norms(self._right))
        self._right.array[fixed] = change.array_r[fixed]
        ksp = self.snes.getKSP()
        ksp.setOperators(*self._operators)
        tolerance = self.linear.close_tolerance if closely else self.linear.start_tolerance
        inexact = self.snes.getUseEW()
        if tolerance is not None:
            # Eisenstat and Walker's rule is for Newton's steps, and would have its say here too.
            self.snes.setUseEW(False)
            ksp.setTolerances(rtol=tolerance)
        with problem.timer("linear_solve"):
            ksp.solve(self._right, self._change)
        self.snes.setUseEW(inexact)
        self._check_ksp(ksp)
        report.iterations += 1
        report.krylov += ksp.getIterationNumber()
        if self._condensed_few():
            # From here on contact answers alone: what is foreseen of it takes no solve inside.
            self._trial.waxpy(1.0, self._change, problem.state)
            self.linear.condensation.hold(self._trial)
        self._foresee(problem.state, self._change, 1.0)
        problem.state.axpy(1.0, self._change)
        problem.state.array[fixed] = problem.prescribed_values

    def _foresee(self, x: PETSc.Vec, change: PETSc.Vec, residual: float) -> None:
        """Correct a linear solve's change of x until contact answers to it as was foreseen: the best that is found.

        Only where a solve is for the candidates of contact alone, and next to no work. Bonds that break are left to
        small steps. residual: the relative one at x.
        """
        problem, contact, ksp = self.problem, self.problem.contact, self.snes.getKSP()
        if not self._condensed_few() or self._misses >= MISSES or contact.adhesive or contact.evaluation_failed:
            return
        best, least = change.copy(), np.inf
        for _ in range(FORESIGHTS):
            if not self._condensed_few():
                break
            unforeseen = float(self._ratios(active_set.predict(contact, change)).max())
            if unforeseen < least:
                change.copy(best)
                least = unforeseen
            if not FORESEEN * residual < unforeseen < WILD:
                break
            # The bulk is linear, and stays in balance with what contact was to answer.
            problem.linearized_contact_residual(change, self._right)
            self._operators = self.linear.linearize(x)
            if self.linear.condensation.outgrown:
                self.linear.condensation.let_go()
                self._operators = self.linear.linearize(x)  # with more candidates
            problem.linearized_contact_residual(change, self._trial)
            self._right.axpy(-1.0, self._trial)
            self._right.array[problem.model.constraints.fixed] = 0.0
            with problem.timer("linear_solve"):
                ksp.setOperators(*self._operators)
                ksp.solve(self._right, self._trial)
            change.axpy(1.0, self._trial)
            self._report.krylov += ksp.getIterationNumber()
        best.copy(change)
        active_set.end_prediction(contact)

    def _condensed_few(self) -> bool:
        condensation = self.linear.condensation
        return condensation is not None and len(condensation.candidates) * condensation.block <= FORESEEN_LIMIT

    def _evaluate(self, snes: PETSc.SNES, x: PETSc.Vec, result: PETSc.Vec) -> None:
        reuse, self._trial_is_next = self._trial_is_next and x.equal(self._change), False
        if reuse:
            self._trial.copy(result)
            return
        self.problem.residual(x, result)

    def _shorten(self, x: PETSc.Vec, step: PETSc.Vec) -> None:
        """Line search of SNES's step (x becomes x - step): follow the enthalpy down to where it turns up again.

        Points that come into contact make the enthalpy much steeper than the tangent knew. It is convex in the
        displacements where adhesion does not soften, so the place where its slope along the step vanishes is found by
        safeguarded secants on the displacements' part of residual . step; a step that ends before it is left alone.
        A step that leads uphill, where the tangent is not positive, is halved until the residual is not much larger.
        Near the solution slopes are rounding: a whole step that leaves little of the residual is taken as it is.
        """
        self._linear_solve.close()
        step.scale(-1.0)
        self._foresee(x, step, self._report.residuals[-1])
        step.scale(-1.0)
        self._try(x, step, 1.0)
        left = self._trial.norm() / self._residual.norm()
        self._misses += left > MISSED
        if left <= CONVERGING:
            return
        slope_here = -self._slope(self._residual, step)
        if slope_here >= 0.0:
            length, bound = 1.0, UPHILL_GROWTH * self._residual.norm()
            while self._trial.norm() > bound and length > SHORTEST_STEP:
                length *= 0.5
                self._try(x, step, length)
            step.scale(length)
            return
        slope = -self._slope(self._trial, step)
        if not slope > SLOPE_REDUCTION * -slope_here:
            return
        low, high = (0.0, slope_here), (1.0, slope)
        for search in range(LINE_SEARCHES):
            # The slope is monotonic with kinks: secants by turns with halving.
            share = low[1] / (low[1] - high[1]) if search % 2 == 0 else 0.5
            length = low[0] + share * (high[0] - low[0])
            self._try(x, step, length)
            slope = -self._slope(self._trial, step)
            if abs(slope) <= SLOPE_REDUCTION * -slope_here:
                break
            low, high = (low, (length, slope)) if slope > 0.0 else ((length, slope), high)
            length = high[0]
            if high[0] - low[0] < JUMP:
                break
        step.scale(length)

    def _try(self, x: PETSc.Vec, step: PETSc.Vec, length: float) -> None:
        """Residual at x - length * step, which SNES will ask for next if it takes that step.

        Points find what they meet at the whole step alone: on the way there the slope must not jump where they do.
        """
        step.copy(self._change)
        self._change.aypx(-length, x)
        self._trial_is_next = length == 1.0
        self.problem.residual(self._change, self._trial, search=self._trial_is_next)

    def _slope(self, residual: PETSc.Vec, step: PETSc.Vec) -> float:
        d = self.problem.model.unknowns.displacements
        return self.comm.allreduce(float(np.vdot(d(residual), d(step))), op=MPI.SUM)

    def _tangent(self, snes: PETSc.SNES, x: PETSc.Vec, a: PETSc.Mat, p: PETSc.Mat) -> None:
        if self.problem.contact is not None:
            self.problem.contact.set_tolerance_and_tangent(
                snes.getIterationNumber(), self._report.residuals[-1], unconstrained=self.problem.has_weakly_held_bodies
            )
        self._operators = self.linear.linearize(x)
        if self.linear.condensation is not None:
            self.linear.condensation.hold(x)
        if [matrix.handle for matrix in self._operators] != [a.handle, p.handle]:
            snes.setJacobian(self._tangent, *self._operators)
        self._linear_solve.enter_context(self.problem.timer("linear_solve"))

    def _converged(self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]) -> int:
        """Each field's residual against the forces of that field; a NaN, or a pairing outgrown, ends the solve."""
        contact = self.problem.contact
        if contact is not None and contact.search_radius_exceeded:
            self._repair = True
            return PETSc.SNES.ConvergedReason.DIVERGED_FUNCTION_DOMAIN
        if self.linear.condensation is not None and self.linear.condensation.outgrown:
            return PETSc.SNES.ConvergedReason.DIVERGED_FUNCTION_DOMAIN
        residual = snes.getFunction()[0]
        ratio = self._relative(residual)
        if contact is not None and not contact.attraction and self._relatives(residual)[0] <= PULLING:
            contact.attraction = True
            self.problem.residual(snes.getSolution(), residual)
            ratio = self._relative(residual)
        self._report.residuals.append(ratio)
        if not np.isfinite(ratio):
            return fenicsx.NOT_A_NUMBER
        if ratio <= self.keys.tolerance:
            return PETSc.SNES.ConvergedReason.CONVERGED_FNORM_RELATIVE
        if iteration >= self.keys.max_iterations:
            return PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT
        return PETSc.SNES.ConvergedReason.ITERATING

    def _relative(self, residual: PETSc.Vec) -> float:
        """Largest of the fields' relative residuals."""
        return float(self._relatives(residual).max())

    def _relatives(self, residual: PETSc.Vec) -> NDArray[np.float64]:
        """Each field's residual over its reference: outer forces and the step's out-of-balance forces.

        What rounding alone makes of the largest forces that the model could carry is left out of account.
        """
        return self._ratios(self.problem.model.unknowns.norms(residual))

    def _ratios(self, norms: NDArray[np.float64]) -> NDArray[np.float64]:
        """The fields' norms over the forces of each."""
        problem = self.problem
        forces = np.maximum(self._reference, problem.external_forces())
        forces = np.maximum(forces, FIELD_FLOOR * forces.max())
        rounding = 2.0 * np.finfo(float).eps * problem.largest_force
        return np.maximum(norms[: len(forces)] - rounding, 0.0) / np.maximum(forces, rounding)

    def _refine(self, report: NewtonReport) -> None:
        """Repeat a linear solve on what its residual leaves, as a Krylov solver or a bad condition may ask for."""
        for _ in range(REFINEMENTS):
            self.problem.residual(self.problem.state, self._residual)
            report.residuals.append(self._relative(self._residual))
            if report.residuals[-1] <= self.keys.tolerance:
                return
            self._predict(report, closely=True)
        raise SolveError(f"the linear system was solved to a relative residual of {report.residuals[-1]:.1e} only")

    def _check(self, reason: int) -> None:
        if reason > 0:
            return
        last = self._report.residuals[-1] if self._report.residuals else float("nan")
        words = {
            PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT: f"Newton's method needs more than {self.keys.max_iterations} "
            f"iterations (relative residual {last:.1e})",
            fenicsx.NOT_A_NUMBER: "the residual is not a number",
            PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH: f"no step reduces the residual (relative {last:.1e})",
        }
        if reason == PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE:
            self._check_ksp(self.snes.getKSP())
        raise SolveError(words.get(reason, f"Newton's method stopped (PETSc SNES reason {reason})"))

    def _check_ksp(self, ksp: PETSc.KSP) -> None:
        reason = ksp.getConvergedReason()
        if reason > 0:
            return
        if self.linear.failure:
            raise SolveError(self.linear.failure)
        raise SolveError(f"the Krylov solver stopped after {ksp.getIterationNumber()} iterations (reason {reason})")
