"""Load steps: the load factors over a run, and how a step that fails is cut, repeated and grown again."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from piezomat.assembly.problem import Problem
from piezomat.contact.uzawa import augment
from piezomat.discretization.prescription import Factors
from piezomat.forms.contact.laws.interface import stable_electric_range
from piezomat.scene.sections import Load
from piezomat.solver.newton import Newton
from piezomat.solver.outcome import NewtonReport, SolveError
from piezomat.solver.snap_through import snap_through_work

log = logging.getLogger("piezomat")

SNAP_CUTBACKS = 3  # times that a step is halved before bonds are taken to snap
SNAP_PARTS = 1000  # in which they must come to rest; the most that any took is 107
SNAP_LEVELS, SNAP_FALL = 5, 0.25  # drag falls by this factor so many times before none is tried
SNAP_WAIT = 3  # parts to go on with a drag after less of it has failed
AUGMENTATIONS = 40  # of one solve
# Facets. A wave of length l in the surface that points press on shortens their way out by half of g (2 pi / l)^2 times
# its height squared: deep inside, at a gap -g, that frees more energy of the penalty than the wave costs the body.
DEEP = 0.5
PULLED_IN = 0.7  # of the gap that `stable_electric_range` asks for: less is named as what may have failed a step
DRAG = 1.0  # drag to begin with, in steepest falls of the bonds' traction


@dataclass(frozen=True)
class Step:
    """One increment of the scene: its number (from 1), its stage (from 1), and the factors at its ends."""

    number: int
    stage: int
    before: dict[str, float]
    after: dict[str, float]

    def factors(self, fraction: float) -> dict[str, float]:
        """Load factors at a fraction of the step."""
        if fraction == 1.0:
            return self.after
        return {name: (1.0 - fraction) * self.before[name] + fraction * self.after[name] for name in self.after}


def steps(load: Load) -> Iterator[Step]:
    """The increments of a scene's load, in order: linear within a stage, from zero at the start."""
    start = dict.fromkeys(load.factors, 0.0)
    before, number = start, 0
    for stage, count in enumerate(load.steps):
        end = {name: values[stage] for name, values in load.factors.items()}
        for i in range(1, count + 1):
            number += 1
            share = i / count
            after = end if i == count else {n: (1.0 - share) * start[n] + share * end[n] for n in end}
            yield Step(number, stage + 1, before, after)
            before = after
        start = end


@dataclass
class StepReport:
    """What a step took: Newton and Krylov iterations, augmentations, cuts, relative residuals of its solves."""

    newton: int
    krylov: int
    cutbacks: int
    solves: list[NewtonReport]
    augmentations: int = 0


class AugmentationError(SolveError):
    """Augmentation does not reach its tolerance, which smaller steps would not change."""


class Stepper:
    """Takes a problem through load steps. Every method is collective."""

    def __init__(
        self, problem: Problem, newton: Newton, max_cutbacks: int, augment_tolerance: float | None = None
    ) -> None:
        """augment_tolerance: see `contact.augment` of a scene; None: no augmentation."""
        self.problem = problem
        self.newton = newton
        self.max_cutbacks = max_cutbacks
        self.augment_tolerance = augment_tolerance
        self.size = 1.0  # share of a step that is tried at once; kept from step to step
        self.last_motion = 0.0  # how far a node moved in the last solve, um

    def advance(self, step: Step, committed: Callable[[Factors], None]) -> StepReport:
        """Take the step, in parts if need be; `committed(factors)` is called after each part that converged.

        Raises SolveError with the reason, the state being that of the last part that converged.
        """
        report = StepReport(0, 0, 0, [])
        done = 0.0
        while done < 1.0:
            target = min(done + self.size, 1.0)
            levels = step.factors(done) if step.number > 1 or done else None, step.factors(target)
            try:
                self._part(*levels, committed, report)
            except AugmentationError:
                raise
            except SolveError as error:
                report.cutbacks += 1
                contact, tried = self.problem.contact, target - done  # the last part of a step may be a small rest
                if contact is None or not contact.adhesive or tried > 0.5**SNAP_CUTBACKS:
                    self._cut(step, tried, error)
                    continue
                log.info("step %d: bonds snap: %s", step.number, error)
                self._snap(*levels, committed, report)
            done = target
            self.size = min(1.0, 2.0 * self.size)
        return report

    def _part(
        self,
        before: Factors | None,
        factors: Factors,
        committed: Callable[[Factors], None],
        report: StepReport,
        drag: float | None = None,
    ) -> None:
        """Go from the last converged state to a load level; SolveError, the state being as it was, if that fails.

        before: load level of the last converged state, None for the undeformed bodies.
        """
        problem = self.problem
        problem.set_loads(factors)
        prescribed = problem.model.prescription.motion(factors, before)
        margin = self.margin(prescribed)
        problem.begin_step(margin)
        if drag is not None:
            problem.residual(problem.state, problem.state.duplicate())
            problem.contact.start_viscous_regularization(drag)
        try:
            self._solve(margin, prescribed, report)
        except SolveError:
            problem.converged_state.copy(problem.state)
            if problem.contact is not None:
                problem.contact.restore_multipliers()
            raise
        self.last_motion = problem.motion()
        problem.snap_through_work = snap_through_work(problem)
        if problem.contact is not None:
            problem.contact.commit()
        committed(factors)

    def _solve(self, margin: float, prescribed: float, report: StepReport) -> None:
        """Bring the problem to equilibrium, again after each step of augmentation until gap and jump are small."""
        problem, tolerance = self.problem, self.augment_tolerance
        for number in range(AUGMENTATIONS + 1):
            solve = self.newton.solve(margin, prescribed)
            report.newton += solve.iterations
            report.krylov += solve.krylov
            report.solves.append(solve)
            report.augmentations += number > 0
            if tolerance is None:
                return
            left = augment(problem.contact, tolerance, problem.potential_range())
            if left is None:
                return
        gap, jump = left
        raise AugmentationError(
            f"{AUGMENTATIONS} augmentations leave a gap of {gap:.1e} facets and a jump of {jump:.1e} of the "
            "potential's range: raise contact.augment or the penalties, or take one pass"
        )

    def _cut(self, step: Step, tried: float, error: SolveError) -> None:
        """Try half of this share of a step next; SolveError when that has been done often enough."""
        self.size = 0.5 * tried
        if self.size < 0.5**self.max_cutbacks:
            parts = round(0.5 / self.size)
            reason = f"step {step.number} failed even in parts of 1/{parts}: {error}{self._remark()}"
            raise SolveError(reason) from error
        log.info("step %d: cut to 1/%d: %s", step.number, round(1.0 / self.size), error)

    def _remark(self) -> str:
        """What the last converged state says about why there is no next one."""
        if self.problem.contact is None:
            return ""
        self.revisit()
        depth = self.problem.contact.penetration_in_facets()
        if depth > DEEP:
            return f" (surfaces lie {depth:.1f} facets inside each other, where they buckle: raise the normal penalty)"
        model = self.problem.model
        fades = [
            float(p.law.fade.min(initial=np.inf)) for p in self.problem.contact.point_sets if p.law.fade is not None
        ]
        fade = model.comm.allreduce(min(fades, default=np.inf), op=MPI.MIN)
        # Potentials that the bodies' own strain causes have never pulled surfaces together.
        voltage = model.prescription.largest_voltage()
        permittivity = min((m.mean_permittivity for m in model.materials if m.electric), default=0.0)
        wanted = stable_electric_range(voltage, permittivity, min(m.mean_stiffness for m in model.materials))
        if fade >= PULLED_IN * wanted:
            return ""
        return (
            f" (over a gap of {fade:.2g} um, where the electric contact fades out, surfaces {voltage:.3g} V apart may "
            f"pull harder than bodies resist: raise contact.electric_range to {wanted:.2g})"
        )

    def _snap(
        self, before: Factors | None, factors: Factors, committed: Callable[[Factors], None], report: StepReport
    ) -> None:
        """Reach a load level where bonds snap, so that there is no equilibrium near the last one.

        They open against a drag that falls from part to part, until what is left is in equilibrium without it.
        """
        level, wait = 0, 0
        try:
            for _ in range(SNAP_PARTS):
                free = level == SNAP_LEVELS
                try:
                    self._part(before, factors, committed, report, 0.0 if free else DRAG * SNAP_FALL**level)
                except SolveError as error:
                    level, wait = level - 1, SNAP_WAIT
                    if level < -SNAP_LEVELS:
                        raise SolveError(f"bonds snap, and do not come to rest: {error}") from error
                    continue
                if free:
                    return
                before = factors
                level, wait = level + (wait == 0), max(wait - 1, 0)
        finally:
            self.problem.contact.end_viscous_regularization()
        raise SolveError(f"bonds snap, and do not come to rest in {SNAP_PARTS} parts")

    def revisit(self) -> None:
        """Evaluate residual and contact at the present state, as they are at the end of a step."""
        problem = self.problem
        problem.begin_step(problem.contact.least_search_radius() if problem.contact is not None else 0.0)
        problem.residual(problem.state, problem.state.duplicate())

    def margin(self, prescribed: float) -> float:
        """How far the contact search must look in the coming solve, um: what moves, and what is already there."""
        contact = self.problem.contact
        return 0.0 if contact is None else contact.least_search_radius() + 4.0 * max(prescribed, self.last_motion)
