"""`pz.run` and `pz.open`: kinds of scenes, tables, fields without files, what is printed, threads of BLAS."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import pyvista
from mpi4py import MPI

import piezomat as pz
from piezomat.results.vtk import ResultsError
from tests.conftest import bare_environment

ROOT = Path(__file__).parents[2]
SMALL = {"mesh.size": 0.2, "mesh.contact_size": 0.1, "load.steps": [2, 1], "output.picture": False}


@pytest.fixture(scope="module")
def pressed() -> pz.Result:
    return pz.run("fibers_2d", SMALL, comm=MPI.COMM_SELF, quiet=True)


@pytest.mark.parametrize("kind", ["name", "file", "dict", "Scene", "texts"])
def test_a_scene_may_be_given_in_many_ways(kind: str, tmp_path: Path) -> None:
    loaded = pz.Scene.load("fibers_2d", SMALL)
    (tmp_path / "mine.toml").write_text(loaded.to_toml(), encoding="utf-8")
    scene, overrides = {
        "name": ("fibers_2d", SMALL),
        "file": (tmp_path / "mine.toml", {}),
        "dict": (loaded.model_dump(mode="json", exclude_none=True), {}),
        "Scene": (pz.Scene.load("fibers_2d"), SMALL),
        "texts": (loaded, ["load.steps=[2, 1]"]),
    }[kind]
    assert pz.Scene.load(scene, overrides).model_dump() == loaded.model_dump()


def test_an_override_takes_the_place_of_its_rival_and_of_numpy_numbers() -> None:
    scene = pz.Scene.load("fibers_2d", {"contact.normal_penalty": np.float64(3e4), "load.steps": np.array([1, 2])})
    assert scene.contact.normal_penalty == 3e4 and scene.contact.normal_penalty_factor is None
    assert scene.load.steps == [1, 2]
    again = pz.Scene.load(scene, {"contact.normal_penalty_factor": 7.0})
    assert again.contact.normal_penalty is None and again.contact.normal_penalty_factor == 7.0


@pytest.mark.parametrize("key", ["geometry..radius", "boundaries.9.potential", "geometry.radiu"])
def test_a_wrong_override_is_named(key: str) -> None:
    with pytest.raises(pz.SceneError, match=r"overrides|boundaries|radius"):
        pz.run("fibers_2d", {key: 1.0}, quiet=True)


def test_the_table_is_the_history(pressed: pz.Result, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    frame = pressed.frame()
    assert list(frame) == pressed.columns and frame["step"].tolist() == [1, 2, 3]
    assert frame["force_y@top"].tolist() == [row["force_y@top"] for row in pressed.history]
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=lambda rows: ("frame", rows)))
    assert pressed.frame() == ("frame", pressed.history)


@pytest.mark.mpi
def test_fields_without_files_are_those_of_the_files(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    """Of each step, on any number of ranks: the grid holds all ranks' cells, and each node once in each body."""
    result = pz.run("fibers_2d", SMALL | {"output.fields": "all"}, comm=comm, out=shared_tmp_path / "out", quiet=True)
    comm.Barrier()
    read = pz.open(shared_tmp_path / "out")
    assert read.steps == result.steps == [1, 2, 3]
    assert read.dim == result.dim == 2 and read.converged and result.converged
    for step in result.steps:
        here, there = result.grid(step), read.grid(step)
        assert here.n_cells == there.n_cells == result.summary["cells"]
        assert here.n_points == there.n_points == result.summary["dofs"] // 3
        for name in ("displacement", "potential"):
            np.testing.assert_array_equal(here[name], there[name])
        for name in ("stress", "von_mises", "strain", "electric_field", "electric_displacement", "body"):
            np.testing.assert_array_equal(here.cell_data[name], there.cell_data[name])
        here, there = result.contact(step), read.contact(step)
        assert here.n_points == there.n_points > 0
        np.testing.assert_array_equal(here["pressure"], there["pressure"])
    with pytest.raises(KeyError, match="no fields of step 9, but of steps 1, 2, 3"):
        result.grid(9)


def test_names_in_the_grids(pressed: pz.Result) -> None:
    grid, contact = pressed.grid(2), pressed.contact(2)
    components = {"stress": "xx yy zz yz xz xy", "strain": "xx yy zz yz xz xy", "electric_field": "x y z"}
    for name, words in components.items():
        array = grid.GetCellData().GetArray(name)
        assert [array.GetComponentName(i) for i in range(array.GetNumberOfComponents())] == words.split()
    assert list(grid.field_data["body_names"]) == ["lower", "upper"]
    assert list(contact.field_data["pair_names"]) == ["lower-upper"]
    assert list(contact.field_data["status_names"]) == ["apart", "touching", "bonded", "broken"]
    s = grid.cell_data["stress"]
    deviator = s - np.pad(s[:, :3].mean(axis=1)[:, None] * np.ones(3), ((0, 0), (0, 3)))
    square = (deviator[:, :3] ** 2).sum(axis=1) + 2 * (deviator[:, 3:] ** 2).sum(axis=1)
    np.testing.assert_allclose(grid.cell_data["von_mises"], np.sqrt(1.5 * square), rtol=1e-12)
    # The two half discs do not share nodes, and the upper one has been pressed down.
    upper = grid.threshold([1, 1], scalars="body")
    assert upper.n_cells < grid.n_cells and upper["displacement"][:, 1].min() < -0.015


def test_the_strain_is_that_of_the_stress(pressed: pz.Result) -> None:
    grid = pressed.grid(2)
    material = pz.Scene.load("fibers_2d").material("lower")
    rows = grid.cell_data["body"] == 0
    state = np.hstack([grid.cell_data["strain"], grid.cell_data["electric_field"]])[rows]
    stress = (state @ material.constitutive_matrix(3).T)[:, :6]
    np.testing.assert_allclose(grid.cell_data["stress"][rows], stress, rtol=1e-9, atol=1e-9 * np.abs(stress).max())


def test_plots_have_names_and_units(pressed: pz.Result) -> None:
    ax = pressed.plot("force_y@top", x="mean_potential@top", color="red")
    (line,) = ax.get_lines()
    assert line.get_ydata().tolist() == pressed.column("force_y@top").tolist()
    assert line.get_xdata().tolist() == pressed.column("mean_potential@top").tolist() and line.get_color() == "red"
    assert ax.get_xlabel() == "mean_potential@top (V)" and ax.get_ylabel() == "force_y@top (µN/µm)"
    again = pressed.plot(["elastic", "electric"], ax=ax)
    assert again is ax and len(ax.get_lines()) == 3 and ax.get_ylabel() == "(pJ/µm)"
    with pytest.raises(KeyError, match="no column 'force'"):
        pressed.plot("force")


def test_short_texts(pressed: pz.Result, tmp_path: Path) -> None:
    assert repr(pressed) == f"<Result {pressed.title!r}: 3 steps, converged, {pressed.summary['dofs']:,} unknowns>"
    assert len(repr(pressed.finished)) < 100
    with pytest.raises(ResultsError, match=r"there is no .*history\.csv"):
        pz.open(tmp_path)


def test_a_run_that_has_not_ended_can_be_opened(tmp_path: Path) -> None:
    result = pz.run("fibers_2d", SMALL, comm=MPI.COMM_SELF, out=tmp_path / "out", quiet=True)
    (tmp_path / "out" / "summary.json").unlink()
    read = pz.open(tmp_path / "out")
    assert read.history == result.history and not read.converged and read.summary == {}


def test_the_summary_without_files_is_that_of_the_file(pressed: pz.Result, tmp_path: Path) -> None:
    written = pz.run("fibers_2d", SMALL, comm=MPI.COMM_SELF, out=tmp_path / "out", quiet=True)
    assert written.summary == json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert set(pressed.summary) == set(written.summary)
    same = ("title", "converged", "reason", "dofs", "cells", "bodies", "warnings", "capacitance", "versions")
    assert {key: pressed.summary[key] for key in same} == {key: written.summary[key] for key in same}


@pytest.fixture
def logger() -> Any:
    """The program's logger as a program of its own finds it, and as it was afterwards."""
    log = logging.getLogger("piezomat")
    before = log.level, log.propagate, list(log.handlers)
    log.setLevel(logging.NOTSET)
    log.propagate, log.handlers = True, []
    yield log
    log.setLevel(before[0])
    log.propagate, log.handlers = before[1], before[2]


@pytest.mark.parametrize(
    ("quiet", "level", "lines"), [(False, "NOTSET", 3), (True, "NOTSET", 0), (False, "WARNING", 0)]
)
def test_levels_of_logging_are_honoured(
    quiet: bool, level: str, lines: int, logger: Any, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    logger.setLevel(level)
    pz.run("fibers_2d", SMALL, comm=MPI.COMM_SELF, out=tmp_path / "out", quiet=quiet)
    assert capfd.readouterr().out.count("step ") == lines
    assert logger.level == getattr(logging, level) and logger.propagate and logger.handlers == []
    written = (tmp_path / "out" / "log.txt").read_text(encoding="utf-8")
    assert written.count("INFO step ") == (0 if level == "WARNING" else 3)


@pytest.mark.parametrize("level", ["WARNING", "INFO"])
def test_a_handler_of_the_root_gets_what_its_level_lets_through(
    level: str, logger: Any, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    """A log file at level INFO does not make a program that listens to warnings hear of each step."""
    caplog.set_level(level)
    pz.run("fibers_2d", SMALL, comm=MPI.COMM_SELF, out=tmp_path / "out", quiet=True)
    heard = [record for record in caplog.records if record.name == "piezomat" and "step " in record.getMessage()]
    assert len([record for record in heard if record.levelno == logging.INFO]) == (3 if level == "INFO" else 0)


@pytest.mark.parametrize("given", [None, "2"])
def test_one_thread_of_blas_unless_the_user_says_otherwise(given: str | None) -> None:
    """NumPy may have been imported first, and has read the environment then."""
    code = """
import ctypes, os, numpy
numpy.ones((2, 2)) @ numpy.ones((2, 2))
import piezomat
lines = {line.split(maxsplit=5)[5].strip() for line in open("/proc/self/maps") if "openblas" in line}
print(os.environ["OMP_NUM_THREADS"], *{ctypes.CDLL(name).openblas_get_num_threads() for name in lines})
"""
    environment = {k: v for k, v in bare_environment().items() if not k.endswith("_NUM_THREADS")}
    environment |= {"OMP_NUM_THREADS": given} if given else {}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    said, *threads = done.stdout.split()
    assert said == (given or "1")
    assert set(threads) <= {str(min(int(given or "1"), os.cpu_count() or 1))}


def test_importing_the_package_loads_nothing() -> None:
    code = "import sys, piezomat; print([m for m in ('numpy', 'dolfinx', 'gmsh', 'mpi4py') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_grids_are_pyvista(pressed: pz.Result) -> None:
    assert isinstance(pressed.grid(), pyvista.UnstructuredGrid) and isinstance(pressed.contact(), pyvista.PolyData)
    assert pressed.steps[-1] == 3
