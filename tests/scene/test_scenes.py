"""The shipped scenes and scripts: they run as their headers say, and closed forms give the numbers there."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat import simulation
from piezomat.results.fields import FieldOutput
from piezomat.results.files import read_history
from piezomat.scene import Scene
from piezomat.scene import toml as scene_file
from tests.conftest import bare_environment
from tests.verification import references as ref

ROOT = Path(__file__).parents[2]
SCENES = ROOT / "app" / "scenes"
EXAMPLES = scene_file.examples()
QUIET = ["output.fields=none", "output.picture=false"]
# Coarser meshes and fewer steps, for scenes that take more than a second.
SHORT = {
    "crossed_fibers": ["mesh.contact_size=0.1", "mesh.size=0.3", "load.steps=[6,3,6]"],
    "fibers_2d": ["mesh.contact_size=0.02", "mesh.size=0.15", "load.steps=[10,16]"],
    "fiber_array": ["mesh.contact_size=0.1", "load.steps=[4]"],
    "cross_ply": ["mesh.size=0.7", "mesh.contact_size=0.4", "load.steps=[2]"],
    "random_mat": [
        *("geometry.count=5", "geometry.width=8", "geometry.depth=8", "mesh.size=0.8", "mesh.contact_size=0.4"),
        *("contact.smoothing=false", "contact.passes=1", "planes.1.motion=[0,0,-0.4]", "load.steps=[2]"),
    ],
    "own_mesh": ["load.steps=[8]", "load.factors.press=[0.4]"],
}
MOST_ITERATIONS = 7
MANY_FIBERS = ("fiber_array", "cross_ply", "random_mat")  # each crossing opens and closes by itself


def header(name: str) -> str:
    """The comment that a shipped scene begins with."""
    lines = (SCENES / f"{name}.toml").read_text(encoding="utf-8").splitlines()
    return "\n".join(line for line in lines[: lines.index("")])


def run(name: str, *overrides: str) -> simulation.Run:
    """A shipped scene, run without results."""
    return simulation.run(Scene.load(name, [*QUIET, *overrides]), MPI.COMM_WORLD)


@cache
def short(name: str) -> list[dict[str, Any]]:
    """History of a shipped scene in its short form."""
    return run(name, *SHORT.get(name, [])).history


def column(history: list[dict[str, Any]], name: str) -> np.ndarray:
    """A column of a history."""
    return np.array([row[name] for row in history])


def call(*command: str | Path, **options: Any) -> subprocess.CompletedProcess[str]:
    """A program that knows nothing of the MPI that this process runs in."""
    environment = bare_environment() | {"PYTHONPATH": str(ROOT), "PYTHON": sys.executable} | options.pop("env", {})
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, **options)


def test_the_shipped_scenes() -> None:
    wanted = {"crossed_fibers", "fibers_2d", "blocks", "stack", "bimorph", "own_mesh", *MANY_FIBERS}
    assert set(EXAMPLES) == wanted


@pytest.mark.parametrize("name", EXAMPLES)
def test_header_says_how_to_run_it(name: str) -> None:
    text = header(name)
    assert all(line.startswith("#") for line in text.splitlines())
    assert re.search(r"^#     scripts/run\b", text, re.M) and "What to expect" in text


@pytest.mark.parametrize("name", EXAMPLES)
def test_plan(name: str) -> None:
    scene = Scene.load(name)
    text = simulation.plan(scene, MPI.COMM_WORLD)
    assert scene.title in text and "unknowns" in text
    assert ("one linear solve" in text) == (name == "bimorph")
    assert ("no potential, since" in text) == (name == "blocks")
    said = re.search(r"# ([\d,]+) unknowns", header(name))
    assert bool(said) == (name in ("crossed_fibers", "fibers_2d", "own_mesh"))
    if said:
        planned = int(re.search(r"^unknowns +(\d+)", text, re.M)[1])
        assert planned == pytest.approx(int(said[1].replace(",", "")), rel=0.05)  # gmsh's versions differ a little


@pytest.mark.parametrize("name", EXAMPLES)
def test_few_iterations(name: str) -> None:
    history = short(name)
    assert column(history, "newton").max() <= (25 if name in MANY_FIBERS else MOST_ITERATIONS)
    assert column(history, "cutbacks").max() == 0


# Of the planes of the mat five fibers cover a third; the rest is a capacitor of air beside them.
@pytest.mark.parametrize(
    ("name", "axis", "voltage"), [("fiber_array", "y", 1.0), ("cross_ply", "z", 1.0), ("random_mat", "z", 0.2)]
)
def test_what_presses_on_many_fibers_stands_on_the_floor(name: str, axis: str, voltage: float) -> None:
    last = short(name)[-1]
    assert last[f"force_{axis}@lid"] < -10.0 and last["voltage@lid"] > voltage
    assert last[f"force_{axis}@floor"] == pytest.approx(-last[f"force_{axis}@lid"], rel=1e-5)
    assert last["stabilization"] < 1e-3 * last["elastic"]


@pytest.mark.parametrize(("name", "force"), [("fibers_2d", "force_y@top"), ("crossed_fibers", "force_z@top")])
def test_fibers_stick_and_let_go(name: str, force: str) -> None:
    history = short(name)
    forces, voltage = column(history, force), column(history, "voltage@top")
    pressed, pulled = forces.argmin(), forces.argmax()
    assert history[pressed]["factor:press"] == 1.0 and forces[pressed] < 0.0 < voltage[pressed]
    assert pressed < pulled and forces[pulled] > 0.02 * -forces[pressed] and voltage[pulled] < 0.0
    assert column(history, "bonded_area@lower-upper")[pulled] > 0.0
    assert history[-1]["bonded_area@lower-upper"] == 0.0 and abs(forces[-1]) < 1e-6 * forces[pulled]
    if name == "fibers_2d":  # in 3D on this mesh the last bonds snap, which costs more work than they dissipate
        assert history[-1]["dissipated"] == pytest.approx(history[-1]["external_work"], rel=0.05)
    numbers = {float(n) for n in re.findall(r"[-+]?\d+\.\d+", header(name))}
    for found in (forces[pressed], forces[pulled], voltage[pressed], voltage[pulled]):
        assert min(abs(found / n - 1.0) for n in numbers if n * found > 0) < 0.3  # the mesh is much coarser


def test_stack_against_its_closed_form() -> None:
    layer = ref.Layer.of(ref.PVDF, 1.0)
    text = header("stack")
    for row, voltage in zip(np.array(short("stack"))[[3, 7]], (0.0, 1.0), strict=True):
        exact = ref.layer_stack([layer] * 2, -1e-3, voltage, 100 * layer.stiffness, 100 * layer.permittivity)
        pair = "lower_contact-upper_contact"
        assert row["mean_potential@top"] == pytest.approx(voltage)
        assert row["force_y@top"] == pytest.approx(exact.stress, rel=1e-7)
        assert row["charge@top"] == pytest.approx(-exact.displacement, rel=1e-7)
        assert row[f"max_penetration@{pair}"] == pytest.approx(-exact.gap, rel=1e-7)
        assert row[f"max_potential_jump@{pair}"] == pytest.approx(abs(exact.jump), rel=1e-6)
        for number in (f"{exact.stress:.6f}", *(f"{n:.6e}" for n in (exact.displacement, exact.gap, exact.jump))):
            assert number.replace("e-0", "e-") in text


def test_bimorph_against_its_closed_form() -> None:
    finished = run("bimorph")
    model = finished.model
    tip = np.isclose(model.unknowns.coordinates[:, 0], 1e5)
    deflection = finished.state.x.array.reshape(-1, model.unknowns.block)[tip, 1].mean()
    exact = ref.bimorph_deflection(ref.PVDF_TZOU, 1e5, 1e3, 1.0, coupled=True)
    assert deflection == pytest.approx(exact, rel=1e-3)
    assert f"{exact:.6f} um" in header("bimorph") and f"{deflection:.4f} um" in header("bimorph")
    assert f"{finished.history[-1]['charge@top']:.4f} pC/um" in header("bimorph")


def test_blocks_against_the_patch_test() -> None:
    exact = ref.contact_patch_stress(1e6, [0.5, 0.5], 0.01, 1e10)
    text = header("blocks")
    assert f"{exact:.2f} MPa" in text
    swapped = 'contact.pairs=[["lower_contact","upper_contact"]]'
    rows = {
        "point, two passes": (),
        "point, one pass": ("contact.passes=1",),
        "node, two passes": ("contact.method=node",),
        "node, one pass": ("contact.method=node", "contact.passes=1"),
        "the same, roles swapped": ("contact.method=node", "contact.passes=1", swapped),
    }
    for method, overrides in rows.items():
        finished = run("blocks", "load.steps=[1]", *overrides)
        stress = FieldOutput(finished.problem).piece().stress[:, 1]
        error, force = 100 * np.abs(stress / exact - 1.0).max(), finished.history[-1]["force_y@top"]
        said = re.search(rf"# +{method} +([\d.]+) % +(-[\d.]+)", text)
        assert error == pytest.approx(float(said[1]), rel=0.05), method
        assert force == pytest.approx(float(said[2]), rel=1e-6), method
        if not overrides:
            assert error < 0.1 and force == pytest.approx(exact, rel=1e-6)


def test_own_mesh_is_what_the_script_makes(tmp_path: Path) -> None:
    done = call(sys.executable, ROOT / "scripts" / "make_fiber_mesh.py", tmp_path / "own_mesh.msh", "--above", "0.3")
    assert done.returncode == 0, done.stderr
    assert "left, right, above" in done.stdout
    shutil.copy(SCENES / "own_mesh.toml", tmp_path)
    scene = Scene.load(tmp_path / "own_mesh.toml", [*QUIET, "load.steps=[8]", "load.factors.press=[0.4]"])
    assert scene.body_names == Scene.load("own_mesh").body_names
    row = simulation.run(scene, MPI.COMM_WORLD).history[-1]
    forces = [row[f"contact_force_y@{side}-above"] for side in ("left", "right")]
    assert forces[0] == pytest.approx(forces[1], rel=0.01) and sum(forces) == pytest.approx(row["force_y@top"])
    assert (SCENES / "own_mesh.msh").stat().st_size < 300_000


@pytest.mark.parametrize("wrong", [["mesh.vtk"], ["mesh.msh", "--radius", "0"], []])
def test_mesh_script_refuses(tmp_path: Path, wrong: list[str]) -> None:
    done = call(sys.executable, ROOT / "scripts" / "make_fiber_mesh.py", *wrong, cwd=tmp_path)
    assert done.returncode == 2 and "Traceback" not in done.stderr and not list(tmp_path.iterdir())


def test_results_are_read_without_piezomat(tmp_path: Path) -> None:
    scene = Scene.load("fibers_2d", [*SHORT["fibers_2d"], "load.steps=[4,4]", "output.picture=false"])
    simulation.run(scene, MPI.COMM_WORLD, tmp_path / "results")
    script = ROOT / "scripts" / "read_results.py"
    assert not re.search(r"^(from|import) (app|forms|meshes)\b", script.read_text(encoding="utf-8"), re.M)
    picture = tmp_path / "results" / "read_results.png"
    done = call(sys.executable, script, tmp_path / "results")
    assert done.returncode == 0, done.stderr
    assert "8 load steps" in done.stdout and "step 4\n" in done.stdout and "touching" in done.stdout
    assert picture.stat().st_size > 20_000
    wrong = call(sys.executable, script, tmp_path / "results", "--step", "99")
    assert wrong.returncode == 2 and "no fields of step 99" in wrong.stderr


def test_read_results_without_results(tmp_path: Path) -> None:
    done = call(sys.executable, ROOT / "scripts" / "read_results.py", tmp_path)
    assert done.returncode == 2 and "no history.csv" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.skipif(shutil.which("mpirun") is None, reason="no mpirun")
def test_batch_job(tmp_path: Path) -> None:
    script = ROOT / "scripts" / "batch.sh"
    assert call("bash", "-n", script).returncode == 0
    assert script.read_text(encoding="utf-8").splitlines()[1].startswith("#SBATCH ")
    command = ["bash", script, "stack", tmp_path / "results", "--set", "output.picture=false"]
    first = call(*command)
    assert first.returncode == 0, first.stderr
    assert "on 2 ranks" in first.stdout and first.stdout.count("step ") == 8
    last = read_history(tmp_path / "results" / "history.csv")[-1]
    assert last["force_y@top"] == pytest.approx(short("stack")[-1]["force_y@top"], rel=1e-8)
    # Done: not again. Without its end: resumed. Here the launcher only says what it is to launch.
    assert "is done" in call(*command, env={"LAUNCHER": "echo"}).stdout
    (tmp_path / "results" / "summary.json").unlink()
    again = call(*command, env={"LAUNCHER": "echo"}).stdout.splitlines()[-1]
    assert again == f"{sys.executable} -m mpi4py -m piezomat resume {tmp_path / 'results'}"
    # Killed before its first checkpoint: started again.
    for file in (tmp_path / "results" / "checkpoint").glob("step_*"):
        file.unlink()
    anew = call(*command, env={"LAUNCHER": "echo"}).stdout.splitlines()[-1]
    assert anew.startswith(f"{sys.executable} -m mpi4py -m piezomat run stack --out {tmp_path / 'results'} --set ")
    assert call("bash", script).returncode == 2
