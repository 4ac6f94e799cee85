"""Convergence studies: exact sequences are extrapolated, irregular ones are not; the study of a scene; the command."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat import cli, simulation
from piezomat.converge.estimate import best, limit
from piezomat.converge.page import as_text, chart
from piezomat.converge.study import Level, Study, _load_until, _path, study
from piezomat.scene import Scene, SceneError
from piezomat.solver.load_steps import steps


@pytest.mark.parametrize("power", [1.0, 2.0, 3.3])
def test_a_power_of_the_size_is_extrapolated_exactly(power: float) -> None:
    sizes = np.array([0.4, 0.31, 0.17, 0.1])
    found = limit(sizes, 5.0 - 2.0 * sizes**power)
    assert found.value == pytest.approx(5.0, rel=1e-9) and found.power == pytest.approx(power, rel=1e-6)
    assert 2.0 * 0.1**power <= found.uncertainty < 4.0 * 0.1**power


@pytest.mark.parametrize("values", [[5.0, 5.2, 5.1], [5.0, 5.1, 5.3], [5.0, 5.0, 5.0], [4.85, 5.89, 5.35]])
def test_an_irregular_sequence_is_not_extrapolated(values: list[float]) -> None:
    found = limit([0.4, 0.2, 0.1], values)
    assert found.power is None and found.value == values[-1]
    assert found.uncertainty == pytest.approx(max(values) - min(values))


def test_the_last_change_bounds_what_falls_faster_than_any_power() -> None:
    found = limit([0.4, 0.2, 0.1], [5.052, 5.444, 5.448])
    assert (found.value, found.power) == (5.448, None) and found.uncertainty == pytest.approx(1.25 * 0.004)


def test_few_values_and_series_that_disagree() -> None:
    assert limit([0.1], [3.0]).uncertainty == float("inf")
    sure, other = limit([0.4, 0.2, 0.1], [5.16, 5.04, 5.01]), limit([0.4, 0.2, 0.1], [6.3, 6.2, 6.1])
    assert best([other, sure]).value == sure.value
    assert best([other, sure]).uncertainty == pytest.approx(6.1 - 5.0 - other.uncertainty, rel=1e-6)
    near = limit([0.4, 0.2, 0.1], [5.1, 5.05, 5.02])
    assert best([near, sure]).uncertainty == sure.uncertainty


def made_up(errors: dict[int, list[float]], within: float) -> Study:
    """A study whose values are 10 (1 + error) on meshes that halve their cells' size; time 8 times a mesh."""
    scene = Scene.load("fibers_2d")
    found = Study(scene, within, 3, 3, ["elastic"], [])
    for order, series in errors.items():
        for i, error in enumerate(series):
            keys = {"mesh.size": 0.4 / 2**i, "mesh.contact_size": 0.1 / 2**i, "mesh.order": order}
            found.levels.append(
                Level(order, keys, 4**i, 10 * 4**i, order * 8.0**i, 1.0, {"elastic": 10.0 * (1.0 + error)})
            )
    return found


def test_the_cheapest_within_the_tolerance() -> None:
    regular = {1: [0.08, 0.04, 0.02, 0.01], 2: [0.016, 0.004, 0.001]}
    found = made_up(regular, 0.01)
    reference = found.reference("elastic")
    assert reference.value == pytest.approx(10.0, rel=1e-9) and reference.power == pytest.approx(2.0)
    level = found.cheapest()
    assert (level.order, level.overrides["mesh.size"]) == (2, 0.2) and level.seconds == 16.0
    text = as_text(found)
    assert (
        "Cheapest within 1 %, 16 s for the whole load: --set mesh.size=0.2 mesh.contact_size=0.05 mesh.order=2" in text
    )
    assert "the error falls with the power 2.0 of the mesh size" in text
    assert len(chart(found).axes) == 1
    assert made_up(regular, 1e-4).cheapest() is None
    noisy = made_up({1: [0.05, -0.04, 0.03]}, 0.01)
    assert noisy.cheapest() is None
    assert "NOT extrapolated, since the sequence is not regular" in as_text(noisy)
    assert "No run is surely within 1 %: the limit of elastic is not known as well" in as_text(noisy)


def test_the_load_up_to_a_step_is_the_same_load() -> None:
    scene = Scene.load("fibers_2d")
    for last in (1, 20, 33, 52):
        cut = Scene.load(scene, {"load": _load_until(scene, last)})
        given, taken = list(steps(scene.load))[:last], list(steps(cut.load))
        assert [step.after["press"] for step in taken] == pytest.approx([step.after["press"] for step in given])


def small(**over: Any) -> Scene:
    """Elastic half discs, pressed in two steps and released."""
    keys = {
        "mesh.size": 0.15, "mesh.contact_size": 0.06, "bodies": {"*": "elastic"}, "contact": {}, "electrodes": [],
        "boundaries": [
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": [0, -0.05], "follows": "press"},
        ],
        "load": {"steps": [2, 1], "factors": {"press": [1, 0]}}, "output": {"fields": "none", "picture": False},
    }  # fmt: skip
    return Scene.load("fibers_2d", keys | over)


def test_a_study_of_a_scene() -> None:
    found = study(small(), MPI.COMM_SELF, within=0.02, budget=60.0, quiet=True)
    assert found.step == 2 and found.columns == ["force_y@top", "elastic"]
    assert len(found.series(1)) >= 3 and found.series(2)
    level = found.cheapest()
    assert level is not None and found.error(level, "force_y@top") <= 0.02
    cells = [level.cells for level in found.series(1)]
    assert all(b >= 1.25 * a for a, b in pairwise(cells))
    assert found.taken == 1  # without bonds that break the path does not matter
    for order in (1, 2):
        sizes = [[run.overrides[f"mesh.{key}"] for key in ("size", "contact_size")] for run in found.series(order)]
        assert [s / c for s, c in sizes] == pytest.approx([sizes[0][0] / sizes[0][1]] * len(sizes), rel=1e-3)


def test_the_load_keeps_its_steps_where_they_matter() -> None:
    """One step a stage where that gives the same within a part of the tolerance, else those of the scene."""
    adhesion = {"law": "bilinear", "strength": 40.0, "energy": 0.02}
    scene = small(**{"contact": {"adhesion": adhesion}, "load": {"steps": [2, 4], "factors": {"press": [0.2, -0.1]}}})
    run = simulation.run(scene, MPI.COMM_SELF)
    for step, within, counts in ((2, 0.01, [1]), (4, 1e-12, [2, 2])):
        load, effort = _path(scene, {}, run, step, ["force_y@top"], within)
        assert load["steps"] == counts and effort > 1.0


def test_a_budget_ends_a_study_and_columns_can_be_chosen() -> None:
    found = study(small(), MPI.COMM_SELF, within=1e-6, columns=["contact_area@lower-upper"], budget=0.0, quiet=True)
    assert found.columns == ["contact_area@lower-upper"] and len(found.levels) == 1
    assert "on one mesh alone" in as_text(found)
    with pytest.raises(SceneError, match=r"--column: found .*did you mean"):
        study(small(), MPI.COMM_SELF, columns=["contact_area@lower-uper"], quiet=True)


def test_a_penalty_of_the_scene_is_asked_for() -> None:
    changes = []
    for penalty in (1e4, 1e6):
        found = study(small(**{"contact.normal_penalty": penalty}), MPI.COMM_SELF, budget=0.0, quiet=True)
        assert "ten times the normal penalty changes force_y@top" in as_text(found)
        changes.append(found.penalty_change["force_y@top"])
    assert 0.0 < changes[1] < 0.1 * changes[0] < 0.1


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.toml").write_text(small().to_toml(), encoding="utf-8")
    out = tmp_path / "out"
    options = ["--within", "5%", "--budget", "0", "--out", str(out)]
    assert cli.main(["converge", str(tmp_path / "mine.toml"), *options]) == 0
    assert capsys.readouterr().out.rstrip().endswith((out / "converge.txt").read_text(encoding="utf-8").rstrip())
    assert {path.name for path in out.iterdir()} == {"converge.txt", "converge.csv", "converge.png"}
    assert cli.main(["converge", "own_mesh", "--out", str(out)]) == 2
    assert "geometry.file: found a mesh that is there" in capsys.readouterr().err
    assert cli.main(["converge", "fibers_2d", "--within", "200%"]) == 2
