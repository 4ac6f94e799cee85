"""scripts/mats: the scenes of its studies, and what it makes of their results."""

from __future__ import annotations

import csv
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from piezomat.scene import Scene
from scripts.studies.mats import CHEAP, METER, PRESSED, QUIET, STUDIES, Run, at, electric, exponent, study, value


def scene_of(run: Run) -> Scene:
    """The scene of a run, as the command line would make it."""
    return Scene.load(run.scene, [f"{key}={value(thing)}" for key, thing in run.keys.items()])


@pytest.mark.parametrize("name", STUDIES)
def test_runs_are_scenes(name: str) -> None:
    runs = list(islice(STUDIES[name]([10, -20]), 2))
    assert runs[0].label != runs[1].label
    for run in runs:
        scene = scene_of(run)
        outcome = scene.geometry.outcome()
        if name != "cooperativity":
            thickness = outcome.high[2] - outcome.low[2]
            assert scene.planes[1].motion[2] == pytest.approx(-PRESSED * thickness)
        else:
            rows = scene.geometry.rows
            assert scene.planes[1].motion[1] == pytest.approx(-0.1 * rows)


def test_a_run_that_the_table_holds_is_not_repeated(tmp_path: Path) -> None:
    """And one that does not converge is a row that says why."""
    keys = {"geometry.count": 2, "mesh.size": 1.0, "mesh.contact_size": 0.5, "solver.max_iterations": 1}
    run = Run({"seed": 7}, "random_mat", keys | CHEAP | QUIET | {"solver.max_cutbacks": 0})
    for _ in range(2):
        study("seeds", [run], tmp_path)
    with (tmp_path / "seeds.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["seed"] == "7" and row["outcome"] == "failed" and "more than 1 iterations" in row["reason"]


def test_growth_and_values_at_the_same_force() -> None:
    x = np.array([10.0, 30.0, 100.0])
    assert exponent(x, 3.0 * x**1.2) == pytest.approx(1.2)
    assert float(at(60.0, [40.0, 80.0], [10.0, 30.0], 0.0)) == pytest.approx(20.0)
    assert float(at(20.0, [40.0, 80.0], [10.0, 30.0], 6.0)) == pytest.approx(8.0)
    assert at(60.0, [20.0, 40.0], [1.0, 10.0], 0.0) == ""


def test_charges_of_fibers_side_by_side_add_up_in_a_meter() -> None:
    row = {"voltage_each": "20", "capacitance_each": "1e-4"}
    charge, capacitance, voltage, metered = electric(row, "each")
    assert (charge, capacitance, voltage) == pytest.approx((2e-3, 1e-4, 20.0))
    assert metered == pytest.approx(2e-3 / (1e-4 + METER))
