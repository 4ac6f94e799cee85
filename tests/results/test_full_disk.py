"""Full disks and limits on the size of files: one line, nothing half-written, and resume goes on."""

from __future__ import annotations

import os
import resource
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import pyvista
from mpi4py import MPI

from piezomat import cli
from piezomat.meshes.gmsh_io import model as gmsh_model
from piezomat.progress import Progress
from piezomat.results import checkpoint
from piezomat.results.files import OutputError, read_history
from piezomat.results.vtk import read_index
from piezomat.scene import Scene
from piezomat.simulation import run
from tests.histories import assert_equal

STEPS, AFTER = 4, 2
SCENE = """
title = "Beam"
geometry = { shape = "cantilever", length = 4.0, divisions = [40, 4] }
bodies = { layer_1 = "pvdf", layer_2 = "pvdf" }
boundaries = [
    { on = "root", displacement = [0, 0] },
    { on = "bottom", potential = 0 },
    { on = "top", potential = 1.0, follows = "voltage" },
]
load = { steps = [4], factors = { voltage = [1.0] } }
output = { fields = "all", picture = false }
"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene file and the folder of its run, which nothing has disturbed."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "beam.toml").write_text(SCENE, encoding="utf-8")
    run(Scene.load(folder / "beam.toml"), MPI.COMM_SELF, folder / "out")
    return folder


@contextmanager
def file_limit() -> Iterator[Callable[[int], None]]:
    """Gives a function that sets the size (bytes) of the largest file that this process may write.

    The limit ends with the `with` block, not with the test: pytest writes its results to a file too, perhaps.
    """
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def check_whole_files(out: Path) -> int:
    """Every file under a final name is complete; the steps that the index of the fields names."""
    assert not [path for path in out.rglob(".*") if path.name != ".piezomat"]
    entries = read_index(out / "fields.pvd")
    named = [out / file for entry in entries for file in entry.files]
    pieces = list((out / "fields").glob("*"))
    assert set(named) <= set(pieces)
    assert all(path.read_bytes().endswith(b"</VTKFile>\n") and pyvista.read(path).n_cells > 0 for path in pieces)
    for path in (out / "checkpoint").glob("step_*.npz"):
        assert checkpoint._read_content(path, int(path.stem[5:]))
    return len(entries)


@pytest.mark.parametrize(
    ("file", "fields", "indexed"),
    [("fields/step_0001_rank_0000.vtu", "all", (AFTER, STEPS)), ("checkpoint/step_0003.npz", "end", (0, 1))],
)
def test_a_limit_on_the_size_of_files(
    file: str,
    fields: str,
    indexed: tuple[int, int],
    whole: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Set during the run, below the size of a file of the third step."""
    out, stepped = tmp_path / "out", Progress.step
    scene = Scene.load(whole / "beam.toml", [f"output.fields={fields}"])

    with file_limit() as limit, monkeypatch.context() as patch:

        def limited(self: Progress, row: dict[str, Any]) -> None:
            stepped(self, row)
            if row["step"] == AFTER:
                limit((whole / "out" / file).stat().st_size - 200)

        patch.setattr(Progress, "step", limited)
        with pytest.raises(OutputError, match=f"File too large.*steps 1 to {AFTER} are kept in {out}"):
            run(scene, MPI.COMM_SELF, out)
    assert check_whole_files(out) == indexed[0]
    assert len(read_history(out / "history.csv")) == AFTER
    history = run(scene, MPI.COMM_SELF, out, resume=True).history
    assert_equal(history, read_history(whole / "out" / "history.csv"))
    assert check_whole_files(out) == indexed[1]


def test_a_mesh_that_is_cut(whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """gmsh reports nothing; a file of the user's under that name stays."""
    out = tmp_path / "own.msh"
    out.write_text("mine")
    with file_limit() as limit:
        limit(1000)
        assert cli.main(["mesh", str(whole / "beam.toml"), "--out", str(out)]) == 1
    err = capsys.readouterr().err
    assert "only a part of the mesh could be written" in err and err.count("\n") == 1
    assert os.listdir(tmp_path) == ["own.msh"] and out.read_text() == "mine"
    with file_limit() as limit:
        limit(1000)
        assert cli.main(["run", str(whole / "beam.toml"), "--out", str(tmp_path / "out")]) == 1
    err = capsys.readouterr().err
    assert "only a part of the mesh could be written" in err and err.count("\n") == 1
    assert os.listdir(tmp_path) == ["own.msh"]


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Any]:
    """Mounts a disk of so many kilobytes, or gives it another size; its folder."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = False

    def sized(kilobytes: int) -> Path:
        nonlocal mounted
        options = f"{'remount,' if mounted else ''}size={kilobytes}k"
        done = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "none", disk], capture_output=True, check=False)
        if done.returncode != 0:
            pytest.skip("no disk can be mounted")
        mounted = True
        return disk

    if os.geteuid() != 0:
        pytest.skip("only root mounts a disk")
    yield sized
    if mounted:
        subprocess.run(["umount", disk], check=True)


@pytest.mark.parametrize("kilobytes", [24, 60, 100, 140, 180])
def test_a_full_disk(kilobytes: int, whole: Path, small_disk: Any, capsys: pytest.CaptureFixture[str]) -> None:
    out = small_disk(kilobytes) / "out"
    capsys.readouterr()
    assert cli.main(["run", str(whole / "beam.toml"), "--out", str(out)]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and ("No space left" in err or "the disk or a quota is full" in err), err
    steps = 0
    if out.exists():
        check_whole_files(out)
        steps = len(read_history(out / "history.csv")) if (out / "history.csv").exists() else 0
    small_disk(10_000)
    if list((out / "checkpoint").glob("step_*.npz")):
        assert cli.main(["resume", str(out)]) == 0
        assert capsys.readouterr().out.count("step ") in (STEPS - steps, STEPS - steps - 1)
    else:
        assert cli.main(["run", str(whole / "beam.toml"), "--out", str(out)]) == 0
    assert_equal(read_history(out / "history.csv"), read_history(whole / "out" / "history.csv"))
    assert check_whole_files(out) == STEPS


def test_the_end_of_a_mesh_is_found(tmp_path: Path) -> None:
    """Also where what comes last are periodic entities."""
    import gmsh

    with gmsh_model.session():
        tag = gmsh.model.occ.addRectangle(0, 0, 0, 1, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.mesh.setPeriodic(1, [2], [4], [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1])
        gmsh.model.addPhysicalGroup(2, [tag])
        gmsh.model.mesh.generate(2)
        gmsh_model.write(tmp_path / "periodic.msh")
    assert b"$Periodic" in (tmp_path / "periodic.msh").read_bytes()
