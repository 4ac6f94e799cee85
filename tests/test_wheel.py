"""The wheel, installed elsewhere: it holds all that a run needs, and lives beside a user's own packages.

Nothing is downloaded: the wheel is built from a copy of the project with the setuptools that is there, and installed
without its dependencies into a new virtual environment, which sees those of this one.
"""

from __future__ import annotations

import csv
import shutil
import site
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import bare_environment

ROOT = Path(__file__).parents[1]
FOLDERS = ("app", "forms", "meshes")
RUN = ("run", "own_mesh", "--set", "load.steps=[2]", "load.factors.press=[0.1]", "output.picture=false", "--out")
# A user's own packages of these names come first on the path.
USER = """
import sys, app, forms, meshes
import piezomat
assert [m.OURS for m in (app, forms, meshes)] == ["app", "forms", "meshes"]
assert "dolfinx" not in sys.modules and "pydantic" not in sys.modules
scene = piezomat.Scene.load("own_mesh")
assert scene.body_names == ("left", "right", "above") and "pvdf" in piezomat.BUILT_IN
from mpi4py import MPI
assert "contact" in piezomat.plan(scene, MPI.COMM_SELF)
assert callable(piezomat.plan) and callable(piezomat.run)
print(piezomat.__file__, piezomat.__version__)
"""


def call(*command: str | Path, **options: Any) -> subprocess.CompletedProcess[str]:
    """A process that knows neither this one's MPI nor where the project lies."""
    environment = {name: value for name, value in bare_environment().items() if name != "PYTHONPATH"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, **options)
    assert done.returncode == 0, done.stderr
    return done


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of a copy of the project, in which no earlier build has left anything."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("dist")
    for folder in FOLDERS:
        shutil.copytree(ROOT / folder, source / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for file in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / file, source)
    offline = ("--no-deps", "--no-index", "--no-build-isolation", "--disable-pip-version-check")
    call(sys.executable, "-m", "pip", "wheel", "--quiet", *offline, "--wheel-dir", out, source)
    (file,) = out.glob("piezomat-*.whl")
    return file


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the programs of a virtual environment that has the wheel."""
    folder = tmp_path_factory.mktemp("venv")
    call(sys.executable, "-m", "venv", "--system-site-packages", "--without-pip", folder)
    python = folder / "bin" / "python"
    offline = ("--no-deps", "--no-index", "--disable-pip-version-check")
    call(sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--ignore-installed", *offline, wheel)
    # The dependencies of this environment; a path named in a .pth file is searched, but for .pth files in it (those
    # of the editable project).
    (packages,) = folder.glob("lib/python*/site-packages")
    (packages / "dependencies.pth").write_text("\n".join(site.getsitepackages()[:1]) + "\n", encoding="utf-8")
    return folder / "bin"


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """A working directory with a user's own packages of the names that the project's folders have."""
    for name in FOLDERS:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(f"OURS = '{name}'\n", encoding="utf-8")
    return tmp_path


def test_it_holds_every_module_and_scene(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    wanted = set()
    for folder in FOLDERS:
        package = Path("piezomat") if folder == "app" else Path("piezomat", folder)
        files = [*(ROOT / folder).rglob("*.py"), *(ROOT / folder / "scenes").glob("*.[tm][os][mh]*")]
        wanted |= {(package / file.relative_to(ROOT / folder)).as_posix() for file in files}
    assert "piezomat/scenes/own_mesh.msh" in wanted and "piezomat/scenes/stack.toml" in wanted
    assert wanted <= names
    assert {name for name in names if name.endswith(".py")} <= wanted  # and nothing of tests and scripts


@pytest.mark.slow
def test_import_beside_a_users_packages(installed: Path, elsewhere: Path) -> None:
    (elsewhere / "mine.py").write_text(USER, encoding="utf-8")
    place, version = call(installed / "python", "mine.py", cwd=elsewhere).stdout.split()
    assert Path(place).is_relative_to(installed.parent) and version == "0.1.0"


@pytest.mark.slow
def test_commands(installed: Path, elsewhere: Path) -> None:
    """The program and `python -m piezomat`, whose working directory comes first on Python's path."""
    assert "results in one" in call(installed / "piezomat", *RUN, "one", cwd=elsewhere).stdout
    assert len(list(csv.DictReader((elsewhere / "one" / "history.csv").open()))) == 2
    assert '"properties"' in call(installed / "python", "-m", "piezomat", "schema", cwd=elsewhere).stdout
