"""The virtual environment keeps to the packages that DOLFINx was built with, and one line says where it does not."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import dolfinx.jit
import pytest

import piezomat
from piezomat import environment
from piezomat.forms import fenicsx

ROOT = Path(__file__).parents[1]
PINNED = Path(sys.prefix) / "debian.constraints"
made_by_setup = pytest.mark.skipif(not PINNED.is_file(), reason="not an environment of scripts/setup")


def pins(folder: Path, **versions: str) -> None:
    (folder / "debian.constraints").write_text("".join(f"{name}=={version}\n" for name, version in versions.items()))


def test_another_numpy_is_said_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "prefix", str(tmp_path / ".venv"))
    assert environment.hidden_packages() is None  # no environment of scripts/setup
    (tmp_path / ".venv").mkdir()
    pins(tmp_path / ".venv", numpy=metadata.version("numpy"), none_such="1.0")
    assert environment.hidden_packages() is None and environment.prepare(["run"]) is None
    pins(tmp_path / ".venv", numpy="0.1")
    words = environment.prepare(["run"])
    assert f"found numpy {metadata.version('numpy')}, where DOLFINx needs 0.1" in words
    assert words.endswith(f"type: {tmp_path / 'scripts' / 'setup'}") and "\n" not in words
    monkeypatch.delitem(vars(piezomat), "Scene", raising=False)
    with pytest.raises(ImportError, match=r"DOLFINx needs 0\.1"):
        _ = piezomat.Scene


def test_setup_sees_hidden_packages(tmp_path: Path) -> None:
    """The function of scripts/setup alone: what it finds is removed from the environment."""
    text = (ROOT / "scripts" / "setup").read_text(encoding="utf-8")
    function = text[text.index("setup_hidden_packages() {") :]
    function = function[: function.index("\n}\n") + 3]
    venv = tmp_path / "a b"
    packages = venv / "lib" / "python3.11" / "site-packages"
    packages.mkdir(parents=True)
    pins(venv, numpy="1.24.2", scipy="1.10.1")

    def found() -> list[str]:
        command = f'set -euo pipefail; venv="{venv}"\n{function}setup_hidden_packages'
        return subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=True).stdout.split()

    assert found() == []
    (packages / "scipy-1.10.1.dist-info").mkdir()
    (packages / "numpy_financial-2.0.dist-info").mkdir()
    assert found() == []
    (packages / "numpy-2.4.0.dist-info").mkdir()
    assert found() == ["numpy"]


@made_by_setup
def test_pip_keeps_to_them_whoever_configures_it(tmp_path: Path) -> None:
    uri = PINNED.as_uri()

    def told(*command: str, **variables: str) -> str:
        clean = {name: value for name, value in os.environ.items() if name != "PIP_CONSTRAINT"}
        run = subprocess.run([sys.executable, *command], env=clean | variables, capture_output=True, text=True)
        return run.stdout

    assert uri in told("-m", "pip", "config", "get", "install.constraint")
    show = ("-c", "import os; print(os.environ.get('PIP_CONSTRAINT'))")
    assert told(*show) == "None\n"
    assert told(*show, PIP_CONSTRAINT="mine.txt").split() == ["mine.txt", uri]
    assert told(*show, PIP_CONSTRAINT=f"mine.txt {uri}").split() == ["mine.txt", uri]


def test_a_run_waits_for_a_form_that_another_one_compiles() -> None:
    """Forms of bricks take more than the 10 s that DOLFINx waits by default, where many compile at once."""
    given = dolfinx.jit.get_options if fenicsx.NEW else dolfinx.jit.get_parameters
    assert given()["timeout"] == fenicsx.JIT_TIMEOUT >= 60
