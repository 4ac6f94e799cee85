"""The examples under "How to extend" in app/README.md run as they stand, and each is short."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import bare_environment

ROOT = Path(__file__).parents[1]
LONGEST = 60  # lines


def examples() -> dict[str, str]:
    """The blocks of Python in that section, by the name of the file in their first line."""
    section = (ROOT / "app/README.md").read_text(encoding="utf-8").partition("\n## How to extend\n")[2]
    blocks = re.findall(r"^```python\n(.*?)^```$", section.partition("\n## ")[0], re.M | re.S)
    return {re.match(r'"""(\w+\.py): ', block)[1]: block for block in blocks}


def test_each_kind_of_extension_has_an_example() -> None:
    headings = re.findall(r"^### (.*)$", (ROOT / "app/README.md").read_text().partition("## How to extend")[2], re.M)
    assert headings == ["A material law", "A contact law", "An output", "A term", "A shape"]
    assert len(examples()) == len(headings)


@pytest.mark.parametrize("name", examples())
def test_an_example_runs(name: str, tmp_path: Path) -> None:
    text = examples()[name]
    assert len(text.splitlines()) <= LONGEST
    (tmp_path / name).write_text(text, encoding="utf-8")
    command = [sys.executable, name]
    done = subprocess.run(command, cwd=tmp_path, env=bare_environment(), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
