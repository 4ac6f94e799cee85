"""Exceptions in what PETSc calls back: PETSc returns, the exception is raised, and the same step can be solved then."""

from __future__ import annotations

from typing import Any

import pytest
from mpi4py import MPI

from piezomat.assembly.problem import Problem
from piezomat.solver.condensation import Condensation
from piezomat.solver.line_search import LineSearch
from piezomat.solver.load_steps import Stepper, steps
from piezomat.solver.outcome import SolveError
from piezomat.solver.step_watch import StepAbandoned, StepWatch
from tests.marching import stepper_of
from tests.scenes import pressed

# Method that fails, at which of its calls, counted from 1; whether it is one of PETSc's Newton method, or of its KSP.
CALLS: dict[str, tuple[type, str, int, bool]] = {
    "residual": (LineSearch, "residual", 2, True),
    "tangent": (Condensation, "start", 2, True),
    "convergence": (StepWatch, "count", 2, True),
    "step": (LineSearch, "search", 1, True),
    "condensed solve": (Condensation, "solve", 1, False),
    "product": (Problem, "multiply", 2, False),
}


class FailsAt:
    """A method that raises an error of this kind at one of its calls."""

    def __init__(self, method: Any, call: int, error: type[Exception]) -> None:
        self.method = method
        self.left = call
        self.error = error

    def __get__(self, owner: Any, kind: type) -> Any:
        def method(*arguments: Any, **keywords: Any) -> Any:
            self.left -= 1
            if self.left == 0:
                raise self.error("on purpose")
            return self.method(owner, *arguments, **keywords)

        return method


def energies(stepper: Stepper) -> dict[str, float]:
    """Energies after the first step. Collective."""
    problem, terms = stepper.problem, stepper.terms
    stepper.advance(next(steps(SCENE.load)), lambda part: None)
    return terms.bulk.energies(problem.state) | terms.contact.energies()


SCENE = pressed(2, load={"steps": [1], "factors": {"press": [1.0]}}, solver={"max_cutbacks": 0, "tolerance": 1e-11})
ITERATIVE = pressed(3, load=SCENE.load, solver={"max_cutbacks": 0, "kind": "iterative"})


@pytest.mark.mpi
@pytest.mark.parametrize(("where", "error"), list(zip(CALLS, 3 * [SolveError, StepAbandoned], strict=True)))
def test_petsc_returns_before_the_error_is_raised(
    where: str, error: type[Exception], comm: MPI.Comm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Passing through PETSc 3.22 it left the state locked: no part of the step could be solved after it."""
    owner, name, call, of_snes = CALLS[where]
    scene = ITERATIVE if where == "product" else SCENE
    with stepper_of(scene, comm) as stepper:
        expected = energies(stepper)
    with stepper_of(scene, comm) as stepper:
        with monkeypatch.context() as patch, pytest.raises(error, match="on purpose"):
            patch.setattr(owner, name, FailsAt(getattr(owner, name), call, error))
            energies(stepper)
        snes = stepper.newton.newton.snes
        assert (snes if of_snes else snes.getKSP()).getConvergedReason() != 0  # 0: PETSc has not come to its end
        stepper.size = 1.0
        # A Krylov solver keeps the preconditioner of the solve that failed, and comes to its end on another path.
        share = 1e-7 if where == "product" else 1e-10
        assert energies(stepper) == pytest.approx(expected, rel=1e-8, abs=share * max(expected.values()))


@pytest.mark.parametrize("where", CALLS)
def test_any_other_error_is_raised_itself(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """PETSc 3.22 puts an error of its own in its place, of which no command has words for the user."""
    owner, name, call, _ = CALLS[where]
    monkeypatch.setattr(owner, name, FailsAt(getattr(owner, name), call, MemoryError))
    scene = ITERATIVE if where == "product" else SCENE
    with stepper_of(scene, MPI.COMM_SELF) as stepper, pytest.raises(MemoryError, match="on purpose"):
        energies(stepper)
