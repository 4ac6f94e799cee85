"""A scene is text: what its PETSc options may be, and that nothing else of a stranger's folder counts.

The sentences of "Scenes from others" in app/scenes/README.md have a test here each.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from piezomat import cli
from piezomat.scene import Scene, SceneError
from piezomat.solver.load_steps import Stepper
from piezomat.solver.newton import Newton
from tests.conftest import bare_environment
from tests.fuzz import MESH, MESH_SCENE

ROOT = Path(__file__).parents[2]
SHORT = ["output.picture=false", "output.fields=none"]


def call(folder: Path, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """The command line in a folder."""
    environment = bare_environment() | {"PYTHONPATH": str(ROOT)} | variables
    command = [sys.executable, "-m", "app", *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("pc_type", "python"),
        ("snes_type", "shell"),
        ("pc_composite_pcs", "jacobi,python"),
        ("fieldsplit_u_pc_type", "python"),
        ("pc_python_type", "os.abort"),
        ("snes_view", "ascii:mine.txt"),
        ("ksp_view_mat", "binary:mine"),
        ("ksp_monitor", "mine.txt"),
        ("ksp_monitor", ":mine.txt"),
        ("log_view", ""),
        ("options_file", "x"),
        ("malloc_dump", True),
        ("dll_append", "x.so"),
        ("pc_hypre_type", "/bin/sh"),
        ("mat_mumps_ooc_tmpdir", "here"),
        ("mat_mumps_icntl_1", 7),
        ("mat_mumps_icntl_22", 1),
        ("ksp_plot_eigenvalues", True),
        ("a b", 1),
        ("ksp_typ", "x y"),
        ("ksp_rtol", "abc"),
        ("ksp_rtol", -5),
        ("ksp_rtol", True),
        ("ksp_max_it", 1.5),
        ("ksp_gmres_restart", 10**12),
        ("mat_mumps_icntl_14", "abc"),
        ("pc_type", 3),
    ],
)
def test_options_that_no_scene_may_hold(option: str, value: object) -> None:
    with pytest.raises(SceneError) as error:
        Scene.load("stack", [f"solver.petsc={{ {json.dumps(option)} = {json.dumps(value)} }}"])
    assert error.value.key == f"solver.petsc.{option}"


@pytest.mark.parametrize(
    "option",
    [
        "ksp_monitor=",
        "snes_max_it=30",
        "ksp_rtol=1e-9",
        "pc_type=gamg",
        "mat_mumps_icntl_14=80",
        "mat_mumps_cntl_1=0.01",
    ],
)
def test_options_that_a_scene_may_hold(option: str) -> None:
    assert Scene.load("stack", [f"solver.petsc.{option}"]).solver.petsc


def test_at_most_as_many_options_as_petsc_can_hold() -> None:
    many = ", ".join(f"ksp_x{number} = 1" for number in range(600))
    with pytest.raises(SceneError, match=r"solver\.petsc: found 600 options; allowed: at most 64"):
        Scene.load("stack", [f"solver.petsc={{ {many} }}"])


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("ksp_typ=gmres", "solver.petsc.ksp_typ: found options that nothing uses"),
        ("pc_type=nonsense", "Unable to find requested PC type nonsense"),
        ("mat_mumps_icntl_99=1", "solver.petsc.mat_mumps_icntl_99: found options that nothing uses"),
    ],
)
def test_options_that_petsc_does_not_take_are_errors(option: str, words: str, tmp_path: Path) -> None:
    done = call(tmp_path, "run", "stack", "--out", "r", "--set", f"solver.petsc.{option}", *SHORT)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and words in done.stderr


def test_no_option_files_count(tmp_path: Path) -> None:
    for name in ("petscrc", ".petscrc"):
        (tmp_path / name).write_text("-snes_type nonsense\n-log_view ascii:mine.txt\n")
    for name in ("dolfinx_jit_options", "dolfinx_jit_parameters", "ffcx_options", "ffcx_parameters"):
        (tmp_path / f"{name}.json").write_text("{ no JSON")
    before = set(tmp_path.iterdir())
    done = call(tmp_path, "run", "stack", "--out", "r", "--set", *SHORT, HOME=str(tmp_path))
    assert done.returncode == 0 and done.stderr == ""
    assert {path.name for path in set(tmp_path.iterdir()) - before} <= {"r", ".cache", ".config", ".fltk"}


def test_whoever_has_started_petsc_keeps_its_options(tmp_path: Path) -> None:
    program = (
        "import petsc4py; petsc4py.init(['x', '-mine', '1'])\n"
        "import piezomat; piezomat.run\nfrom petsc4py import PETSc; print(PETSc.Options().getInt('mine'))"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert done.stdout == "1\n"


def test_options_of_the_users_own_environment_are_logged(tmp_path: Path) -> None:
    done = call(tmp_path, "run", "stack", "--out", "r", "--set", *SHORT, PETSC_OPTIONS="-mine 1")
    assert done.returncode == 0 and "PETSC_OPTIONS is set: -mine 1" in (tmp_path / "r" / "log.txt").read_text()


def test_a_mesh_or_a_table_is_read_from_where_the_scene_says_and_quoted_no_further(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("the password\n")
    for geometry in ("geometry.file", "geometry.shape='fibers'\ngeometry.file"):
        scene = f"{geometry} = '{secret}'\nmesh.size = 1\nbodies = {{ '*' = 'elastic' }}\n"
        (tmp_path / "scene.toml").write_text(scene)
        done = call(tmp_path, "plan", "scene.toml")
        assert done.returncode == 2 and "geometry.file" in done.stderr and "password" not in done.stderr


@pytest.mark.parametrize("character", ["\n", "\r", "\0", "\x1b", "\x0b", "\x85", "\u2028", "\u202e", "\u2067"])
def test_names_that_forge_a_line_of_a_table_a_log_or_a_terminal(character: str, tmp_path: Path) -> None:
    name = f"a{character}b"
    with pytest.raises(SceneError, match=r"planes\[0\]\.name"):
        Scene.load("random_mat", [f"planes.0.name={json.dumps(name)}"])
    assert refused_table(f'"{name}"', tmp_path).key == "geometry.file"
    assert refused_mesh(name, tmp_path).key == "geometry.file"


@pytest.mark.parametrize("first", ["=", "+", "-", "@"])
def test_names_that_a_spreadsheet_takes_for_a_formula(first: str, tmp_path: Path) -> None:
    name = f"{first}1+1"
    with pytest.raises(SceneError, match=r"planes\[0\]\.name.*formula"):
        Scene.load("random_mat", [f"planes.0.name={json.dumps(name)}"])
    for error in (refused_table(name, tmp_path), refused_mesh(name, tmp_path)):
        assert error.key == f"bodies.{name}" and "formula" in str(error)


def refused_table(name: str, folder: Path) -> SceneError:
    """The error of a table of fibers with this name."""
    (folder / "x.csv").write_text(f"fiber,x,y,z,radius\n{name},0,0,0,1\n{name},9,0,0,1\n", newline="")
    (folder / "scene.toml").write_text(
        'geometry = { shape = "fibers", file = "x.csv" }\nmesh.size = 1\nbodies = { "*" = "elastic" }\n'
        'boundaries = [{ on = "ends", displacement = [0, 0, 0] }]\n'
    )
    with pytest.raises(SceneError) as error:
        Scene.load(folder / "scene.toml")
    return error.value


def refused_mesh(name: str, folder: Path) -> SceneError:
    """The error of a mesh file with a body of this name."""
    (folder / "x.msh").write_text(MESH.replace('"body"', f'"{name}"'), newline="")
    (folder / "scene.toml").write_text(MESH_SCENE.replace("bodies.body", 'bodies."*"'))
    with pytest.raises(SceneError) as error:
        Scene.load(folder / "scene.toml")
    return error.value


def test_memory_and_time_are_bounded_as_long_as_the_scene_sets_no_bound_of_its_own() -> None:
    with pytest.raises(SceneError, match=r"mesh\.contact_size: found about .* cells.*what the memory here holds"):
        Scene.load("fibers_2d", ["mesh.contact_size=1e-5"])
    theirs = 10**10
    assert Scene.load("fibers_2d", ["mesh.contact_size=1e-5", f"mesh.max_cells={theirs}"]).mesh.max_cells == theirs


def test_plan_makes_the_mesh_solves_nothing_and_writes_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def solve(*given: object, **more: object) -> None:
        raise AssertionError("plan solves")

    for solver in (Newton, Stepper):
        monkeypatch.setattr(solver, "__init__", solve)
    monkeypatch.chdir(tmp_path)
    assert cli.main(["plan", "stack"]) == 0
    assert "cells" in capsys.readouterr().out and not list(tmp_path.iterdir())
