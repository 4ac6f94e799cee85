"""Stabilization of unconstrained bodies: stiffer springs where weak ones fail, as long as they take little energy."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.assembly import stabilization_stiffness
from piezomat.assembly.problem import Problem
from piezomat.assembly.terms import Terms
from piezomat.scene import Scene
from piezomat.simulation import NotConverged, run
from piezomat.solver import stabilization_continuation as continuation
from piezomat.solver.load_steps import steps
from piezomat.solver.outcome import SolveError
from tests.marching import stepper_of
from tests.scenes import blocks, press


def block() -> Scene:
    """A block that can only be held by the planes below and above it, in three steps."""
    return Scene(
        title="a loose block",
        geometry={"shape": "cantilever", "length": 1.5, "layers": [0.8], "divisions": [3, 2]},
        mesh={"cells": "tensor"},
        materials={"soft": {"young": 1000.0, "poisson": 0.3}},
        bodies={"layer_1": "soft"},
        boundaries=[{"on": "root", "displacement": [0, "free"]}],
        planes=[
            {"name": "floor", "point": "bottom"},
            {"name": "lid", "point": "top", "motion": [0, -0.01], "follows": "press"},
        ],
        load={"steps": [3], "factors": {"press": [1.0]}},
        output={"fields": "none", "picture": False},
    )


def carried(motion: float) -> Scene:
    """A disc 1 um thick that two planes hold by 0.01 um and carry along by `motion` (um), in one step."""
    return press(
        {"shape": "fiber_array", "columns": 1, "rows": 1, "radius": 0.5},
        mesh={"size": 0.15},
        materials={"soft": {"young": 1000.0, "poisson": 0.3}},
        bodies={"*": "soft"},
        planes=[
            {"name": "floor", "point": "bottom", "motion": [0, motion], "follows": "lift"},
            {"name": "lid", "point": "top", "motion": [0, motion - 0.01], "follows": "lift"},
        ],
        load={"factors": {"lift": [1.0]}},
    )


@pytest.mark.mpi
@pytest.mark.parametrize("motion", [0.6, 1.0])
def test_a_disc_carried_by_planes_has_not_flown(motion: float, comm: MPI.Comm) -> None:
    """The motion of planes was left out: carried by more than half its thickness, it counted as flown."""
    (row,) = run(carried(motion), comm).history
    (nearby,) = run(carried(0.1), comm).history
    assert row["cutbacks"] == 0 and row["newton"] <= 6
    # Weak springs resist the way.
    assert row["force_y@lid"] == pytest.approx(nearby["force_y@lid"], rel=1e-4)


class FailsWhileWeak:
    """Fails solves with weak springs, and notes the stabilization factor of all."""

    def __init__(self) -> None:
        self.factors: list[float] = []

    def __call__(self, problem: Problem, terms: Terms) -> None:
        self.factors.append(terms.stabilization.factor)
        if terms.stabilization.factor == 1.0:
            raise SolveError("it flies to and fro")


def test_springs_are_stiffer_once_weak_ones_have_failed() -> None:
    weak = FailsWhileWeak()
    with stepper_of(block(), MPI.COMM_SELF, weak) as stepper:
        found = [stepper.advance(step, lambda part: None) for step in steps(block().load)]
    assert weak.factors == [1.0, *[continuation.STIFFER] * 3]
    assert not any(report.cutbacks for report in found)


@pytest.mark.mpi
def test_stiffer_springs_change_next_to_nothing(comm: MPI.Comm, monkeypatch: pytest.MonkeyPatch) -> None:
    weak = run(block(), comm).history
    stronger = continuation.STIFFER * stabilization_stiffness.RELATIVE_STIFFNESS
    monkeypatch.setattr(stabilization_stiffness, "RELATIVE_STIFFNESS", stronger)
    for held, row in zip(run(block(), comm).history, weak, strict=True):
        assert held["force_y@lid"] == pytest.approx(row["force_y@lid"], rel=1e-5)
        assert 50 * row["stabilization"] < held["stabilization"] < continuation.LARGEST_ENERGY_SHARE * held["elastic"]


def test_springs_that_take_energy_are_no_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(continuation, "STIFFER", 1e6)
    scene, weak = Scene(**block().model_dump(exclude_unset=True) | {"solver": {"max_cutbacks": 1}}), FailsWhileWeak()
    with (
        stepper_of(scene, MPI.COMM_SELF, weak) as stepper,
        pytest.raises(SolveError, match=r"too much of the energy|to and fro"),
    ):
        stepper.advance(next(steps(scene.load)), lambda part: None)
    assert set(weak.factors) == {1.0, 1e6}


@pytest.mark.parametrize("gap", [0.0, 0.01])
def test_a_traction_presses_a_body_that_only_contact_holds(gap: float) -> None:
    """The weak springs of the floating block let it fly through the other one."""
    geometry = {"shape": "stacked_blocks", "height": [0.5, 0.5], "divisions": [[3, 3], [4, 4]], "gap": gap}
    last = run(blocks(geometry=geometry), MPI.COMM_SELF).history[-1]
    assert last["contact_force_y@lower-upper"] == pytest.approx(-1.0, rel=1e-5)
    assert last["force_y@bottom"] == pytest.approx(1.0, rel=1e-5)
    assert last["newton"] <= 4  # with the inside held where nothing is in balance yet it took 40


@pytest.mark.parametrize("gap", [0.01, 0.05])
def test_no_block_of_a_pile_leaps_through_the_next(gap: float) -> None:
    """Springs ten times weaker threw four blocks through the lowest: contact was lost, and then they flew."""
    names = [f"block_{i}" for i in range(1, 6)]
    scene = blocks(
        geometry={
            "shape": "stacked_blocks",
            "height": [0.3] * 5,
            "divisions": [[3, 2], [4, 2], [5, 2], [3, 2], [4, 2]],
            "gap": gap,
        },
        mesh={"cells": "tensor", "order": 2},
        bodies=dict.fromkeys(names, "soft"),
    )
    last = run(scene, MPI.COMM_SELF).history[-1]
    for lower, upper in itertools.pairwise(names):
        assert last[f"contact_force_y@{lower}-{upper}"] == pytest.approx(-1.0, rel=1e-3)


def test_a_load_that_nothing_holds_is_said() -> None:
    boundaries = [
        {"on": "bottom", "displacement": [0, 0]},
        {"on": "top", "displacement": [0, "free"], "traction": [0, 1.0]},
    ]
    with pytest.raises(NotConverged, match=r"nothing holds|flies away"):
        run(blocks(boundaries=boundaries, solver={"max_cutbacks": 1}), MPI.COMM_SELF)


def test_the_spring_of_a_soft_floating_body_is_soft() -> None:
    """Springs scaled by the stiffest body held a soft one between two stiff ones: forces did not balance."""
    scene = blocks(
        geometry={"shape": "stacked_blocks", "height": [0.5, 0.5, 0.5], "divisions": [[2, 2], [3, 2], [2, 2]]},
        materials={"steel": {"young": 2e5, "poisson": 0.0}, "soft": {"young": 1.0, "poisson": 0.0}},
        bodies={"block_1": "steel", "block_2": "soft", "block_3": "steel"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": [0, -0.01]},
        ],
    )
    last = run(scene, MPI.COMM_SELF).history[-1]
    lower, upper = last["contact_force_y@block_1-block_2"], last["contact_force_y@block_2-block_3"]
    assert lower == pytest.approx(upper, rel=1e-5) and lower == pytest.approx(-0.02, rel=0.2)


def test_no_body_stays_where_a_wild_step_threw_it() -> None:
    """A block that Newton's method threw sideways stayed there: weak springs let it, and the forces balanced."""
    times = iter([0.45])

    def throw(problem: Problem, terms: Terms) -> None:
        unknowns = problem.model.unknowns
        upper = unknowns.coordinates[: unknowns.owned, 1] > 0.0
        problem.state.array.reshape(-1, 2)[upper, 0] += next(times, 0.0)

    geometry = {"shape": "stacked_blocks", "height": [0.5, 0.3], "divisions": [[3, 3], [4, 2]]}
    scene = blocks(geometry=geometry, solver={"max_cutbacks": 0})
    with stepper_of(scene, MPI.COMM_SELF, after=throw) as stepper:
        problem, terms = stepper.problem, stepper.terms
        stepper.advance(next(steps(scene.load)), lambda part: None)
        moved = problem.model.unknowns.displacements(problem.state)
        assert next(times, None) is None and np.abs(moved).max() < 0.01
        assert terms.stabilization.load_share(problem.state, terms.loads.vector) < continuation.LARGEST_LOAD_SHARE
