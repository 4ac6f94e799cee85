"""What surrounds a run and is not its scene: streams that are closed, full or gone, a home, a working folder, sizes."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from piezomat.scene import Scene, SceneError
from tests.conftest import bare_environment

ROOT = Path(__file__).parents[2]
RUN = f"{sys.executable} -m app run stack --out r --set output.picture=false output.fields=none"


def shell(command: str, folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """A command of the shell in a folder."""
    environment = bare_environment() | {"PYTHONPATH": str(ROOT)} | variables
    return subprocess.run(
        ["bash", "-o", "pipefail", "-c", command],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.mark.parametrize("stream", [">/dev/full", "| head -n 1", "2>&- >&- <&-"])
def test_a_display_costs_no_run(stream: str, tmp_path: Path) -> None:
    done = shell(f"{RUN} {stream}", tmp_path)
    assert done.returncode == 0 and done.stderr == ""
    assert len((tmp_path / "r" / "history.csv").read_text().splitlines()) == 9


@pytest.mark.parametrize("command", ["plan stack", "schema"])
def test_a_result_that_cannot_be_printed_is_an_error(command: str, tmp_path: Path) -> None:
    done = shell(f"{sys.executable} -m app {command} >/dev/full", tmp_path)
    assert (done.returncode, done.stderr) == (1, "standard output: No space left on device\n")


def test_a_home_that_cannot_be_written_to(tmp_path: Path) -> None:
    done = shell(f"unset XDG_CACHE_HOME; {RUN}", tmp_path, HOME="/proc/nowhere", TMPDIR=str(tmp_path))
    assert done.returncode == 0 and done.stderr == ""
    assert "no folder for compiled forms" in (tmp_path / "r" / "log.txt").read_text()
    assert not list(tmp_path.glob("piezomat-cache-*"))


def test_a_working_folder_that_is_gone(tmp_path: Path) -> None:
    done = shell(f"mkdir gone && cd gone && rmdir ../gone && {sys.executable} -P -m piezomat plan stack", tmp_path)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "working folder" in done.stderr


@pytest.mark.parametrize("words", [r"run $'\xff'", r"run stack --out $'\xff'", r"run stack --set $'title=\xff'"])
def test_arguments_that_are_no_text(words: str, tmp_path: Path) -> None:
    done = shell(f"{sys.executable} -m app {words}", tmp_path)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "UTF-8" in done.stderr


@pytest.mark.parametrize(
    ("scene", "override", "key"),
    [
        ("fibers_2d", "geometry.radius=500", "mesh.contact_size"),
        ("fibers_2d", "mesh.contact_size=1e-5", "mesh.contact_size"),
        ("fibers_2d", "load.steps=[1000000000, 1]", "load.steps"),
        ("fibers_2d", "mesh.max_cells=10", "mesh.contact_size"),
        ("crossed_fibers", "geometry.radius=500", "mesh.contact_size"),
        ("random_mat", "geometry.width=1e300", "geometry.width"),
        ("random_mat", "geometry.count=1000000000000000000", "geometry.count"),
        ("cross_ply", "geometry.width=1e9", "geometry.width"),
        ("cross_ply", "geometry.gap=1e300", "geometry.gap"),
        ("fiber_array", "geometry.rows=1000000000000000000", "geometry.rows"),
        ("blocks", "geometry.divisions=[[1000000, 1000000], [1, 1]]", "geometry.divisions"),
        ("blocks", "geometry.width=1e-300", "geometry.width"),
    ],
)
def test_absurd_sizes_end_before_they_begin(scene: str, override: str, key: str) -> None:
    start = time.process_time()
    with pytest.raises(SceneError) as error:
        Scene.load(scene, [override])
    assert error.value.key == key and time.process_time() - start < 1.0


def test_a_table_of_fibers_too_long_for_its_cells(tmp_path: Path) -> None:
    (tmp_path / "fibers.csv").write_text("fiber,x,y,z,radius\na,0,0,0,0.5\na,50000,0,0,0.5\n", encoding="utf-8")
    given = {"geometry": {"shape": "fibers", "file": tmp_path / "fibers.csv"}, "bodies": {"*": "pvdf"}}
    given["boundaries"] = [{"on": "ends", "displacement": [0, 0, 0]}]
    assert Scene(**given, mesh={"size": 10.0}).geometry.bodies() == ("a",)
    with pytest.raises(SceneError, match=r"mesh.contact_size: found about .* cells"):
        Scene(**given, mesh={"size": 0.3, "contact_size": 0.02})
