"""Tables of studies: CSV files with a row a run, written as soon as its run has ended."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any


def rows(path: Path) -> list[dict[str, str]]:
    """The rows of a table, none if there is no table yet."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def append(path: Path, columns: Sequence[str], row: dict[str, Any]) -> None:
    """Append a row to a table, whose first line names the columns. Missing values stay empty."""
    new = not path.exists() or path.stat().st_size == 0
    with path.open("a", newline="") as file:
        table = csv.DictWriter(file, columns)
        if new:
            table.writeheader()
        table.writerow(row)
