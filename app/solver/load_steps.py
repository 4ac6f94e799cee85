"""Load steps: the load factors over a run, and how a step that fails is cut, repeated and grown again.

A step is taken in parts, one at first. Each part is solved to equilibrium; where that fails, half of it is tried, and
after each success twice as much. Where bonds snap, small parts do not help: see `snap_through`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from mpi4py import MPI

from piezomat.assembly.problem import Problem
from piezomat.assembly.terms import Terms
from piezomat.contact.uzawa import augment
from piezomat.discretization.prescription import Factors
from piezomat.forms.arrays import Array
from piezomat.forms.contact.laws.equal_potential import EqualPotential, stable_electric_range
from piezomat.scene.sections import Load
from piezomat.solver.first_contact import approach
from piezomat.solver.newton import Newton
from piezomat.solver.outcome import WANDERING, NewtonReport, SolveError
from piezomat.solver.snap_through import snap_through, snap_through_work
from piezomat.solver.stabilization_continuation import StabilizationContinuation
from piezomat.solver.step_watch import StepAbandoned

log = logging.getLogger("piezomat")

SNAP_CUTBACKS = 3  # times that a step is halved before bonds are taken to snap
AUGMENTATIONS = 40  # of one solve
# Facets. A wave of length l in the surface that points press on shortens their way out by half of g (2 pi / l)^2 times
# its height squared: deep inside, at a gap -g, that frees more energy of the penalty than the wave costs the body.
DEEP = 0.5
PULLED_IN = 0.7  # of the gap that `stable_electric_range` asks for: less is named as what may have failed a step


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
    """Effort of a load step: iterations, linear solves, cuts, augmentations, and the report of each solve.

    newton, linear_solves, krylov: see `NewtonReport`, whose `iterations` newton sums.
    snap_through_work (2,): see `snap_through_work`, of the last part that converged; None where nothing has snapped.
    is_erratic: whether a solve wandered far from equilibrium until rounding may have picked where it ended.
    """

    newton: int = 0
    linear_solves: int = 0
    krylov: int = 0
    cutbacks: int = 0
    augmentations: int = 0
    solves: list[NewtonReport] = field(default_factory=list)
    snap_through_work: Array | None = None
    is_erratic: bool = False


class AugmentationError(SolveError):
    """Augmentation does not reach its tolerance, which smaller steps would not change."""


class Stepper:
    """Takes a problem through load steps. Every method is collective.

    size: share of a step that is tried at once, kept from step to step; last_motion (um): largest component of a
    node's motion in the last part.
    """

    def __init__(
        self,
        problem: Problem,
        terms: Terms,
        newton: Newton,
        max_cutbacks: int,
        augment_tolerance: float | None = None,
    ) -> None:
        """terms: those of the problem. augment_tolerance: see `contact.augment` of a scene; None: no augmentation."""
        self.problem = problem
        self.terms = terms
        self.newton = newton
        self.watch = newton.watch
        self.stabilization = (
            StabilizationContinuation(problem, terms, newton.solve) if terms.stabilization.is_active else None
        )
        self.max_cutbacks = max_cutbacks
        self.augment_tolerance = augment_tolerance
        self.size = 1.0
        self.last_motion = 0.0

    def saved(self) -> dict[str, float]:
        """What the next step depends on beside the problem's state, for a checkpoint."""
        return {
            "size": self.size,
            "motion": self.last_motion,
            "stabilization_factor": self.terms.stabilization.factor,
        }

    def resume(self, size: float, motion: float, stabilization_factor: float | None) -> None:
        """Take up what `saved` has given; None: a factor that is not known."""
        self.size, self.last_motion = size, motion
        if self.stabilization is not None and stabilization_factor is not None:
            self.stabilization.set_factor(stabilization_factor)

    def advance(self, step: Step, committed: Callable[[StepReport], None]) -> StepReport:
        """Take the step, in parts if need be; `committed(report so far)` is called after each part that converged.

        Raises SolveError or StepAbandoned with the reason, the state being that of the last part that converged.
        """
        report = StepReport()
        self.watch.start(step.number)
        done = 0.0
        while done < 1.0:
            target = min(done + self.size, 1.0)
            before = step.factors(done) if step.number > 1 or done else None
            self.watch.start_try(target - done)
            try:
                self._part(before, step.factors(target), committed, report)
            except AugmentationError:
                raise
            except SolveError as error:
                report.cutbacks += 1
                self.watch.failed(str(error))
                contact, tried = self.terms.contact, target - done  # the last part of a step may be a small rest
                if contact is None or not contact.adhesive or tried > 0.5**SNAP_CUTBACKS:
                    self._cut(step, tried, error)
                    continue
                log.info("step %d: bonds snap: %s", step.number, error)
                self._snap_through(before, step.factors(target), tried, committed, report)
            done = target
            self.size = min(1.0, 2.0 * self.size)
        return report

    def _part(
        self,
        before: Factors | None,
        after: Factors,
        committed: Callable[[StepReport], None],
        report: StepReport,
        viscosity: float | None = None,
    ) -> None:
        """Go from the last converged state to a load level; SolveError, the state being as it was, if that fails.

        before: load level of the last converged state, None for the undeformed bodies. viscosity: of the bonds.
        """
        problem = self.problem
        start = problem.copy_state()
        problem.set_loads(after)
        prescribed = problem.model.prescription.motion(after, before)
        search_radius = self.search_radius(prescribed)
        problem.begin_step(search_radius)
        if approach(problem, self.terms.contact):
            problem.begin_step(search_radius)
        if viscosity is not None:
            problem.residual(problem.state, problem.state.duplicate())
            self.terms.contact.start_viscous_regularization(viscosity)
        try:
            self._solve(search_radius, prescribed, report)
        except (SolveError, StepAbandoned):
            problem.restore(start)
            raise
        self.last_motion = problem.motion()
        report.snap_through_work = snap_through_work(problem, self.terms)
        problem.commit()
        committed(report)

    def _snap_through(
        self,
        before: Factors | None,
        after: Factors,
        share: float,
        committed: Callable[[StepReport], None],
        report: StepReport,
    ) -> None:
        """Reach a load level where bonds snap, this share of the step away, in parts at this level."""

        def part(viscosity: float) -> None:
            nonlocal before
            self.watch.start_try(share)
            self._part(before, after, committed, report, viscosity)
            before = after

        snap_through(self.terms.contact, part)

    def _solve(self, search_radius: float, prescribed: float, report: StepReport) -> None:
        """Bring the problem to equilibrium, again after each step of augmentation until gap and jump are small."""
        problem, tolerance = self.problem, self.augment_tolerance
        for number in range(AUGMENTATIONS + 1):
            solve = NewtonReport()
            if self.stabilization is not None:
                self.stabilization.solve(search_radius, prescribed, solve)
            else:
                self.newton.solve(search_radius, solve)
            report.newton += solve.iterations
            report.linear_solves += solve.linear_solves
            report.krylov += solve.krylov
            report.solves.append(solve)
            report.is_erratic |= solve.wandering >= WANDERING
            report.augmentations += number > 0
            if tolerance is None:
                return
            left = augment(self.terms.contact, tolerance, problem.potential_range())
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
        if self.terms.contact is None:
            return ""
        self.revisit()
        depth = self.terms.contact.penetration_in_facets()
        if depth > DEEP:
            return f" (surfaces lie {depth:.1f} facets inside each other, where they buckle: raise the normal penalty)"
        model = self.problem.model
        laws = [law for p in self.terms.contact.point_sets for law in p.law.summands()]
        fades = [float(law.fade.min(initial=np.inf)) for law in laws if isinstance(law, EqualPotential)]
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

    def revisit(self) -> None:
        """Evaluate residual and contact at the present state, as they are at the end of a step."""
        problem, contact = self.problem, self.terms.contact
        radius = contact.least_search_radius() if contact is not None else 0.0
        problem.begin_step(radius)
        problem.residual(problem.state, problem.state.duplicate())

    def search_radius(self, prescribed: float) -> float:
        """How far the contact search must look in the coming solve, um: what moves, and what is already there."""
        contact = self.terms.contact
        return 0.0 if contact is None else contact.least_search_radius() + 4.0 * max(prescribed, self.last_motion)
