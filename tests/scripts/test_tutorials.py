"""Each tutorial runs as it stands, and so does each command under a question."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from piezomat import cli
from tests.conftest import bare_environment

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "scripts/tutorials"
README = FOLDER / "README.md"
MADE = {
    "first_run": ["force_over_displacement.png"],
    "parameter_study": ["study/sweep.csv", "study.png"],
    "metal_plates": ["plates.msh", "plates/summary.json"],
    "mat_as_sensor": ["mat_open/history.csv", "mat_short/report.html"],
    "pyvista_fields": ["crossed_fibers_section.png"],
}


def test_every_tutorial_is_listed() -> None:
    scripts = {path.stem for path in FOLDER.glob("*.py")}
    assert scripts == set(MADE) == set(re.findall(r"^\| `(\w+)\.py` \|", README.read_text(encoding="utf-8"), re.M))


@pytest.mark.slow
@pytest.mark.parametrize("name", MADE)
def test_a_tutorial_runs(name: str, tmp_path: Path) -> None:
    script = FOLDER / f"{name}.py"
    assert script.read_text(encoding="utf-8").count("\n# %% ") >= 3
    done = subprocess.run(
        [sys.executable, str(script)], cwd=tmp_path, env=bare_environment(), capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert all((tmp_path / made).stat().st_size > 200 for made in MADE[name])


def questions() -> dict[str, list[str]]:
    """The commands under each question."""
    sections = re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", README.read_text(encoding="utf-8"), re.M | re.S)
    return {title: re.findall(r"^    (piezomat .*)$", text, re.M) for title, text in sections}


def test_each_question_has_a_command_and_is_short() -> None:
    asked = questions()
    assert len(asked) == 10 and all(asked.values())
    sections = re.split(r"^## ", README.read_text(encoding="utf-8"), flags=re.M)[1:]
    assert all(len(section.strip().splitlines()) <= 12 for section in sections)


@pytest.mark.slow
def test_the_commands_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """In one folder, in their order: some read what others have written."""
    monkeypatch.chdir(tmp_path)
    for command in [command for commands in questions().values() for command in commands]:
        status = cli.main(shlex.split(command)[1:])
        out, err = capsys.readouterr()
        assert status == 0, f"{command}: {err}"
        if command.startswith("piezomat report short"):
            assert "effective d33" in out
        if command.startswith("piezomat report mat"):
            assert "V/kPa" in out
        if command.startswith("piezomat report stack"):
            assert "beyond the yield stress of 1 MPa" in out
