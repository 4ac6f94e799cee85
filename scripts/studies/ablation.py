"""Ablation: each heuristic of the solver taken away, each tuned constant changed, on a fixed set of cases.

    .venv/bin/python -m scripts.studies.ablation [OUT] [--cases NAME ...] [--switches WORDS ...] [--draw]

ablation.csv has a row a run, whose process is its own: processor seconds, linear solves, Newton iterations, cuts, and
the largest force. Runs that are in the table are not repeated. ablation.md is the table of the switches: sums over the
cases, relative to the solver as it is. Processor seconds scatter by a tenth, counts do not. --draw writes it alone.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from scripts.studies import tables
from scripts.studies.ablation_cases import CASES, switches
from scripts.studies.two_fibers import Failed, measured

COLUMNS = ["switch", "case", "outcome", "seconds", "linear_solves", "newton", "cutbacks", "force", "reason"]
AS_IT_IS = "as it is"
SAME_FORCE = 1e-3  # a force that differs by more is another answer


def row_of(switch: str, case: str) -> dict[str, Any]:
    """The row of one run."""
    here = {"switch": switch, "case": case}
    try:
        cost = measured([sys.executable, "-m", "scripts.studies.ablation", "--run", switch, case])
    except Failed as error:
        return here | {"outcome": "failed", "reason": str(error)[:200]}
    return here | {"outcome": "done", "seconds": f"{cost.seconds:.2f}"} | cost.answer


def run(switch: str, case: str) -> dict[str, Any]:
    """Run a case in this process with a switch set: its effort, and the largest force of its last step."""
    from mpi4py import MPI

    from piezomat.simulation import run as solve

    next(s for s in switches() if s.name == switch).set()
    history = solve(CASES[case](), MPI.COMM_WORLD).history
    effort = {name: sum(row[name] for row in history) for name in ("linear_solves", "newton", "cutbacks")}
    forces = [abs(value) for row in history for name, value in row.items() if name.startswith("force_")]
    return effort | {"force": max(forces)}


def table(rows: list[dict[str, str]]) -> str:
    """Markdown: a row a switch, sums over the cases that it and the solver as it is have both done, relative to it."""
    done = {(r["switch"], r["case"]): r for r in rows}
    lines = [
        "| | seconds | linear solves | iterations | cuts | failures | other answers | most affected |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for switch in dict.fromkeys(r["switch"] for r in rows):
        pairs = [
            (done[AS_IT_IS, r["case"]], r) for r in rows if r["switch"] == switch and (AS_IT_IS, r["case"]) in done
        ]
        solved = [(a, b) for a, b in pairs if a["outcome"] == b["outcome"] == "done"]
        failures = [b["case"] for a, b in pairs if a["outcome"] == "done" != b["outcome"]]
        others = [b["case"] for a, b in solved if abs(float(b["force"]) / float(a["force"]) - 1.0) > SAME_FORCE]
        if not solved:
            continue
        sums = {n: [sum(float(p[i][n]) for p in solved) for i in (0, 1)] for n in COLUMNS[3:7]}
        shares = [f"{sums[n][1] / sums[n][0]:.2f}" for n in COLUMNS[3:6]]
        worst = max(solved, key=lambda p: abs(float(p[1]["linear_solves"]) / float(p[0]["linear_solves"]) - 1.0))
        change = f"{worst[1]['case']}: {worst[0]['linear_solves']} to {worst[1]['linear_solves']} solves"
        affected = "" if worst[0]["linear_solves"] == worst[1]["linear_solves"] else change
        cuts = f"{sums['cutbacks'][0]:.0f} to {sums['cutbacks'][1]:.0f}"
        cells = [switch, *shares, cuts, ", ".join(failures), ", ".join(others), affected]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("out", nargs="?", type=Path, default=Path("results/ablation"))
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--switches", nargs="+", default=[""], help="parts of their names; default: all")
    parser.add_argument("--draw", action="store_true", help="only write the table of what is in OUT")
    parser.add_argument("--run", nargs=2, metavar=("SWITCH", "CASE"), help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.run:
        print(json.dumps(run(*given.run)))
        return
    given.out.mkdir(parents=True, exist_ok=True)
    file = given.out / "ablation.csv"
    done = {(row["switch"], row["case"]) for row in tables.rows(file)}
    chosen = [s.name for s in switches() if s.name == AS_IT_IS or any(part in s.name for part in given.switches)]
    for switch in [] if given.draw else chosen:
        for case in given.cases:
            if (switch, case) not in done:
                tables.append(file, COLUMNS, row_of(switch, case))
    (given.out / "ablation.md").write_text(table(tables.rows(file)), encoding="utf-8")


if __name__ == "__main__":
    main()
