"""Load steps: how a step is cut, when bonds are taken to snap, and what a failure says."""

from __future__ import annotations

from typing import Any

import pytest
from mpi4py import MPI

from piezomat.assembly.problem import Problem
from piezomat.assembly.terms import Terms
from piezomat.scene import Scene
from piezomat.simulation import NotConverged, run
from piezomat.solver.load_steps import Step
from piezomat.solver.outcome import SolveError
from tests.marching import stepper_of
from tests.scenes import blocks, facing_halves, strongly_coupled

DOWN = 0.01  # um
ONE_STEP = Step(1, 1, {"press": 0.0}, {"press": 1.0})


def test_surfaces_too_far_inside_each_other_are_named_as_the_reason() -> None:
    """Fine facets that a soft penalty leaves far inside each other buckle: no search and no tangent helps."""
    scene = facing_halves(1e4, steps=1)
    mesh = scene.mesh.model_copy(update={"size": 0.076, "contact_size": 0.016})
    boundaries = [*scene.boundaries[:1], scene.boundaries[1].model_copy(update={"displacement": [0, -0.2]})]
    scene = scene.model_copy(update={"mesh": mesh, "boundaries": boundaries})
    with pytest.raises(NotConverged, match=r"[0-9.]+ facets inside each other.*raise the normal penalty"):
        run(scene.model_copy(update={"solver": scene.solver.model_copy(update={"max_cutbacks": 3})}), MPI.COMM_SELF)


def test_a_gap_too_short_for_the_voltage_is_named_as_the_reason() -> None:
    scene = strongly_coupled(50.0, electric_range=0.002)
    with pytest.raises(
        NotConverged, match=r"surfaces 50 V apart may pull harder.*raise contact.electric_range to 0.05"
    ):
        run(scene.model_copy(update={"solver": scene.solver.model_copy(update={"max_cutbacks": 1})}), MPI.COMM_SELF)


def test_a_part_that_has_failed_is_not_tried_again_as_it_is() -> None:
    """Half of a share larger than what is left of the step may still be all that is left."""
    tried, failed = [], []

    def before(problem: Problem, terms: Terms) -> None:
        done, target = (-v.min() / DOWN for v in (problem.converged_state.array_r, problem.prescribed_values))
        tried.append((done, target))
        if target - done > (0.6 if done < 1e-6 else 0.3):
            failed.append(target)
            raise SolveError("too far")

    with stepper_of(pressed_blocks(), MPI.COMM_SELF, before) as stepper:
        report = stepper.advance(ONE_STEP, lambda part: None)
    assert tried[-1][1] == pytest.approx(1.0) and report.cutbacks == len(failed) > 1
    assert len(set(tried)) == len(tried)


def test_the_rest_of_a_step_snaps_as_a_part_of_its_size_would() -> None:
    """Parts grow from step to step and need not divide one: what is left at its end is small enough to snap."""
    snapped = []

    def before(problem: Problem, terms: Terms) -> None:
        target = -problem.prescribed_values.min() / DOWN
        if terms.contact.viscous_regularization:
            snapped.append(target)
        elif target == pytest.approx(1.0):
            raise SolveError("bonds snap")

    adhesion = {"law": "bilinear", "strength": 1.0, "energy": 0.01}
    with stepper_of(pressed_blocks(contact={"adhesion": adhesion}), MPI.COMM_SELF, before) as stepper:
        stepper.size = 0.23828125
        report = stepper.advance(ONE_STEP, lambda part: None)
    assert snapped == pytest.approx([1.0] * len(snapped)) and len(snapped) > 1 and report.cutbacks == 3


def pressed_blocks(**changes: Any) -> Scene:
    """Two blocks, the upper one pressed down by `DOWN`."""
    boundaries = [
        {"on": "bottom", "displacement": [0, 0]},
        {"on": "top", "displacement": [0, -DOWN], "follows": "press"},
    ]
    load = {"factors": {"press": [1.0]}}
    return blocks(boundaries=boundaries, load=load, solver={"max_cutbacks": 4}, **changes)
