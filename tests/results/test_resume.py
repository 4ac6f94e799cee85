"""Interrupted and killed runs: what is kept, and that going on ends where the run without interruption ends."""

from __future__ import annotations

import csv
import json
import random
import signal
import subprocess
import sys
import time
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest
import pyvista
from mpi4py import MPI

from piezomat import cli
from piezomat.progress import Progress
from piezomat.results import checkpoint
from piezomat.results.files import Results, read_history
from piezomat.scene import Scene
from piezomat.simulation import Interrupted, run
from tests.conftest import LAUNCH, bare_environment
from tests.histories import Rows, assert_equal

ROOT = Path(__file__).parents[2]
STEPS = 12
AFTER = 3  # the step after which runs are interrupted
MESSAGE = f"interrupted: steps 1 to {AFTER} are kept in out; go on with: piezomat resume out"

SCENE = """
title = "Pressed, interrupted, pulled off"
geometry = { shape = "facing_halves" }
mesh = { size = 0.25, contact_size = 0.06 }
bodies = { lower = "pvdf", upper = "pvdf" }
boundaries = [
    { on = "bottom", displacement = [0, 0], potential = 0 },
    { on = "top", displacement = [0, -0.03], follows = "press" },
]
contact = { adhesion = { law = "bilinear", strength = 20.0, energy = 0.1 }, normal_penalty = 1e5 }
load = { steps = [6, 6], factors = { press = [1.0, -0.2] } }
solver = { tolerance = 1e-11 }
output = { fields = "all", picture = false }
"""
# `piezomat` with a signal sent to one rank after a step, as by Ctrl-C or a batch system.
STOPPED = """
import os, signal, sys
from mpi4py import MPI
from piezomat import cli
from piezomat.progress import Progress

number, step, last = int(sys.argv[1]), Progress.step, MPI.COMM_WORLD.size - 1

def stepped(self, row):
    step(self, row)
    if row["step"] == {after} and MPI.COMM_WORLD.rank == last:
        os.kill(os.getpid(), number)

Progress.step = stepped
sys.exit(cli.main(sys.argv[2:]))
"""


BEAM = {
    "geometry": {"shape": "cantilever", "length": 4.0, "divisions": [4, 1]},
    "bodies": {"layer_1": "pvdf", "layer_2": "pvdf"},
    "boundaries": [
        {"on": "root", "displacement": [0, 0]},
        {"on": "bottom", "potential": 0},
        {"on": "top", "potential": 1.0, "follows": "voltage"},
    ],
    "load": {"steps": [STEPS], "factors": {"voltage": [1.0]}},
    "output": {"fields": "all", "picture": False},
}
_whole: Rows = []


def scene() -> Scene:
    return Scene(**tomllib.loads(SCENE))


@pytest.fixture
def whole(comm: MPI.Comm) -> Rows:
    """The history of the run without interruption, serial. Collective."""
    if not _whole:
        mine = run(scene(), MPI.COMM_SELF).history if comm.rank == 0 else None
        _whole.extend(comm.bcast(mine))
    return _whole


def part_of(comm: MPI.Comm, ranks: int) -> MPI.Comm | None:
    """A communicator of the first so many ranks; None on the others. Collective."""
    part = comm.Split(0 if comm.rank < ranks else MPI.UNDEFINED)
    return None if part == MPI.COMM_NULL else part


def stop_after(patch: pytest.MonkeyPatch, step: int, comm: MPI.Comm) -> None:
    """Send the last rank SIGTERM when a step is done."""
    real = Progress.step

    def stepped(self: Progress, row: dict[str, Any]) -> None:
        real(self, row)
        if row["step"] == step and comm.rank == comm.size - 1:
            signal.raise_signal(signal.SIGTERM)

    patch.setattr(Progress, "step", stepped)


def die_before_the_row(patch: pytest.MonkeyPatch, step: int) -> None:
    """Raise where a step has its checkpoint and not yet its row in history.csv."""
    real = Results.row

    def row(self: Results, values: dict[str, Any]) -> None:
        if values["step"] == step:
            raise RuntimeError("dead")
        real(self, values)

    patch.setattr(Results, "row", row)


ALL = MPI.COMM_WORLD.size
SIZES = sorted({(1, ALL), (ALL, 1), (max(ALL - 1, 1), ALL)})


@pytest.mark.mpi
@pytest.mark.parametrize(("first", "second"), SIZES)
def test_resumed_on_another_number_of_ranks(
    first: int, second: int, comm: MPI.Comm, shared_tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: Rows
) -> None:
    out = shared_tmp_path / "out"
    here = part_of(comm, first)
    if here is not None:
        with monkeypatch.context() as patch, pytest.raises(Interrupted, match=f"steps 1 to {AFTER} are kept in {out}"):
            stop_after(patch, AFTER, here)
            run(scene(), here, out)
    comm.Barrier()
    kept = (out / "history.csv").read_text(encoding="utf-8")
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert not summary["converged"] and "interrupted" in summary["reason"] and summary["ranks"] == first
    assert kept.count("\n") == 1 + AFTER
    comm.Barrier()
    here = part_of(comm, second)
    if here is not None:
        history = run(scene(), here, out, resume=True).history
        assert_equal(history, whole)
        assert history[:AFTER] == summary["steps"]
    comm.Barrier()
    assert (out / "history.csv").read_text(encoding="utf-8").startswith(kept)
    check_files(out, finished=True)


@pytest.mark.mpi
def test_segments_keep_the_history_of_their_pieces(
    comm: MPI.Comm, shared_tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Interrupted while bonds break, where every step has other pieces than the one before, and multipliers."""
    keys = {"method": "segment", "augment": 1e-2}
    cut = scene().model_copy(update={"contact": scene().contact.model_copy(update=keys)})
    whole = run(cut, comm).history
    assert 0.0 < whole[8]["dissipated"] < whole[-1]["dissipated"]
    with monkeypatch.context() as patch, pytest.raises(Interrupted):
        stop_after(patch, 9, comm)
        run(cut, comm, shared_tmp_path)
    assert_equal(run(cut, comm, shared_tmp_path, resume=True).history, whole)


@pytest.mark.mpi
def test_a_checkpoint_without_its_row(
    comm: MPI.Comm, shared_tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: Rows
) -> None:
    out = shared_tmp_path / "out"
    with monkeypatch.context() as patch, pytest.raises(RuntimeError, match="dead"):
        die_before_the_row(patch, AFTER)
        run(scene(), comm, out)
    comm.Barrier()
    assert len(read_history(out / "history.csv")) == AFTER - 1
    comm.Barrier()
    assert_equal(run(scene(), comm, out, resume=True).history, whole)
    assert [row["step"] for row in read_history(out / "history.csv")] == list(range(1, STEPS + 1))


@pytest.mark.mpi
def test_stopped_by_command(
    comm: MPI.Comm, shared_tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """One line on rank 0 alone, exit status 1 everywhere; resume ends with 0."""
    if comm.rank == 0:
        (shared_tmp_path / "scene.toml").write_text(SCENE, encoding="utf-8")
    monkeypatch.chdir(shared_tmp_path)
    with monkeypatch.context() as patch:
        stop_after(patch, AFTER, comm)
        assert cli.main(["run", "scene.toml", "--out", "out"]) == 1
    out, err = capfd.readouterr()
    assert err == (
        "" if comm.rank else f"interrupted: steps 1 to {AFTER} are kept in out; go on with: piezomat resume out\n"
    )
    assert out.count("step ") == (0 if comm.rank else AFTER)
    assert cli.main(["resume", "out"]) == 0
    out, err = capfd.readouterr()
    assert err == "" and out.count("step ") == (0 if comm.rank else STEPS - AFTER)
    check_files(Path("out"), finished=True)


@pytest.mark.mpi
def test_a_linear_scene(comm: MPI.Comm, shared_tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    beam = Scene(title="Beam", **BEAM)
    with monkeypatch.context() as patch, pytest.raises(Interrupted):
        stop_after(patch, AFTER, comm)
        run(beam, comm, shared_tmp_path)
    resumed = run(beam, comm, shared_tmp_path, resume=True)
    assert_equal(resumed.history, run(beam, comm).history)
    check_files(shared_tmp_path, finished=True)


def test_resume_of_a_finished_run(tmp_path: Path, whole: Rows) -> None:
    out = tmp_path / "out"
    run(scene(), MPI.COMM_SELF, out)
    before = (out / "history.csv").read_bytes()
    again = run(scene(), MPI.COMM_SELF, out, resume=True)
    assert len(again.history) == STEPS and (out / "history.csv").read_bytes() == before
    check_files(out, finished=True)


@pytest.mark.slow
@pytest.mark.parametrize(("number", "ranks"), [(signal.SIGINT, 1), (signal.SIGTERM, 2)])
def test_signals(number: signal.Signals, ranks: int, tmp_path: Path) -> None:
    """In a process of its own, where nothing but the program has set handlers."""
    (tmp_path / "scene.toml").write_text(SCENE, encoding="utf-8")
    (tmp_path / "stopped.py").write_text(STOPPED.format(after=AFTER), encoding="utf-8")
    done = launch(ranks, tmp_path, "stopped.py", str(int(number)), "run", "scene.toml", "--out", "out")
    message = f"{MESSAGE}\n"
    assert done.stderr.startswith(message) if ranks > 1 else done.stderr == message  # Open MPI 5 reports ranks in error
    assert done.returncode == 1 and done.stdout.count("step ") == AFTER
    check_files(tmp_path / "out", finished=False)
    assert len(read_history(tmp_path / "out" / "history.csv")) == AFTER


@pytest.mark.slow
def test_killed_at_any_moment(tmp_path: Path, whole: Rows) -> None:
    """SIGKILL again and again; what is there always reads, and the run ends where it would have ended."""
    out = tmp_path / "out"
    (tmp_path / "scene.toml").write_text(SCENE, encoding="utf-8")
    moment = random.Random(3)
    done = 0
    for attempt in range(30):
        process = start(tmp_path, *(("resume", "out") if checkpoints(out) else ("run", "scene.toml", "--out", "out")))
        # Once at any moment from the start on, then within the steps or after them.
        for _ in range(moment.choice((3, 4)) if attempt > 0 else 0):
            process.stdout.readline()
        wait_until(process, time.monotonic() + moment.uniform(0.0, 0.05 if attempt > 0 else 3.0))
        process.kill()
        process.communicate(timeout=60)
        if process.returncode == 0:
            break
        assert process.returncode == -signal.SIGKILL
        steps = check_files(out, finished=False)
        assert steps >= done
        done = steps
    assert attempt >= 3, "the run was not killed often enough"
    check_files(out, finished=True)
    assert_equal(read_history(out / "history.csv"), whole)


def environment() -> dict[str, str]:
    """This process's, without the traces of the MPI that it runs in."""
    return bare_environment() | LAUNCH | {"PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}


def launch(ranks: int, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Python with these arguments on so many ranks."""
    mpirun = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    command = [*mpirun, sys.executable, *arguments]
    options: dict[str, Any] = {"capture_output": True, "text": True, "stdin": subprocess.DEVNULL, "timeout": 120}
    return subprocess.run(command, cwd=folder, env=environment(), **options)


def start(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "app", *arguments]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "text": True}
    return subprocess.Popen(command, cwd=folder, env=environment(), **pipes)


def wait_until(process: subprocess.Popen[str], moment: float) -> None:
    """Wait so long, or until the process ends."""
    while process.poll() is None and time.monotonic() < moment:
        time.sleep(0.002)


def checkpoints(out: Path) -> list[Path]:
    return sorted((out / "checkpoint").glob("step_*.npz"))


def check_files(out: Path, finished: bool) -> int:
    """Every file of the run that is there can be read; the number of steps in its history."""
    if not (out / "history.csv").exists():
        assert not finished and not checkpoints(out)
        return 0
    Scene.load(out / "scene.toml")
    with (out / "history.csv").open(newline="", encoding="utf-8") as file:
        assert len({len(row) for row in csv.reader(file)}) == 1
    history = read_history(out / "history.csv")
    assert [row["step"] for row in history] == list(range(1, len(history) + 1))
    if checkpoints(out):
        last = checkpoint.load(MPI.COMM_SELF, out / "checkpoint")
        assert last.scalars["history"][: len(history)] == history
        assert len(history) <= last.step == len(last.scalars["history"]) <= len(history) + 1
    else:
        assert not history
    for name in ("fields", "contact"):
        index = out / f"{name}.pvd"
        pieces = [entry.get("file") for entry in ET.parse(index).iter("DataSet")] if index.exists() else []
        assert all(pyvista.read(out / piece).n_points > 0 for piece in pieces)
        assert not finished or len(pieces) >= STEPS or (name == "contact" and not index.exists())
    if finished or (out / "summary.json").exists():
        summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
        assert summary["steps"] == history and summary["converged"] == (len(history) == STEPS)
        assert summary["converged"] or not finished
    return len(history)
