"""Springs of loose bodies: stronger ones where weak ones do not hold them, as long as they take next to no energy."""

from __future__ import annotations

from typing import Any

import pytest
from mpi4py import MPI

from piezomat.assembly import stabilization_stiffness
from piezomat.scene import Scene
from piezomat.simulation import NotConverged, run
from piezomat.solver import newton as solver
from piezomat.solver import stabilization as springs
from piezomat.solver.outcome import NewtonReport, SolveError
from tests.scenes import press


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


@pytest.fixture
def weak(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The strengths with which springs were tried; they hold nothing unless they are stronger."""
    tried: list[float] = []
    solve = solver.Newton._solve

    def only_stronger(newton: solver.Newton, margin: float, report: NewtonReport) -> None:
        tried.append(newton.problem.stabilization.factor)
        if newton.problem.stabilization.factor == 1.0:
            raise SolveError("it flies to and fro")
        solve(newton, margin, report)

    monkeypatch.setattr(solver.Newton, "_solve", only_stronger)
    return tried


def test_what_weak_springs_do_not_hold_stronger_ones_do_from_then_on(weak: list[float]) -> None:
    history = run(block(), MPI.COMM_SELF).history
    assert weak == [1.0, *[springs.STRONGER] * 3]
    assert not any(row["cutbacks"] for row in history)


def test_many_loose_parts_have_stronger_springs_from_the_start(
    weak: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(springs, "MANY", 1)
    run(block(), MPI.COMM_SELF)
    assert weak == [springs.STRONGER] * 3


@pytest.mark.mpi
def test_stronger_springs_change_next_to_nothing(comm: MPI.Comm, monkeypatch: pytest.MonkeyPatch) -> None:
    weak = run(block(), comm).history
    stronger = springs.STRONGER * stabilization_stiffness.RELATIVE_STIFFNESS
    monkeypatch.setattr(stabilization_stiffness, "RELATIVE_STIFFNESS", stronger)
    for held, row in zip(run(block(), comm).history, weak, strict=True):
        assert held["force_y@lid"] == pytest.approx(row["force_y@lid"], rel=1e-5)
        assert 50 * row["stabilization"] < held["stabilization"] < springs.WORK * held["elastic"]


def test_springs_that_would_bear_a_part_of_the_load_are_no_solution(
    weak: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(springs, "STRONGER", 1e6)
    scene: dict[str, Any] = block().model_dump(exclude_unset=True) | {"solver": {"max_cutbacks": 1}}
    with pytest.raises(NotConverged, match=r"too much of the energy|to and fro"):
        run(Scene(**scene), MPI.COMM_SELF)
    assert set(weak) == {1.0, 1e6}
