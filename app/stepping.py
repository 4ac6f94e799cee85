"""Load steps: the load factors over a run, and how a step that fails is cut, repeated and grown again."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from app.problem import Problem
from app.scene_sections import Load
from app.solver import Newton, NewtonReport, SolveError

log = logging.getLogger("piezomat")


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
    """What a step took: Newton and Krylov iterations, how often it was cut, relative residuals of its solves."""

    newton: int
    krylov: int
    cutbacks: int
    solves: list[NewtonReport]


class Stepper:
    """Takes a problem through load steps. Every method is collective."""

    def __init__(self, problem: Problem, newton: Newton, max_cutbacks: int) -> None:
        self.problem = problem
        self.newton = newton
        self.max_cutbacks = max_cutbacks
        self.size = 1.0  # share of a step that is tried at once; kept from step to step
        self.last_motion = 0.0  # how far a node moved in the last solve, um

    def advance(self, step: Step, committed: Callable[[dict[str, float]], None]) -> StepReport:
        """Take the step, in parts if need be; `committed(factors)` is called after each part that converged.

        Raises SolveError with the reason, the state being that of the last part that converged.
        """
        problem, report = self.problem, StepReport(0, 0, 0, [])
        done = 0.0
        while done < 1.0:
            target = min(done + self.size, 1.0)
            factors = step.factors(target)
            problem.set_loads(factors)
            margin = self.margin()
            problem.begin_step(margin)
            try:
                solve = self.newton.solve(margin)
            except SolveError as error:
                problem.start.copy(problem.state)
                report.cutbacks += 1
                self.size *= 0.5
                if self.size < 0.5**self.max_cutbacks:
                    raise SolveError(
                        f"step {step.number} failed even in parts of 1/{round(0.5 / self.size)}: {error}"
                    ) from error
                log.info("step %d: cut to 1/%d: %s", step.number, round(1.0 / self.size), error)
                continue
            report.newton += solve.iterations
            report.krylov += solve.krylov
            report.solves.append(solve)
            done = target
            self.last_motion = problem.motion()
            if problem.contact is not None:
                problem.contact.commit()
            committed(factors)
            self.size = min(1.0, 2.0 * self.size)
        return report

    def revisit(self) -> None:
        """Evaluate residual and contact at the present state, as they are at the end of a step."""
        problem = self.problem
        problem.begin_step(problem.contact.least_margin() if problem.contact is not None else 0.0)
        problem.residual(problem.state, problem.state.duplicate())

    def margin(self) -> float:
        """How far the contact search must look in the coming solve, um: what moves, and what is already there."""
        problem = self.problem
        if problem.contact is None:
            return 0.0
        change = problem.fixed_change()
        prescribed = float(np.abs(problem.displacements(change)).max(initial=0.0))
        prescribed = problem.maximum(prescribed)
        return problem.contact.least_margin() + 4.0 * max(prescribed, self.last_motion)
