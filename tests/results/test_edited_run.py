"""What resume takes and refuses: edited scenes, damaged and foreign checkpoints, other damaged files."""

from __future__ import annotations

import io
import json
import re
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat import cli
from piezomat.progress import Progress
from piezomat.results import restart
from piezomat.results.files import Results, read_history
from piezomat.results.run_scene import of_run
from piezomat.results.vtk import read_index
from piezomat.scene import Scene
from piezomat.simulation import run
from tests.histories import assert_equal

STEPS, AFTER = 6, 3
SCENE = """
title = "Beam"
geometry = { shape = "cantilever", length = 4.0, divisions = [4, 1] }
materials = { soft = { like = "pvdf", young = 2000.0, poisson = 0.3 } }
bodies = { layer_1 = "pvdf", layer_2 = "soft" }
boundaries = [
    { on = "root", displacement = [0, 0] },
    { on = "bottom", potential = 0 },
    { on = "top", potential = 1.0, follows = "voltage" },
]
load = { steps = [2, 4], factors = { voltage = [1.0, 2.0] } }
output = { fields = "all", picture = false }
"""


class Stop(Exception):
    pass


def stop_after(patch: pytest.MonkeyPatch, step: int) -> None:
    """End a run outright, as a kill does, when a step is done."""
    real = Progress.step

    def stepped(self: Progress, row: dict[str, Any]) -> None:
        real(self, row)
        if row["step"] == step:
            raise Stop

    patch.setattr(Progress, "step", stepped)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a whole run and one that ended after step 3, by a version that does not exist."""
    folder = tmp_path_factory.mktemp("runs")
    (folder / "beam.toml").write_text(SCENE, encoding="utf-8")
    scene = Scene.load(folder / "beam.toml")
    run(scene, MPI.COMM_SELF, folder / "whole")
    with pytest.MonkeyPatch.context() as patch:
        stop_after(patch, AFTER)
        patch.setattr(restart, "__version__", "0.0.7")
        with pytest.raises(Stop):
            run(scene, MPI.COMM_SELF, folder / "stopped")
    return folder


@pytest.fixture
def out(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """The stopped run, to go on with."""
    shutil.copytree(runs / "stopped", tmp_path / "out")
    capsys.readouterr()
    return tmp_path / "out"


def content(folder: Path) -> dict[str, bytes]:
    return {
        str(p.relative_to(folder)): p.read_bytes()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and p.name[0] != "."
    }


def edit(out: Path, old: str, new: str) -> None:
    path = out / "scene.toml"
    text, count = re.subn(old, new, path.read_text(encoding="utf-8"), flags=re.M)
    assert count == 1, text
    path.write_text(text, encoding="utf-8")


def refused(out: Path, status: int, capsys: pytest.CaptureFixture[str]) -> str:
    """The line of a resume that ends with that status and leaves the folder as it is."""
    before = content(out)
    assert cli.main(["resume", str(out)]) == status
    printed, err = capsys.readouterr()
    assert printed == "" and err.count("\n") == 1, err
    assert content(out) == before
    return err


def resumed(out: Path, runs: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """The error output of a resume that ends as the run without interruption."""
    assert cli.main(["resume", str(out)]) == 0
    assert_equal(read_history(out / "history.csv"), read_history(runs / "whole" / "history.csv"))
    return capsys.readouterr().err


# --- Edited scenes ---------------------------------------------------------------------------------

CHANGES = {
    "materials.soft.young": ("^young = 2000.0", "young = 200.0"),
    "materials.soft.like": ('^like = "pvdf"', 'like = "pzt4"'),
    "bodies.layer_2": ('^layer_2 = "soft"', 'layer_2 = "pvdf"'),
    "geometry.length": ("^length = 4.0", "length = 5.0"),
    "mesh.order": ("^order = 1", "order = 2"),
    "model.plane": ('^plane = "strain"', 'plane = "stress"'),
    "model.kinematics": ('^kinematics = "small"', 'kinematics = "finite"'),
    "boundaries[2].potential": ("^potential = 1.0", "potential = 1.5"),
    "boundaries": (r"^\[\[boundaries\]\]\non = \"bottom\"\npotential = 0.0\n", ""),
    "contact": (r"\Z", "\n[contact]\n"),
    "load.steps": (r"^steps = \[2, 4\]", "steps = [3, 4]"),
    "load.steps[1]": (r"^steps = \[2, 4\]", "steps = [2, 5]"),
    "load.factors.voltage[0]": (r"^voltage = \[1.0, 2.0\]", "voltage = [1.1, 2.0]"),
}


@pytest.mark.parametrize("key", CHANGES)
def test_an_edited_scene_is_refused(key: str, out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edit(out, *CHANGES[key])
    assert re.search(rf"scene\.toml: {re.escape(key)}.*: found .*with which the run began", refused(out, 2, capsys))


def test_fewer_steps_than_were_taken(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edit(out, r"^steps = \[2, 4\]", "steps = [1, 1]")
    assert "load.steps[0]: found 1; allowed: 2" in refused(out, 2, capsys)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('^title = "Beam"', 'title = "Another"'),
        ("^tolerance = 1e-08", "tolerance = 1e-10"),
        ('^fields = "all"', 'fields = "none"'),
        (r"^(steps = \[2, 4\])", "# a comment\n\\\\1"),
    ],
)
def test_what_may_change(old: str, new: str, out: Path, runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edit(out, old, new.replace("\\\\", "\\"))
    assert resumed(out, runs, capsys) == ""


def test_later_load_steps_may_change(out: Path) -> None:
    """A stage more, and steps of the present stage that are not taken yet."""
    edit(out, r"^steps = \[2, 4\]", "steps = [2, 4, 1]")
    edit(out, r"^voltage = \[1.0, 2.0\]", "voltage = [1.0, 2.0, -1.0]")
    assert cli.main(["resume", str(out)]) == 0
    history = read_history(out / "history.csv")
    assert [row["step"] for row in history] == list(range(1, STEPS + 2))
    assert history[-1]["mean_potential@top"] == pytest.approx(-1.0)
    # The longer run goes on too, and what was taken stays.
    edit(out, r"^voltage = .*", "voltage = [1.0, 2.0, -0.5]")
    assert cli.main(["resume", str(out)]) == 2


def test_the_log_says_that_the_run_was_resumed(out: Path, runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    resumed(out, runs, capsys)
    line = "resumed after step 3 on 1 rank, from a checkpoint of piezomat 0.0.7\n"
    assert line in (out / "log.txt").read_text(encoding="utf-8")


def test_a_mesh_file_and_a_folder_of_any_name(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The run has its own copy of the mesh, also where the path has characters of four bytes in UTF-8."""
    shutil.copy(runs / "whole" / "checkpoint" / "mesh.msh", tmp_path / "own.msh")
    text = re.sub("geometry = .*", 'geometry = { file = "own.msh" }', SCENE)
    (tmp_path / "own.toml").write_text(text, encoding="utf-8")
    out = tmp_path / "r 😀"
    with pytest.MonkeyPatch.context() as patch, pytest.raises(Stop):
        stop_after(patch, AFTER)
        run(Scene.load(tmp_path / "own.toml"), MPI.COMM_SELF, out)
    capsys.readouterr()
    (tmp_path / "own.msh").unlink()
    edit(out, r"/own\.msh", "/other.msh")
    assert "geometry.file: found" in refused(out, 2, capsys)
    edit(out, r"/other\.msh", "/own.msh")
    assert resumed(out, runs, capsys) == ""


def test_a_table_of_fibers_is_kept(tmp_path: Path) -> None:
    table, mesh, out = tmp_path / "fibers.csv", tmp_path / "out" / ".mesh.part.msh", tmp_path / "out"
    table.write_text("fiber,x,y,z,radius\na,0,0,0,0.5\na,1,0,0,0.5\nb,0,0,2,0.5\nb,1,0,2,0.5\n", encoding="utf-8")
    keys = {"geometry": {"shape": "fibers", "file": table}, "mesh": {"size": 0.2}, "bodies": {"*": "pvdf"}}
    scene = Scene(title="Fibers", boundaries=[{"on": "ends", "displacement": [0, 0, 0]}], **keys)
    out.mkdir()
    mesh.write_text("mesh")
    with Results(out, MPI.COMM_SELF) as results:
        results.start(scene.to_toml(), ["step"], mesh, table)
    table.unlink()
    again = of_run(out)
    assert again.body_names == ("a", "b") and again.geometry.file == table and again.to_toml() == scene.to_toml()


# --- Checkpoints -----------------------------------------------------------------------------------


def spoil(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 255
    path.write_bytes(data)


def test_a_damaged_checkpoint_falls_back_to_the_one_before(
    out: Path, runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spoil(out / "checkpoint" / "step_0003.npz")
    err = resumed(out, runs, capsys)
    assert "step_0003.npz is damaged" in err and err.count("\n") == 1
    log = (out / "log.txt").read_text(encoding="utf-8")
    assert "step_0003.npz is damaged" in log and "resumed after step 2 on 1 rank" in log
    assert [entry.step for entry in read_index(out / "fields.pvd")] == list(range(1, STEPS + 1))


def test_without_a_sound_checkpoint(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for step in (2, 3):
        spoil(out / "checkpoint" / f"step_{step:04d}.npz")
    assert "step_0003.npz is damaged" in refused(out, 1, capsys)


def test_another_mesh(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spoil(out / "checkpoint" / "mesh.msh")
    assert "mesh.msh is not the mesh that the run began with" in refused(out, 1, capsys)
    (out / "checkpoint" / "mesh.msh").unlink()
    assert "there is no mesh" in refused(out, 1, capsys)


def scalars(change: Callable[[dict[str, Any]], Any]) -> Callable[[dict[str, bytes]], None]:
    def apply(members: dict[str, bytes]) -> None:
        content = json.loads(members["content.json"])
        change(content["scalars"])
        members["content.json"] = json.dumps(content).encode()

    return apply


def array(name: str, change: Callable[[Any], Any]) -> Callable[[dict[str, bytes]], None]:
    def apply(members: dict[str, bytes]) -> None:
        file = io.BytesIO()
        np.save(file, change(np.load(io.BytesIO(members[name]))))
        members[name] = file.getvalue()

    return apply


VALUES = "nodal/state/values.npy"
FOREIGN: dict[str, Callable[[dict[str, bytes]], Any]] = {
    "no history": scalars(lambda s: s.pop("history")),
    "a history of another length": scalars(lambda s: s["history"].pop()),
    "a history that is none": scalars(lambda s: s.update(history={"step": 1})),
    "a size that is text": scalars(lambda s: s.update(size="1")),
    "no content": lambda members: members.pop("content.json"),
    "content that is none": lambda members: members.update({"content.json": b"[]"}),
    "nested content": lambda members: members.update({"content.json": b"[" * 10**5}),
    "no values": lambda members: members.pop(VALUES),
    "fewer values": array(VALUES, lambda v: v[:-1]),
    "other values at a node": array(VALUES, lambda v: v[:, :1]),
    "objects": array(VALUES, lambda v: v.astype(object)),
    "text": array(VALUES, lambda v: v.astype(str)),
    "a single number": array(VALUES, lambda v: np.float64(1.0)),
    "keys that are numbers": array("nodal/state/keys.npy", lambda k: k.astype(float)),
    "other keys": array("nodal/state/keys.npy", lambda k: k + 1000),
    "cut data": lambda members: members.update({VALUES: members[VALUES][:-8]}),
    "no array": lambda members: members.update({VALUES: b"nothing"}),
    "no forces": lambda members: [members.pop(f"nodal/forces/{name}.npy") for name in ("keys", "values")],
}


@pytest.mark.parametrize("what", FOREIGN)
def test_a_sound_archive_with_other_content(what: str, out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for path in (out / "checkpoint").glob("step_*.npz"):
        with zipfile.ZipFile(path) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        FOREIGN[what](members)
        with zipfile.ZipFile(path, "w") as archive:
            for name, data in members.items():
                archive.writestr(name, data)
    assert "step_0003.npz" in refused(out, 1, capsys)


# --- Other files -----------------------------------------------------------------------------------


@pytest.mark.parametrize("damage", [b"", b"<VTKFile><DataSet", b"\xff\xfe", b"<VTKFile/>", None])
def test_other_damaged_files_do_not_matter(
    damage: bytes | None, out: Path, runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("fields.pvd", "history.csv", "log.txt", "summary.json", "picture.png"):
        if damage is not None:
            (out / name).write_bytes(damage)
        else:
            (out / name).unlink(missing_ok=True)
    assert resumed(out, runs, capsys) == ""
    if damage not in (b"<VTKFile/>", None):  # an index of nothing is an index
        assert [entry.step for entry in read_index(out / "fields.pvd")] == list(range(1, STEPS + 1))


def test_the_checkpoint_is_enough(out: Path, runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (out / "scene.toml").read_text(encoding="utf-8")
    for path in out.iterdir():
        if path.name not in ("checkpoint", "fields"):
            path.unlink()
    shutil.rmtree(out / "fields")
    assert resumed(out, runs, capsys) == "" and (out / "scene.toml").read_text(encoding="utf-8") == before


def test_a_damaged_table_of_pairs(tmp_path: Path) -> None:
    """Names with separators of lines stay rows of their own; what is no row is left out."""
    names = ["a\x0b1-b", "a\u20281-b", "a\x851-b", 'a "b"\n1,c-d']
    with Results(tmp_path, MPI.COMM_SELF) as results:
        results.start("", ["step"])
        path, states = tmp_path / "pairs.csv", []
        for step in (1, 2, 3):
            results.row({"step": step})
            results.pairs(step, ["force"], [(name, [step / 3]) for name in names])
            states.append(path.read_bytes())
    whole = states[-1]
    with Results(tmp_path, MPI.COMM_SELF) as results:
        results.resume(["step"], 2)
        assert path.read_bytes() == states[1]
        results.row({"step": 3})
        results.pairs(3, ["force"], [(name, [1.0]) for name in names])
    assert path.read_bytes() == whole
    path.write_bytes(whole.replace(b"\n2,", b"\n2;").replace(b"0.333", b"0.3x3", 1) + b"4,\xff")
    with Results(tmp_path, MPI.COMM_SELF) as results:
        results.resume(["step"], 3)
    assert path.read_text(encoding="utf-8").count("0.333") == len(names) - 1
    assert "damaged rows are left out" in (tmp_path / "log.txt").read_text(encoding="utf-8")
    path.write_bytes(b"\x00" * 100)
    with Results(tmp_path, MPI.COMM_SELF) as results:
        results.resume(["step"], 2)
        results.pairs(3, ["force"], [("a-b", [1.0])])
    assert path.read_text(encoding="utf-8") == "step,pair,force\n3,a-b,1.0\n"
