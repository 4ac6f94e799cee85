"""The folder of a run: the user's files stay, one run at a time, and nothing unfinished remains."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import secrets
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from mpi4py import MPI

from piezomat import cli
from piezomat.results.atomic import temporary_name, write_text
from piezomat.results.files import OutputError, Results
from piezomat.results.folder import MARK, RunFolder, check_free, remove_unfinished
from piezomat.scene import Scene, SceneError
from piezomat.simulation import run
from tests.conftest import bare_environment

ROOT = Path(__file__).parents[2]
SCENE = """
title = "Beam"
geometry = { shape = "cantilever", length = 4.0, divisions = [4, 1] }
bodies = { layer_1 = "pvdf", layer_2 = "pvdf" }
boundaries = [
    { on = "root", displacement = [0, 0] },
    { on = "bottom", potential = 0 },
    { on = "top", potential = 1.0 },
]
output = { picture = false }
"""


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scene file in the working directory."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "scene.toml"
    path.write_text(SCENE, encoding="utf-8")
    return path


def put(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("mine", encoding="utf-8")


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


# --- The user's files ------------------------------------------------------------------------------

NAMES = (
    *("scene.toml", "log.txt", "history.csv", "pairs.csv", "picture.png", "fields.pvd", "contact.pvd"),
    *("summary.json", "fields/step_0001_rank_0000.vtu"),
)


@pytest.mark.parametrize("name", NAMES)
def test_files_that_bear_a_run_s_names_stay(name: str, scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    put(Path("out"), name, "notes.txt")
    before = content(scene.parent)
    assert cli.main(["run", "scene.toml", "--out", "out"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and "--out" in err and name in err and "--out results/A" in err
    assert content(scene.parent) == before


@pytest.mark.parametrize("name", ["notes.txt", "checkpoint/mesh.msh", "checkpoint/step_0001.npz", MARK])
def test_folders_of_older_runs_and_other_files_are_taken(name: str, tmp_path: Path) -> None:
    """An earlier version set no mark: its checkpoint tells, or its summary."""
    put(tmp_path, name, *(("log.txt",) if name != "notes.txt" else ()))
    check_free(tmp_path)
    check_free(tmp_path / "new")


def test_a_summary_tells_a_run(tmp_path: Path) -> None:
    put(tmp_path, "log.txt")
    summary = dict.fromkeys(("converged", "reason", "steps", "versions"))
    (tmp_path / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    check_free(tmp_path)
    del summary["versions"]
    (tmp_path / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    with pytest.raises(SceneError, match=r"where no run has written log\.txt, summary\.json"):
        check_free(tmp_path)


@pytest.mark.parametrize("out", [".", "../{name}", "link"])
def test_the_folder_of_the_scene_is_refused(out: str, scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = scene.rename(scene.with_name("mine.toml"))
    Path("link").symlink_to(".")
    before = sorted(os.listdir())
    assert cli.main(["run", "mine.toml", "--out", out.format(name=scene.parent.name)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "the folder of mine.toml" in err
    assert sorted(os.listdir()) == before and scene.read_text(encoding="utf-8") == SCENE


@pytest.mark.parametrize("command", [["run", "scene.toml", "--out", ""], ["resume", ""], ["view", ""]])
def test_a_folder_without_a_name(command: list[str], scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(command) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and '""' in err and os.listdir() == ["scene.toml"]


def test_the_mesh_of_a_checkpoint_is_not_replaced_by_a_run_that_reads_it(scene: Path) -> None:
    out = scene.parent / "out"
    run(Scene.load(scene), MPI.COMM_SELF, out)
    mesh = out / "checkpoint" / "mesh.msh"
    again = Scene.load(scene, ['geometry={ file = "out/checkpoint/mesh.msh" }'])
    with pytest.raises(SceneError, match="which the run reads"):
        run(again, MPI.COMM_SELF, out)
    assert mesh.is_file()


def test_the_mesh_that_a_scene_reads_is_not_written(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["mesh", "scene.toml", "--out", "own.msh"]) == 0
    Path("link.msh").symlink_to("own.msh")
    before = content(scene.parent)
    for out in ("own.msh", "link.msh"):
        assert cli.main(["mesh", "scene.toml", "--out", out, "--set", 'geometry={ file = "own.msh" }']) == 2
        assert f"--out: found {out}, which the scene reads; allowed: another file\n" in capsys.readouterr().err
    assert content(scene.parent) == before


def test_a_picture_of_the_user_s_stays(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    put(Path("out"), "history.csv", "picture.png")
    assert cli.main(["view", "out"]) == 2
    assert capsys.readouterr().err.startswith("out: found a picture that no run has drawn")


# --- One run at a time -----------------------------------------------------------------------------


@pytest.mark.mpi
@pytest.mark.parametrize("resume", [False, True])
def test_a_second_run_is_refused(resume: bool, comm: MPI.Comm, shared_tmp_path: Path) -> None:
    out = shared_tmp_path / "results" / "fibers"
    with RunFolder(comm, out, resume=False) as first:
        first.keep()
        comm.barrier()
        numbers = comm.gather(os.getpid())
        if comm.rank == 0:
            with pytest.raises(SceneError, match=f"another run is at work.*{numbers[-1]} on ") as error:
                RunFolder(MPI.COMM_SELF, out, resume=resume).__enter__()
            assert ("--out results/A" in str(error.value)) != resume
        comm.barrier()
    with RunFolder(comm, out, resume=True):
        assert (out / MARK).is_file()


@pytest.mark.mpi
def test_a_rank_that_outlives_rank_0_keeps_the_folder(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    first = RunFolder(comm, shared_tmp_path, resume=False)
    first.__enter__()
    comm.barrier()
    if comm.rank == 0:
        first.__exit__(None)
        second = RunFolder(MPI.COMM_SELF, shared_tmp_path, resume=False)
        if comm.size > 1:
            with pytest.raises(SceneError, match="another run is at work"):
                second.__enter__()
        else:
            with second:
                pass
    comm.barrier()
    first.__exit__(None)


def test_by_the_command_line(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(Scene.load(scene), MPI.COMM_SELF, Path("results/scene"))
    before = content(scene.parent)
    capsys.readouterr()
    with RunFolder(MPI.COMM_SELF, Path("results/scene"), resume=True):
        for command in (["run", "scene.toml"], ["resume", "results/scene"]):
            assert cli.main(command) == 2
            out, err = capsys.readouterr()
            assert out == "" and err.count("\n") == 1 and f"another run is at work (process {os.getpid()} on " in err
        before[f"results/scene/{MARK}"] = Path(f"results/scene/{MARK}").read_bytes()
        assert content(scene.parent) == before
    assert cli.main(["resume", "results/scene"]) == 0


HOLD = """
import sys
from pathlib import Path
from mpi4py import MPI
from piezomat.results.folder import RunFolder
with RunFolder(MPI.COMM_SELF, Path(sys.argv[1]), resume=False):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_the_lock_dies_with_the_process(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    process = subprocess.Popen(
        command, cwd=ROOT, env=bare_environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "held\n"
    with pytest.raises(SceneError, match=f"another run is at work .process {process.pid} on "):
        RunFolder(MPI.COMM_SELF, tmp_path, resume=False).__enter__()
    process.send_signal(signal.SIGKILL)
    process.communicate()
    with RunFolder(MPI.COMM_SELF, tmp_path, resume=False):
        pass


@pytest.mark.mpi
def test_a_run_that_does_not_begin_leaves_the_folder_as_it_was(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    for out in (shared_tmp_path / "a" / "b", shared_tmp_path):
        if comm.rank == 0:
            put(shared_tmp_path, "notes.txt")
        comm.barrier()
        with pytest.raises(RuntimeError, match="no"), RunFolder(comm, out, resume=False):
            if comm.rank == 0:
                put(out, temporary_name(Path("mesh.msh")).name)
            raise RuntimeError("no")
        comm.barrier()
        assert os.listdir(shared_tmp_path) == ["notes.txt"]
        comm.barrier()


def test_a_file_system_without_locks(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def flock(handle: int, kind: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", flock)
    run(Scene.load(scene), MPI.COMM_SELF, Path("out"))
    assert "without locks" in Path("out/log.txt").read_text(encoding="utf-8")


def test_a_folder_without_a_run_is_not_resumed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "scene.toml").write_text(SCENE, encoding="utf-8")
    assert cli.main(["resume", str(tmp_path)]) == 2
    assert "neither a checkpoint" in capsys.readouterr().err and os.listdir(tmp_path) == ["scene.toml"]


# --- Temporary files -------------------------------------------------------------------------------


def test_temporary_names_cannot_be_foreseen_and_links_are_not_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(tmp_path, "victim", "history.csv")
    names = {temporary_name(tmp_path / "history.csv").name for _ in range(100)}
    assert len(names) == 100
    monkeypatch.setattr(secrets, "token_hex", lambda size: "0" * 16)
    temporary_name(tmp_path / "history.csv").symlink_to(tmp_path / "victim")
    with pytest.raises(FileExistsError):
        write_text(tmp_path / "history.csv", "new")
    assert (tmp_path / "victim").read_text() == (tmp_path / "history.csv").read_text() == "mine"


def test_a_log_that_is_a_link_or_a_folder(tmp_path: Path) -> None:
    put(tmp_path, "victim")
    with Results(tmp_path / "run", MPI.COMM_SELF) as results:
        results.start("", ["step"])
        results.row({"step": 1})
    log = tmp_path / "run" / "log.txt"
    log.unlink()
    log.symlink_to(tmp_path / "victim")
    put(tmp_path / "run", "summary.json")
    with Results(tmp_path / "run", MPI.COMM_SELF) as results:
        with pytest.raises(OutputError, match=r"log\.txt"):
            results.resume(["step"], 1)
        log.unlink()
        log.mkdir()
        with pytest.raises(OutputError, match=r"log\.txt"):
            results.resume(["step"], 1)
    assert (tmp_path / "victim").read_text() == "mine" and (tmp_path / "run" / "summary.json").exists()


def test_what_a_kill_leaves_is_removed_and_nothing_else(tmp_path: Path) -> None:
    left = ["history.csv", "summary.json", "fields.pvd", "picture.png", "mesh.msh", "fields/step_0012_rank_0003.vtu"]
    left = [str(temporary_name(Path(name))) for name in (*left, "checkpoint/step_0003.npz")]
    older = [".history.part.csv", "checkpoint/.step_0003.part.npz"]
    kept = [".notes.part.txt", "fields/.mine.part.vtu", ".history.csv", "history.part.csv", "scene.toml"]
    put(tmp_path, *left, *older, *kept, ".mesh.0123456789abcdef.part/mesh.msh")
    remove_unfinished(tmp_path)
    assert set(content(tmp_path)) == set(kept)


def test_a_run_makes_no_temporary_files_elsewhere(scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*arguments: object, **more: object) -> str:
        raise AssertionError("a temporary folder")

    monkeypatch.setattr(tempfile, "mkdtemp", refused)
    run(Scene.load(scene), MPI.COMM_SELF, tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir() if path.name.startswith(".")) == [MARK]
