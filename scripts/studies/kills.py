"""Runs that are killed at random moments and resumed on another number of ranks.

    .venv/bin/python -m scripts.studies.kills [--kills 30] [--seed 1]

Each run starts on 1 to 3 ranks and is ended by SIGKILL at a random moment: all of its processes, one rank, or mpirun
alone, whose ranks live on for a while. It is then resumed on another number of ranks, or started again where it had no
checkpoint yet. The table has a row a kill; the last column is the largest difference of a column of the history from
the run that nothing disturbed, divided by the scale of that column. The study goes on behind the rows of the table that
are there. The exit status is 1 if a run did not end, a file was damaged or something was left behind.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np

from piezomat.results.files import read_history
from scripts.studies.tables import append, rows
from tests.conftest import LAUNCH, bare_environment
from tests.histories import scales

ROOT = Path(__file__).parents[2]
TABLE = Path(__file__).parent / "maps" / "kills.csv"
COLUMNS = "kill ranks killed after_s outcome resumed_on refused left difference".split()
STEPS = 12
SCENE = (
    *("mesh.size=0.25", "mesh.contact_size=0.08", "solver.tolerance=1e-11"),
    # The bonds still hold at the end: once the fibers are apart, the voltage that remains is rounding.
    *("load.steps=[6,6]", "load.factors.press=[1.0,-0.3]"),
    *("output.fields=all", "output.picture=false"),
)
WAYS = ("all", "one rank", "mpirun")
EQUAL = 1e-8


def main() -> int:
    """Write the table, print it in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    chance = random.Random(options.seed)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        seconds = {}
        for ranks in (3, 1):
            began = time.monotonic()
            finish(folder, "whole", ranks, "run")
            seconds[ranks] = time.monotonic() - began
        seconds[2] = seconds[3]
        whole = read_history(folder / "whole" / "history.csv")
        for kill in range(1, options.kills + 1):
            drawn = draw(chance, seconds)
            if kill <= len(rows(TABLE)):
                continue
            row = killed_and_resumed(folder, kill, drawn, whole)
            append(TABLE, COLUMNS, row)
            print(" ".join(f"{name}={value}" for name, value in row.items()), flush=True)
    table = rows(TABLE)
    print("\n" + "\n".join(markdown(table)))
    return int(not all(right(row) for row in table))


def draw(chance: random.Random, seconds: dict[int, float]) -> tuple[int, int, str, float]:
    """Ranks at first and then, what is killed, and when (s)."""
    ranks = chance.choice((1, 2, 3))
    again = chance.choice([n for n in (1, 2, 3) if n != ranks])
    way = chance.choice(WAYS) if ranks > 1 else "all"
    return ranks, again, way, chance.uniform(0.0, seconds[ranks])


def killed_and_resumed(
    folder: Path, kill: int, drawn: tuple[int, int, str, float], whole: list[dict[str, Any]]
) -> dict[str, Any]:
    """One row of the table."""
    ranks, again, way, after = drawn
    name = f"kill_{kill}"
    out = folder / name
    process = start(folder, name, ranks, "run")
    time.sleep(after)
    end(process, way)
    process.communicate(timeout=120)
    before = len(history(out))
    damaged = damage(out)
    begun = list((out / "checkpoint").glob("step_*.npz"))
    refused = finish(folder, name, again, "resume" if begun else "run")
    found = read_history(out / "history.csv")
    ended = process.returncode == 0
    outcome = "had ended" if ended else f"resumed after {before}" if begun else "started again"
    if damaged or len(found) != STEPS:
        outcome = f"damaged: {damaged}" if damaged else f"ended after {len(found)} steps"
    left = [path for path in out.rglob(".*") if path.name != ".piezomat"]
    return {
        "kill": kill,
        "ranks": ranks,
        "killed": way,
        "after_s": f"{after:.2f}",
        "outcome": outcome,
        "resumed_on": again,
        "refused": refused,
        "left": len(left),
        "difference": f"{difference(found, whole):.1e}",
    }


def start(folder: Path, out: str, ranks: int, command: str) -> subprocess.Popen[str]:
    """A run into a folder, or its resume, on so many ranks."""
    words = ["run", "fibers_2d", "--out", out, "--set", *SCENE] if command == "run" else ["resume", out]
    launcher = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "OMPI_MCA_mpi_yield_when_idle": "1"}
    environment = bare_environment() | LAUNCH | threads | {"PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        [*launcher, sys.executable, "-m", "mpi4py", "-m", "piezomat", *words],
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def finish(folder: Path, out: str, ranks: int, command: str) -> int:
    """Run to the end; how often it was refused, since ranks of the run before still lived."""
    for refused in range(60):
        process = start(folder, out, ranks, command)
        _, err = process.communicate(timeout=600)
        if process.returncode == 0:
            return refused
        if "another run is at work" not in err:
            raise RuntimeError(f"{command} on {ranks} ranks: exit status {process.returncode}: {err}")
        time.sleep(0.5)
    raise RuntimeError("the folder stayed locked")


def end(process: subprocess.Popen[str], way: str) -> None:
    """SIGKILL to the process and those it has started, to the last one of these, or to it alone."""
    family = [process.pid, *descendants(process.pid)]
    for number in {"all": family, "one rank": family[-1:], "mpirun": family[:1]}[way]:
        try:
            os.kill(number, signal.SIGKILL)
        except ProcessLookupError:
            pass


def descendants(number: int) -> list[int]:
    """Processes started by a process, and by these."""
    try:
        children = Path(f"/proc/{number}/task/{number}/children").read_text().split()
    except OSError:
        return []
    return [one for child in map(int, children) for one in (child, *descendants(child))]


def history(out: Path) -> list[dict[str, Any]]:
    """The rows of history.csv, none where there is no such file."""
    return read_history(out / "history.csv") if (out / "history.csv").exists() else []


def damage(out: Path) -> str:
    """The first file under a final name that is not complete; empty where there is none."""
    readers = {
        ".json": lambda path: json.loads(path.read_text(encoding="utf-8")),
        ".csv": lambda path: [{len(row) for row in csv.reader(path.open(newline=""))}.pop()],
        ".npz": lambda path: np.load(path).files,
        ".pvd": ET.parse,
        ".vtu": ET.parse,
        ".vtp": ET.parse,
    }
    for path in sorted(out.rglob("[!.]*")):
        if path.suffix in readers and ".part" not in str(path):
            try:
                readers[path.suffix](path)
            except Exception as error:
                return f"{path.name}: {error}"
    return ""


def difference(found: list[dict[str, Any]], whole: list[dict[str, Any]]) -> float:
    """Largest difference of two histories over the scale of its column.

    `stabilization` is rounding here (1e-14); its scale is the stored energy.
    """
    worst = 0.0
    sizes = scales(whole)
    sizes["stabilization"] = sizes["elastic"]
    for name, scale in sizes.items():
        ours, theirs = (np.array([row[name] for row in table], float) for table in (found, whole))
        apart = np.abs(ours - theirs).max() if ours.shape == theirs.shape else np.inf
        worst = max(worst, float(np.nan_to_num(apart / (scale or 1.0), nan=np.inf)))
    return worst


def right(row: dict[str, str]) -> bool:
    """Whether the run ended as if it had not been killed."""
    good = row["outcome"].startswith(("resumed", "started", "had ended"))
    return good and row["left"] == "0" and float(row["difference"]) <= EQUAL


def markdown(table: list[dict[str, str]]) -> list[str]:
    """The table for the README: the kills by ranks, way and outcome, with the largest difference."""
    groups: dict[tuple[str, str], list[dict[str, str]]] = {}
    for row in table:
        groups.setdefault((row["ranks"], row["killed"]), []).append(row)
    head = "| ranks | killed | kills | started again | resumed | had ended | refused at first | largest difference |"
    lines = [head, "|--:|---|--:|--:|--:|--:|--:|--:|"]
    for (ranks, way), group in sorted(groups.items()):
        count = [sum(row["outcome"].startswith(word) for row in group) for word in ("started", "resumed", "had ended")]
        refused = sum(row["refused"] != "0" for row in group)
        worst = max(float(row["difference"]) for row in group)
        lines.append(f"| {ranks} | {way} | {len(group)} | {' | '.join(map(str, count))} | {refused} | {worst:.0e} |")
    return lines


if __name__ == "__main__":
    raise SystemExit(main())
