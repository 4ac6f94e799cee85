"""Load steps of a scene with the solver at hand: for tests of reports, and of solves that fail on purpose."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from mpi4py import MPI

from piezomat.assembly.problem import Problem
from piezomat.assembly.terms import Terms
from piezomat.contact.setup import interfaces_of
from piezomat.discretization.model import Model
from piezomat.meshes.body_mesh import create
from piezomat.scene import Scene
from piezomat.solver.load_steps import Stepper, StepReport, steps
from piezomat.solver.newton import Newton
from piezomat.solver.outcome import NewtonReport
from piezomat.usage import Timer

Hook = Callable[[Problem, Terms], None]


def nothing(problem: Problem, terms: Terms) -> None:
    """Do nothing."""


class Watched:
    """Newton's method of a problem, and what a test does before and after each solve: count, or raise SolveError."""

    def __init__(self, newton: Newton, terms: Terms, before: Hook, after: Hook) -> None:
        self.newton = newton
        self.terms = terms
        self.watch = newton.watch
        self.before = before
        self.after = after

    def solve(self, search_radius: float, report: NewtonReport, *, settled: bool = False) -> None:
        """See `Newton.solve`."""
        self.before(self.newton.problem, self.terms)
        self.newton.solve(search_radius, report, settled=settled)
        self.after(self.newton.problem, self.terms)


@contextmanager
def stepper_of(scene: Scene, comm: MPI.Comm, before: Hook = nothing, after: Hook = nothing) -> Iterator[Stepper]:
    """A stepper for the scene; `before` and `after` are called around each of its solves. Collective."""
    model = Model(scene, create(comm, scene.geometry, scene.sizes))
    terms = Terms.of(model, interfaces_of(model))
    problem = Problem(model, terms, Timer())
    newton = Newton(problem, terms, scene.solver)
    try:
        tolerance = scene.contact.augment if scene.contact is not None else None
        yield Stepper(problem, terms, Watched(newton, terms, before, after), scene.solver.max_cutbacks, tolerance)
    finally:
        newton.close()
        problem.close()


def reports(scene: Scene, comm: MPI.Comm) -> list[StepReport]:
    """The report of each load step. Collective; raises SolveError."""
    with stepper_of(scene, comm) as stepper:
        return [stepper.advance(step, lambda part: None) for step in steps(scene.load)]
