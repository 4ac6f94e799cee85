"""Ablation: each heuristic of the solver taken away, each tuned constant changed, on a fixed set of cases.

    .venv/bin/python -m scripts.studies.ablation [OUT] [--cases NAME ...] [--switches WORDS ...] [--draw]

ablation.csv has a row a run: processor seconds without the start of Python, linear solves, Newton iterations, cuts, and
the largest force. Runs that are in the table are not repeated. The runs of a case share a process. ablation.md is the
table of the switches: sums over the cases, relative to the solver as it is. Processor seconds scatter by a tenth,
counts do not. --draw writes it alone.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from time import process_time
from typing import Any

from scripts.studies import tables
from scripts.studies.ablation_cases import CASES, Switch, switches
from scripts.studies.two_fibers import ONE_THREAD, ROOT

COLUMNS = ["switch", "case", "outcome", "seconds", "linear_solves", "newton", "cutbacks", "force", "reason"]
AS_IT_IS = "as it is"
SAME_FORCE = 1e-3  # a force that differs by more is another answer
LONGEST = 40.0  # processor seconds of one run


def run(switch: Switch, case: str) -> dict[str, Any]:
    """Run a case in this process with a switch set: its row."""
    from mpi4py import MPI

    from piezomat.simulation import Interrupted, NotConverged
    from piezomat.simulation import run as solve

    row: dict[str, Any] = {"switch": switch.name, "case": case}
    before = process_time()
    signal.signal(signal.SIGPROF, lambda *_: os.kill(os.getpid(), signal.SIGTERM))
    signal.setitimer(signal.ITIMER_PROF, LONGEST)
    try:
        with switch.applied():
            history = solve(CASES[case](), MPI.COMM_WORLD, quiet=True).history
    except (NotConverged, Interrupted) as error:
        return row | {"outcome": "failed", "seconds": f"{process_time() - before:.2f}", "reason": str(error)[:200]}
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    effort = {name: sum(step[name] for step in history) for name in ("linear_solves", "newton", "cutbacks")}
    forces = [abs(value) for step in history for name, value in step.items() if name.startswith("force_")]
    return row | {"outcome": "done", "seconds": f"{process_time() - before:.2f}"} | effort | {"force": max(forces)}


def run_all(file: Path, case: str, chosen: list[Switch]) -> None:
    """Append the rows of a case with these switches to a table, in processes of their own."""
    while chosen:
        command = [sys.executable, "-m", "scripts.studies.ablation", "--run", case, *(s.name for s in chosen)]
        variables = {**os.environ, "PYTHONPATH": str(ROOT), **ONE_THREAD}
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=variables) as process:
            for line in process.stdout:
                if line.startswith("{"):
                    row = json.loads(line)
                    tables.append(file, COLUMNS, row)
                    chosen = [s for s in chosen if s.name != row["switch"]]
        if process.returncode and chosen:
            reason = f"exit status {process.returncode}"
            row = {"switch": chosen[0].name, "case": case, "outcome": "failed", "reason": reason}
            tables.append(file, COLUMNS, row)
            chosen = chosen[1:]


def table(rows: list[dict[str, str]]) -> str:
    """Markdown: a row a switch, sums over the cases that it and the solver as it is have both done, relative to it."""
    done = {(r["switch"], r["case"]): r for r in rows}
    lines = [
        "| | what it is for | seconds | linear solves | iterations | cuts | failures | other answers | most affected |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    purpose = {s.name: s.purpose for s in switches()}
    for switch in dict.fromkeys(r["switch"] for r in rows):
        pairs = [
            (done[AS_IT_IS, r["case"]], r) for r in rows if r["switch"] == switch and (AS_IT_IS, r["case"]) in done
        ]
        solved = [(a, b) for a, b in pairs if a["outcome"] == b["outcome"] == "done"]
        failures = [b["case"] for a, b in pairs if a["outcome"] == "done" != b["outcome"]]
        others = [b["case"] for a, b in solved if abs(float(b["force"]) / float(a["force"]) - 1.0) > SAME_FORCE]
        if not solved:
            lines.append(f"| {switch} | {purpose.get(switch, '')} |  |  |  |  | {', '.join(failures)} |  |  |")
            continue
        sums = {n: [sum(float(p[i][n]) for p in solved) for i in (0, 1)] for n in COLUMNS[3:7]}
        shares = [f"{sums[n][1] / sums[n][0]:.2f}" for n in COLUMNS[3:6]]
        worst = max(solved, key=lambda p: abs(float(p[1]["linear_solves"]) / float(p[0]["linear_solves"]) - 1.0))
        change = f"{worst[1]['case']}: {worst[0]['linear_solves']} to {worst[1]['linear_solves']} solves"
        affected = "" if worst[0]["linear_solves"] == worst[1]["linear_solves"] else change
        cuts = f"{sums['cutbacks'][0]:.0f} to {sums['cutbacks'][1]:.0f}"
        cells = [switch, purpose.get(switch, ""), *shares, cuts, ", ".join(failures), ", ".join(others), affected]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("out", nargs="?", type=Path, default=Path("results/ablation"))
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--switches", nargs="+", default=[""], help="parts of their names; default: all")
    parser.add_argument("--draw", action="store_true", help="only write the table of what is in OUT")
    parser.add_argument("--run", nargs="+", metavar=("CASE", "SWITCH"), help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.run:
        case, *names = given.run
        chosen = [s for s in switches() if s.name in names]
        run(chosen[0], case)  # what only the first run does in a process is not to be counted
        for switch in chosen:
            print(json.dumps(run(switch, case)), flush=True)
        return
    given.out.mkdir(parents=True, exist_ok=True)
    file = given.out / "ablation.csv"
    done = {(row["switch"], row["case"]) for row in tables.rows(file)}
    chosen = [s for s in switches() if s.name == AS_IT_IS or any(part in s.name for part in given.switches)]
    for case in [] if given.draw else given.cases:
        run_all(file, case, [s for s in chosen if case in s.cases and (s.name, case) not in done])
    (given.out / "ablation.md").write_text(table(tables.rows(file)), encoding="utf-8")


if __name__ == "__main__":
    main()
