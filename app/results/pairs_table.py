"""pairs.csv of an interrupted run."""

from __future__ import annotations

import csv
import io
import logging
from pathlib import Path

log = logging.getLogger("piezomat")


def pairs_until(path: Path, last_step: int) -> str:
    """The text of a pairs.csv up to a step; rows that cannot be read are left out, with a warning."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    damaged = 0
    try:
        rows = list(csv.reader(io.StringIO(path.read_text(encoding="utf-8", errors="replace"), newline="")))
    except csv.Error:
        rows, damaged = [], 1
    if rows and rows[0][:2] == ["step", "pair"]:
        table.writerow(rows[0])
        for row in rows[1:]:
            try:
                if len(row) != len(rows[0]):
                    raise ValueError
                [float(value) for value in row[2:]]
                wanted = int(row[0]) <= last_step
            except ValueError:
                damaged += 1
                continue
            if wanted:
                table.writerow(row)
    elif rows:
        damaged = len(rows)
    if damaged:
        log.warning("%s: %d damaged rows are left out", path, damaged)
    return text.getvalue()
