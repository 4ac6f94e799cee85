"""The state of a problem: what a failed part and a restored state leave nothing of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.assembly.problem import Problem
from piezomat.assembly.terms import Terms
from piezomat.contact.interfaces import Interfaces
from piezomat.forms.arrays import Array
from piezomat.scene import Scene
from piezomat.solver.load_steps import steps
from piezomat.solver.outcome import SolveError
from tests.marching import stepper_of
from tests.scenes import pressed

pytestmark = pytest.mark.mpi


def bonded(**contact: Any) -> Scene:
    keys = {"adhesion": {"law": "bilinear", "strength": 20.0, "energy": 0.1}, **contact}
    return pressed(2, contact=keys, load={"steps": [2, 3], "factors": {"press": [1.0, -0.3]}})


def contents(problem: Problem, contact: Interfaces) -> dict[str, Array]:
    """All that the next step depends on, as arrays."""
    found = {"unknowns": problem.state.array_r.copy(), "prescribed": problem.prescribed_values.copy()}
    found["penetration"] = np.array(contact.last_penetration)
    for i, p in enumerate(contact.point_sets):
        found[f"history {i}"] = p.history.copy()
        found |= {f"gap {i}": p.multipliers.gap.copy(), f"jump {i}": p.multipliers.jump.copy()}
        found[f"xi {i}"] = p.points.xi.copy()
    return found


def assert_same(found: dict[str, Array], wanted: dict[str, Array]) -> None:
    for name, value in wanted.items():
        np.testing.assert_array_equal(found[name], value, err_msg=name)


@pytest.mark.parametrize("contact", [{}, {"augment": 1e-3}, {"method": "segment"}], ids=["", "augment", "segment"])
def test_a_state_is_returned_to(contact: dict[str, Any], comm: MPI.Comm) -> None:
    todo = list(steps(bonded().load))
    with stepper_of(bonded(**contact), comm) as stepper:
        for step in todo[:2]:
            stepper.advance(step, lambda part: None)
        problem, interfaces = stepper.problem, stepper.terms.contact
        state, before = problem.copy_state(), contents(problem, interfaces)
        assert dict(state.factors) == todo[1].after
        for step in todo[2:]:
            stepper.advance(step, lambda part: None)
        after = contents(problem, interfaces)
        assert comm.allreduce(float(np.abs(after["unknowns"] - before["unknowns"]).max()), op=MPI.MAX) > 1e-3
        problem.restore(state)
        assert_same(contents(problem, interfaces), before)
        stepper.size, stepper.last_motion = 1.0, 0.0
        for step in todo[2:]:
            stepper.advance(step, lambda part: None)
        again = contents(problem, interfaces)
        np.testing.assert_allclose(again["unknowns"], after["unknowns"], rtol=0.0, atol=1e-9)


def test_a_failed_part_leaves_nothing(comm: MPI.Comm) -> None:
    todo = list(steps(bonded().load))
    seen, fails = [], []

    def after(problem: Problem, terms: Terms) -> None:
        seen.append(contents(problem, terms.contact))
        if fails and len(seen) > 3:  # some steps of augmentation later
            raise SolveError("on purpose")

    with stepper_of(bonded(augment=1e-3), comm, after=after) as stepper:
        stepper.advance(todo[0], lambda part: None)
        problem, contact = stepper.problem, stepper.terms.contact
        before = contents(problem, contact)
        seen.clear()
        fails.append(True)
        with pytest.raises(SolveError, match="on purpose"):
            stepper.advance(todo[1], lambda part: None)
        for name in ("prescribed", "unknowns", "gap 0"):
            assert comm.allreduce(bool((seen[3][name] != before[name]).any()), op=MPI.LOR), name
        assert_same(contents(problem, contact), before)


def test_a_solver_goes_on_with_the_springs_that_it_had(comm: MPI.Comm) -> None:
    with stepper_of(pressed(2), comm) as first, stepper_of(pressed(2), comm) as second:
        assert first.terms.stabilization.is_active  # of the potential of the upper one
        first.stabilization.set_factor(100.0)
        second.resume(**first.saved())
        assert second.terms.stabilization.factor == 100.0
        second.resume(1.0, 0.0, None)
        assert second.terms.stabilization.factor == 100.0
