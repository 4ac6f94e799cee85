"""The commands: what they call, what they print, and their exit statuses, on one rank and on several."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mpi4py import MPI

import piezomat
from piezomat import cli
from piezomat.scene import Scene, SceneError
from piezomat.scene import toml as scene_file
from tests.conftest import LAUNCH, bare_environment
from tests.scene.test_malformed import OVERLAPPING, OVERLAPPING_SCENE, SQUARE, SQUARE_SCENE

ROOT = Path(__file__).parents[2]

SCENE = """
title = "Two half discs"
geometry.shape = "facing_halves"
mesh.size = 0.25
bodies = { lower = "pvdf", upper = "pvdf" }
boundaries = [
    { on = "bottom", displacement = [0, 0], potential = 0 },
    { on = "top", displacement = [0, -0.01], follows = "press" },
]
load.factors.press = [1.0]
"""


class NotConverged(RuntimeError):
    pass


class Interrupted(RuntimeError):
    pass


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scene in the working directory, which holds nothing else."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "halves.toml"
    path.write_text(SCENE, encoding="utf-8")
    return path


@pytest.fixture
def simulated(monkeypatch: pytest.MonkeyPatch) -> Callable[[Any], list[tuple[Any, ...]]]:
    """Puts something else in place of the simulation; returns the list of the calls that it gets."""

    def install(outcome: Exception | str | None) -> list[tuple[Any, ...]]:
        calls: list[tuple[Any, ...]] = []

        def run(scene: Scene, comm: MPI.Comm, out: Path | None, *, resume: bool = False) -> None:
            calls.append((scene, out, resume))
            if isinstance(outcome, Exception):
                raise outcome

        fake = types.SimpleNamespace(
            run=run, plan=lambda scene, comm: str(outcome), NotConverged=NotConverged, Interrupted=Interrupted
        )
        monkeypatch.setattr(piezomat, "simulation", fake, raising=False)
        monkeypatch.setitem(sys.modules, "piezomat.simulation", fake)
        return calls

    return install


def test_run(scene: Path, simulated: Any, capsys: pytest.CaptureFixture[str]) -> None:
    calls = simulated(None)
    assert cli.main(["run", "halves.toml", "--set", "mesh.order=2", "load.steps=[4]"]) == 0
    (given, out, resume), *_ = calls
    assert (given.mesh.order, given.load.steps, out, resume) == (2, [4], Path("results/halves"), False)
    assert capsys.readouterr() == ("results in results/halves\n", "")
    assert cli.main(["run", "--out", "here", "--set", "mesh.order=2", "halves.toml"]) == 0
    assert calls[1][1] == Path("here") and calls[1][0].mesh.order == 2


def test_resume(scene: Path, simulated: Any) -> None:
    calls = simulated(None)
    folder = scene.parent / "done"
    folder.mkdir()
    (folder / "scene.toml").write_text(Scene.load(scene).to_toml(), encoding="utf-8")
    assert cli.main(["resume", "done"]) == 0
    assert calls == [(Scene.load(scene), Path("done"), True)]


def test_resume_takes_the_mesh_that_the_run_has_kept(scene: Path, simulated: Any) -> None:
    folder = scene.parent / "done"
    (folder / "checkpoint").mkdir(parents=True)
    kept = folder / "checkpoint" / "mesh.msh"
    assert cli.main(["mesh", "halves.toml", "--out", str(kept)]) == 0
    text = Scene.load(scene).to_toml().replace('shape = "facing_halves"', 'file = "/gone.msh"')
    (folder / "scene.toml").write_text(re.sub(r"radius = .*\ngap = .*\n", "", text), encoding="utf-8")
    calls = simulated(None)
    assert cli.main(["resume", "done"]) == 0
    (given, *_), *_ = calls
    assert given.geometry.file == Path("/gone.msh") and given.body_names == ("lower", "upper")
    kept.unlink()
    assert cli.main(["resume", "done"]) == 2


def test_plan(scene: Path, simulated: Any, capsys: pytest.CaptureFixture[str]) -> None:
    simulated("a linear problem of 12 unknowns")
    assert cli.main(["plan", "halves.toml"]) == 0
    assert capsys.readouterr() == ("a linear problem of 12 unknowns\n", "")


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (
            NotConverged("step 3 did not converge;\nsteps 1 to 2 are kept"),
            3,
            "step 3 did not converge; steps 1 to 2",
        ),
        (Interrupted("interrupted: step 2 is kept in results/halves"), 1, "interrupted: step 2 is kept"),
        (
            SceneError("geometry", "an overlap", "none"),
            2,
            "halves.toml: geometry: found an overlap; allowed: none",
        ),
    ],
)
def test_ends_of_a_run(
    scene: Path, simulated: Any, capsys: pytest.CaptureFixture[str], error: Exception, status: int, line: str
) -> None:
    simulated(error)
    assert cli.main(["run", "halves.toml"]) == status
    out, err = capsys.readouterr()
    assert out == "" and err.startswith(line) and err.count("\n") == 1


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="ends all ranks")
def test_any_other_error_shows_its_traceback(scene: Path, simulated: Any, capsys: pytest.CaptureFixture[str]) -> None:
    simulated(ZeroDivisionError("a bug"))
    assert cli.main(["run", "halves.toml"]) == 1
    err = capsys.readouterr().err
    assert err.startswith("Traceback") and "ZeroDivisionError: a bug" in err


def test_mesh(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["mesh", "halves.toml", "--out", "halves.msh"]) == 0
    assert capsys.readouterr() == ("mesh in halves.msh\n", "")
    text = SCENE.replace('shape = "facing_halves"', 'file = "halves.msh"').replace("mesh.size = 0.25", "")
    (scene.parent / "from_file.toml").write_text(text, encoding="utf-8")
    built, read = Scene.load("halves.toml"), Scene.load("from_file.toml")
    assert (read.dimension, read.body_names) == (built.dimension, built.body_names)
    assert set(read.facet_groups) == set(built.facet_groups)


def test_view_without_results(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (scene.parent / "history.csv").write_text("step,stage\n", encoding="utf-8")
    assert cli.main(["view", "."]) == 1
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith(". holds no step")
    assert not (scene.parent / "picture.png").exists()


def test_schema(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out)["properties"].keys() >= {"geometry", "bodies", "boundaries"}


@pytest.mark.parametrize("command", [[], ["run"], ["plan"], ["mesh"], ["view"], ["resume"], ["schema"]])
def test_help(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([*command, "--help"]) == 0
    assert capsys.readouterr().out.startswith(" ".join(["usage: piezomat", *command]))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], ["COMMAND"]),
        (["walk"], ["walk", "resume"]),
        (["run"], ["SCENE", *scene_file.examples()]),
        (["run", "nowhere.toml"], ["nowhere.toml", "no such file", *scene_file.examples()]),
        (["run", "."], [".", "a directory"]),
        (["run", "halves.toml", "--set", "mesh.sise=1"], ["halves.toml", "mesh.sise", '"size"']),
        (["run", "halves.toml", "--set", "mesh"], ["halves.toml", "--set", "KEY=VALUE"]),
        (["run", "halves.toml", "--out", "halves.toml"], ["--out", "a file"]),
        (["run", "halves.toml", "--out", "halves.toml/results"], ["--out", "a file"]),
        (["run", "halves.toml", "--fast"], ["--fast"]),
        (["mesh", "halves.toml"], ["--out"]),
        (["mesh", "halves.toml", "--out", "mesh.vtk"], ["--out", "mesh.vtk", ".msh"]),
        (["mesh", "halves.toml", "--out", "no/mesh.msh"], ["--out", "directory"]),
        (["view", "nowhere"], ["nowhere", "no such directory"]),
        (["view", "."], ["history.csv"]),
        (["resume", "."], ["scene.toml"]),
    ],
)
def test_wrong_arguments(
    scene: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: list[str]
) -> None:
    assert cli.main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1
    for word in words:
        assert word in err
    assert list(scene.parent.iterdir()) == [scene]


def test_a_reader_that_goes_away_is_no_error() -> None:
    command = f"{sys.executable} -m app schema | true"
    done = subprocess.run(command, shell=True, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("", "")


@pytest.mark.mpi
def test_all_ranks_end_alike(
    comm: MPI.Comm, shared_tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = shared_tmp_path / "halves.toml"
    if comm.rank == 0:
        path.write_text(SCENE, encoding="utf-8")
    monkeypatch.chdir(shared_tmp_path)
    comm.Barrier()
    assert cli.main(["run", "halves.toml", "--set", "contact.method=nodes"]) == 2
    err = capfd.readouterr().err
    if comm.rank == 0:
        assert err == 'halves.toml: contact.method: found "nodes"; allowed: "node" or "point" or "segment"\n'
    else:
        assert err == ""
    assert cli.main(["mesh", "halves.toml", "--out", "halves.msh"]) == 0
    out = capfd.readouterr().out
    assert out == ("mesh in halves.msh\n" if comm.rank == 0 else "")
    assert sorted(p.name for p in shared_tmp_path.iterdir()) == ["halves.msh", "halves.toml"]


# Mistakes that show only once the mesh is there: on all ranks, or on the one that reads it.
LATE = {
    "contact.adhesion.energy": f"{SCENE}contact.adhesion = {{ law = 'bilinear', strength = 50, energy = 1e-9 }}",
    "contact.adhesion.range": f"{SCENE}contact.adhesion = {{ law = 'cutoff', strength = 50, range = 1e-9 }}",
    "geometry.file": SQUARE_SCENE,
    "geometry": OVERLAPPING_SCENE,
}


@pytest.mark.mpi
@pytest.mark.parametrize("key", LATE)
def test_all_ranks_report_a_mistake_found_late(
    key: str, comm: MPI.Comm, shared_tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(shared_tmp_path)
    if comm.rank == 0:
        Path("wrong.toml").write_text(LATE[key], encoding="utf-8")
        Path("square.msh").write_text(SQUARE.replace("3 1 1 0", "3 0.3 -0.1 0"), encoding="utf-8")
        Path("overlapping.msh").write_text(OVERLAPPING, encoding="utf-8")
    comm.Barrier()
    assert cli.main(["run", "wrong.toml"]) == 2
    err = capfd.readouterr().err
    assert (err.startswith(f"wrong.toml: {key}: found ") and err.count("\n") == 1) if comm.rank == 0 else err == ""
    comm.Barrier()
    assert sorted(path.name for path in shared_tmp_path.iterdir()) == ["overlapping.msh", "square.msh", "wrong.toml"]


@pytest.mark.mpi
def test_plan_of_a_scene_on_all_ranks(
    comm: MPI.Comm, shared_tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(shared_tmp_path)
    if comm.rank == 0:
        Path("halves.toml").write_text(SCENE, encoding="utf-8")
    comm.Barrier()
    assert cli.main(["plan", "halves.toml"]) == 0
    out, err = capfd.readouterr()
    assert err == "" and (("Two half discs" in out and "unknowns" in out) if comm.rank == 0 else out == "")
    assert [path.name for path in shared_tmp_path.iterdir()] == ["halves.toml"]


@pytest.mark.mpi
def test_resume_without_a_checkpoint(
    comm: MPI.Comm, shared_tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder with a scene alone is not that of a run; a run killed before its start has nothing to go on from."""
    monkeypatch.chdir(shared_tmp_path)
    if comm.rank == 0:
        Path("out").mkdir()
        Path("out/scene.toml").write_text(SCENE, encoding="utf-8")
    comm.Barrier()
    assert cli.main(["resume", "out"]) == 2
    err = capfd.readouterr().err
    assert ("checkpoint" in err and err.count("\n") == 1) if comm.rank == 0 else err == ""
    if comm.rank == 0:
        Path("out/checkpoint").mkdir()
    assert cli.main(["mesh", "out/scene.toml", "--out", "out/checkpoint/mesh.msh"]) == 0
    capfd.readouterr()
    assert cli.main(["resume", "out"]) == 1
    err = capfd.readouterr().err
    assert err == ("there is no checkpoint in out/checkpoint\n" if comm.rank == 0 else "")


@pytest.mark.skipif(shutil.which("mpirun") is None, reason="no mpirun")
def test_one_line_under_mpirun(scene: Path) -> None:
    environment = bare_environment() | LAUNCH | {"PYTHONPATH": str(ROOT)}
    command = ["mpirun", "-n", "2", sys.executable, "-m", "app", "run", "halves.toml", "--set", "mesh.size=-1"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert done.stderr.count("halves.toml: mesh.size: found -1; allowed: a number > 0\n") == 1
    assert "Traceback" not in done.stderr and done.stdout == ""
    assert list(scene.parent.iterdir()) == [scene]
