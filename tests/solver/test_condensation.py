"""Condensed tangents: the same changes as the factorized whole, candidates, reuse, and what a failure leaves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest
from mpi4py import MPI

from piezomat.forms.contact.laws.law import Sum
from piezomat.scene import Scene
from piezomat.simulation import run
from piezomat.solver import linear
from piezomat.solver.load_steps import steps
from piezomat.solver.outcome import SolveError
from tests.histories import assert_equal
from tests.marching import reports, stepper_of
from tests.scenes import pressed

# Less where it is condensed: see `piezomat.solver.active_set_prediction`.
EFFORT = ("newton", "linear_solves", "krylov")
WHOLE = {"petsc": {"mat_mumps_icntl_14": 60}}  # an option of the factorization means that of the whole tangent


@dataclass(frozen=True)
class FailsOnce(Sum):
    """A contact law that fails once, at the evaluation where `left`, shared by its parts, has counted down to zero."""

    left: list[int]

    def respond(self, *given: Any, **more: Any) -> Any:
        """Response, or SolveError."""
        self.left[0] -= 1
        if self.left[0] == 0:
            raise SolveError("on purpose")
        return super().respond(*given, **more)


@pytest.mark.mpi
@pytest.mark.parametrize("dimension", [2, 3])
def test_the_same_history_as_with_the_whole_tangent(dimension: int, comm: MPI.Comm) -> None:
    condensed = run(pressed(dimension), comm).history
    whole = run(pressed(dimension, solver={"tolerance": 1e-11, **WHOLE}), comm).history
    assert_equal(condensed, whole, EFFORT)


@pytest.mark.mpi
def test_candidates_grow_with_the_contact(comm: MPI.Comm) -> None:
    """A load gives no hint how far the contact will spread: the bulk is condensed again as it does."""
    boundaries = [
        {"on": "bottom", "displacement": [0, 0], "potential": 0},
        {"on": "top", "displacement": [0, "free"], "traction": [0, -240.0], "follows": "press"},
    ]
    load = {"steps": [4], "factors": {"press": [1.0]}}
    scene = pressed(2, mesh={"size": 0.15, "contact_size": 0.02}, boundaries=boundaries, load=load)
    counts = [solve.candidates for report in reports(scene, comm) for solve in report.solves]
    assert len(set(counts)) > 1 and counts == sorted(counts)


@pytest.mark.mpi
def test_the_interior_is_solved_for_at_the_ends_of_a_step_alone(comm: MPI.Comm) -> None:
    """Three solves with the factors: two for the start value, one when the iterations have ended."""
    found = reports(pressed(2, load={"steps": [4], "factors": {"press": [1.0]}}, solver={}), comm)
    assert not any(report.cutbacks for report in found)
    solves = [sum(solve.factor_solves for solve in report.solves) for report in found]
    assert solves[0] > 3 and solves[2:] == [3, 3]


@pytest.mark.mpi
def test_a_solve_that_fails_on_the_way_leaves_nothing_behind(comm: MPI.Comm) -> None:
    """The next one began with the interior of the one that had failed, in a reduced problem."""
    scene = pressed(2, load={"steps": [1], "factors": {"press": [1.0]}})
    expected, cuts, evaluations = final_energies(scene, comm, fails_at=0)
    assert cuts == 0 and evaluations > 12
    # Not one of the first, before the reduction, nor of the last, after which the step is done.
    for evaluation in range(evaluations // 2, evaluations - 2):
        found, cuts, _ = final_energies(scene, comm, evaluation)
        assert cuts == 1
        assert found == pytest.approx(expected, rel=1e-8, abs=1e-10), evaluation


def final_energies(scene: Scene, comm: MPI.Comm, fails_at: int) -> tuple[dict[str, float], int, int]:
    """Energies at the end of a run, number of cuts and of evaluations of the law, of which this one has failed."""
    whole: list[bool] = []
    with stepper_of(scene, comm, lambda *_: whole.append(not equations.is_reduced)) as stepper:
        problem, terms, equations = stepper.problem, stepper.terms, stepper.newton.newton.linear.equations
        assert equations.can_be_reduced
        left = [fails_at]  # of all pairs together
        for p in terms.contact.surface_pairs:
            p.law = FailsOnce((p.law,), left)
        found = [stepper.advance(step, lambda part: None) for step in steps(scene.load)]
        assert all(whole)  # every solve begins with the whole problem
        evaluations = fails_at - left[0]
        energies = terms.bulk.energies(problem.state) | terms.contact.energies()
        return energies, sum(r.cutbacks for r in found), evaluations


@pytest.mark.mpi
def test_too_many_candidates_fall_back_on_the_whole(comm: MPI.Comm, monkeypatch: pytest.MonkeyPatch) -> None:
    reference = run(pressed(2), comm).history
    monkeypatch.setattr(linear, "CONDENSED_LIMIT", 20)
    assert_equal(run(pressed(2), comm).history, reference, EFFORT)


FILMS: dict[str, dict[str, Any]] = {
    "between blocks": {
        "geometry": {
            "shape": "stacked_blocks",
            "height": [0.5, 0.02, 0.5],
            "divisions": [[4, 4], [4, 1], [4, 4]],
            "gap": 0.001,
        },
        "boundaries": [{"on": "bottom", "displacement": [0, 0]}, {"on": "top", "displacement": [0, -0.02]}],
    },
    "under a plane": {
        "geometry": {"shape": "stacked_blocks", "height": [0.5, 0.1], "divisions": [[4, 4], [4, 1]]},
        "boundaries": [{"on": "bottom", "displacement": [0, 0]}],
        "planes": [{"name": "lid", "point": "top", "motion": [0, -0.02], "follows": "press"}],
        "load": {"steps": [1], "factors": {"press": [1.0]}},
    },
    "nothing but films": {
        "geometry": {"shape": "stacked_blocks", "height": [0.1] * 3, "divisions": [[4, 1], [3, 1], [5, 1]]},
        "boundaries": [{"on": "bottom", "displacement": [0, 0]}, {"on": "top", "displacement": [0, -0.01]}],
    },
    "on a block that is held altogether": {
        "geometry": {"shape": "stacked_blocks", "height": [0.5, 0.5], "divisions": [[3, 1], [4, 1]]},
        "boundaries": [
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "lower_contact", "displacement": [0, 0]},
            {"on": "top", "displacement": [0, -0.01]},
        ],
    },
    "in three dimensions": {
        "geometry": {
            "shape": "stacked_blocks",
            "height": [0.3, 0.02, 0.3],
            "depth": 1.0,
            "divisions": [[2, 2, 2], [3, 3, 1], [2, 2, 2]],
        },
        "boundaries": [{"on": "bottom", "displacement": [0, 0, 0]}, {"on": "top", "displacement": [0, 0, -0.01]}],
    },
}
PRESSED = {"between blocks": -49.279, "under a plane": -89.714}  # force, uN/um, with a bulk that is not condensed


@pytest.mark.mpi
@pytest.mark.parametrize("film", FILMS)
@pytest.mark.parametrize("body", ["elastic", "pvdf"])
def test_bodies_all_of_whose_nodes_may_touch(film: str, body: str, comm: MPI.Comm) -> None:
    """Films one cell thick have no unknowns to eliminate, on ranks that hold nothing else, too."""
    keys = {
        **FILMS[film],
        "mesh": {"cells": "tensor"},
        "bodies": {"*": body},
        "contact": {},
        "solver": {"tolerance": 1e-11},
        "output": {"fields": "none", "picture": False},
    }
    if body == "pvdf":
        keys["boundaries"] = [keys["boundaries"][0] | {"potential": 0}, *keys["boundaries"][1:]]
    condensed = run(Scene(**keys), comm).history
    whole = run(Scene(**{**keys, "solver": {"tolerance": 1e-11, **WHOLE}}), comm).history
    assert_equal(condensed, whole, EFFORT)
    if body == "elastic" and film in PRESSED:
        force = [value for name, value in condensed[-1].items() if name in ("force_y@top", "force_y@lid")]
        assert force == pytest.approx([PRESSED[film]], abs=1e-3)
