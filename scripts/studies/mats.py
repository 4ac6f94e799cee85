"""Studies of whole mats: cost over the number of fibers, seeds of a recipe, ranks, cooperativity.

    scripts/mats                                       all of them, into results/mats: hours on 2 cores
    scripts/mats out --studies growth --fibers 10 30   one of them, and for growth with which numbers of fibers
    scripts/mats out --draw                            only draws the tables in out again

A study is a table NAME.csv with a row a run. Runs that are in the table are not repeated. Each run is a process, and
its processor time and memory are measured.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import numpy as np
from matplotlib import pyplot

from piezomat.scene import Scene
from scripts.studies import tables

SIDE = 12.0 / np.sqrt(10.0)  # of the box (um) over the root of the number of fibers: that of the shipped scene
PRESSED = 0.2  # approach of the planes over the thickness of the mat
STEPS = 4
QUIET = {"output.picture": "false", "output.fields": "none"}
# The fewest contact points, for studies whose results do not depend on how round the fibers are.
CHEAP = {"contact.method": "node", "contact.smoothing": "false"}
ALIKE = 60.0  # force on a fiber, or on all of them together, at which voltages are compared, uN (2D: uN/um)
METER = 1e-3  # capacitance of an instrument, pC/(V um): 10 pF on fibers of 1 cm
# Sizes of elements over the scene's: 100 fibers have a million unknowns, or a tenth of that.
FINE, COARSE = 0.565, 1.6


@dataclass(frozen=True)
class Run:
    """One run of a study: its label, the shipped scene, the keys that differ from it, and the number of ranks."""

    label: dict[str, Any]
    scene: str
    keys: dict[str, Any]
    ranks: int = 1


def mat(count: int, seed: int, steps: int = STEPS, finer: float = 1.0) -> dict[str, Any]:
    """Keys of a piece of the shipped mat with `count` fibers, pressed to a fifth less than its thickness."""
    side = SIDE * np.sqrt(count)
    keys = {"geometry.count": count, "geometry.width": side, "geometry.depth": side, "geometry.seed": seed}
    scene = Scene.load("random_mat", [f"{key}={value}" for key, value in keys.items()])
    outcome = scene.geometry.outcome()
    approach = PRESSED * (outcome.high[2] - outcome.low[2])
    keys |= {"planes.1.motion": [0, 0, -approach], "load.steps": [steps]}
    keys |= {"mesh.size": finer * scene.mesh.size, "mesh.contact_size": finer * scene.mesh.contact_size}
    return keys | QUIET


def growth(fibers: list[int]) -> Iterator[Run]:
    """Equal meshes for all numbers of fibers; a negative number stands for the fine mesh, on two ranks.

    The fine mesh is solved to 1e-7: below it, contact of the loosest fibers, which only springs hold, keeps changing.
    """
    for count in fibers:
        fine = FINE if count < 0 else COARSE
        keys = mat(abs(count), 1, finer=fine) | ({"solver.tolerance": 1e-7} if count < 0 else {})
        yield Run({"fibers": abs(count), "finer": fine}, "random_mat", keys, 1 + (count < 0))


def seeds(fibers: list[int]) -> Iterator[Run]:
    """Fifty seeds of thirty fibers on a coarse mesh: the first step."""
    for seed in range(50):
        keys = mat(30, seed, finer=COARSE)
        keys |= {"load.steps": [1], "load.factors.press": [1.0 / STEPS]} | CHEAP
        yield Run({"seed": seed}, "random_mat", keys)


def ranks(fibers: list[int]) -> Iterator[Run]:
    """Twelve fibers on one to four ranks, solved to 1e-11: half of the approach."""
    for count in range(1, 5):
        keys = mat(12, 1, finer=COARSE) | {"load.steps": [2], "load.factors.press": [2.0 / STEPS]} | CHEAP
        yield Run({"on": count}, "random_mat", keys | {"solver.tolerance": 1e-11, "solver.kind": "direct"}, count)


def cooperativity(fibers: list[int]) -> Iterator[Run]:
    """Touching aligned fibers in 2D, in a row or in a column: pressed until each row has come 0.1 um nearer."""
    away = {}  # walls far outside, so that the row is free to spread
    for wall, inwards in ((2, 1), (3, -1)):
        away |= {f"planes.{wall}.point": [-99 * inwards, 0], f"planes.{wall}.normal": [inwards, 0]}
    for arrangement, columns, rows, walls in (
        ("row", 1, 0, away),
        ("row between walls", 1, 0, {}),
        ("column between walls", 0, 1, {}),
    ):
        for count in (1, 2, 4, 8, 16):
            shape = {"geometry.columns": count**columns, "geometry.rows": count**rows}
            keys = {"geometry.arrangement": "square", "planes.1.motion": [0, -0.1 * count**rows]} | shape | walls
            yield Run({"arrangement": arrangement, "count": count}, "fiber_array", keys | QUIET)


STUDIES = {"growth": growth, "seeds": seeds, "ranks": ranks, "cooperativity": cooperativity}
# Columns after those of the label.
COLUMNS = (
    "outcome ranks unknowns crossings smallest_gap thickness approach steps newton krylov cutbacks force voltage "
    "capacitance voltage_each capacitance_each voltage_total capacitance_total stabilized processor_seconds seconds "
    "memory_mb reason"
).split()


def value(thing: Any) -> str:
    """A value as `--set` reads it."""
    return json.dumps(thing) if isinstance(thing, list | bool) else str(thing)


def carry_out(run: Run, out: Path) -> dict[str, Any]:
    """Run and return the row of the table: results, or the reason of a failure."""
    sets = [f"{key}={value(thing)}" for key, thing in run.keys.items()]
    name = "-".join(f"{key}_{thing}" for key, thing in run.label.items())
    folder = out / f"{run.scene}-{name}"
    launcher = ["mpirun", "--oversubscribe", "-n", str(run.ranks)] if run.ranks > 1 else []
    command = [*launcher, sys.executable, "-m", "mpi4py", "-m", "piezomat", "run", run.scene, "--out", str(folder)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    ended = subprocess.run([*command, "--set", *sets], check=False, capture_output=True, text=True, env=bare())
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    row: dict[str, Any] = {**run.label, "ranks": run.ranks, "processor_seconds": f"{spent:.1f}"}
    row |= recipe(run.scene, sets)
    if "planes.1.motion" in run.keys:
        row["approach"] = f"{-run.keys['planes.1.motion'][-1]:.3g}"
    if ended.returncode not in (0, 3):
        return row | {"outcome": "failed", "reason": " ".join(ended.stderr.split())[-300:]}
    summary = json.loads((folder / "summary.json").read_text())
    row |= {"outcome": "converged" if summary["converged"] else "failed", "unknowns": summary["dofs"]}
    row |= {"memory_mb": f"{summary['peak_memory_mb']:.0f}", "reason": summary["reason"]}
    steps = summary["steps"]
    row["steps"] = len(steps)
    for column in ("newton", "krylov", "cutbacks"):
        row[column] = sum(step[column] for step in steps)
    row["seconds"] = f"{summary['timings']['total']:.1f}"
    if steps:
        last, up = steps[-1], "y" if "force_z@lid" not in steps[-1] else "z"
        forces = [-step[f"force_{up}@lid"] for step in steps]
        row["force"] = f"{forces[-1]:.9g}"
        if "voltage@lid" in last:
            row |= {"voltage": f"{last['voltage@lid']:.9g}", "capacitance": f"{last['capacitance']:.9g}"}
            across = run.keys.get("geometry.columns", 1)
            voltages, capacitances = ([step[name] for step in steps] for name in ("voltage@lid", "capacitance"))
            for what, total in (("each", ALIKE * across), ("total", ALIKE)):
                row[f"voltage_{what}"] = at(total, forces, voltages, 0.0)
                row[f"capacitance_{what}"] = at(total, forces, capacitances, capacitances[0])
        row["stabilized"] = f"{last['stabilization'] / (last['elastic'] + last['electric']):.2g}"
    return row


def at(force: float, forces: list[float], values: list[float], start: float) -> str:
    """A value at a force, interpolated between the steps from `start` on; empty if the force was not reached."""
    return f"{np.interp(force, [0.0, *forces], [start, *values]):.6g}" if forces[-1] >= force else ""


def bare() -> dict[str, str]:
    """The environment without the variables of MPI, so that a child process is not a rank of this one."""
    ours = ("OMPI_COMM", "OMPI_MCA", "OMPI_UNIVERSE", "PMI", "PRTE_", "SLURM_")
    return {name: thing for name, thing in os.environ.items() if not name.startswith(ours)} | {"OMP_NUM_THREADS": "1"}


def recipe(scene: str, sets: list[str]) -> dict[str, Any]:
    """Columns about the geometry: crossings, smallest gap, thickness."""
    outcome = Scene.load(scene, sets).geometry.outcome()
    gap = "" if outcome.smallest_gap is None else f"{outcome.smallest_gap:.3g}"
    thickness = outcome.high[-1] - outcome.low[-1]
    return {"crossings": outcome.crossings, "smallest_gap": gap, "thickness": f"{thickness:.4g}"}


def study(name: str, runs: list[Run], out: Path) -> None:
    """Carry out the runs that are missing in the table; each row is written as soon as its run has ended."""
    path = out / f"{name}.csv"
    for run in runs:
        label = {key: str(thing) for key, thing in run.label.items()}
        if any(all(row[key] == thing for key, thing in label.items()) for row in tables.rows(path)):
            continue
        row = carry_out(run, out / "runs")
        tables.append(path, [*label, *COLUMNS], row)
        print(name, label, row["outcome"], row["processor_seconds"], "s", row["reason"], flush=True)


def exponent(x: np.ndarray, y: np.ndarray) -> float:
    """Growth of y with x: the slope of a line through their logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0]) if len(x) > 1 else float("nan")


def draw_growth(rows: list[dict[str, str]], path: Path) -> None:
    """Processor time and memory an unknown over the number of fibers."""
    rows = sorted(
        (r for r in rows if r["outcome"] == "converged" and r["ranks"] == "1"), key=lambda r: int(r["fibers"])
    )
    fibers, unknowns, seconds, memory = (
        np.array([float(row[key]) for row in rows]) for key in ("fibers", "unknowns", "processor_seconds", "memory_mb")
    )
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
    for axis, total, unit in ((left, 1e3 * seconds, "ms processor time"), (right, 1e3 * memory, "kB")):
        axis.plot(fibers, total / unknowns, "o-", color="#0072B2")
        axis.set_xscale("log")
        axis.set_ylim(0.0, 1.15 * (total / unknowns).max(initial=0.0) or 1.0)
        axis.set_xticks(fibers, [f"{count:g}" for count in fibers])
        axis.minorticks_off()
        axis.set_xlabel("fibers")
        axis.set_ylabel(f"{unit} an unknown")
        axis.set_title(f"total: unknowns to the power of {exponent(unknowns, total):.2f}", fontsize=9)
    figure.suptitle("Mats pressed to a fifth less than their thickness", fontsize=11)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def draw_cooperativity(rows: list[dict[str, str]], path: Path) -> None:
    """Charge, capacitance and voltage of touching fibers over their number, over those of one that is alone."""
    figure, axes = pyplot.subplots(1, 4, figsize=(11, 3.9), sharex=True, sharey=True)
    alone = electric(next(r for r in rows if r["arrangement"] == "row" and r["count"] == "1"), "each")
    titles = ("charge (short circuit)", "capacitance", "voltage (open)", "voltage with a meter")
    curves = (
        ("row", "each", "o-", "#0072B2", "row, same force on each"),
        ("row", "total", "o--", "#0072B2", "row, same total force"),
        ("column between walls", "each", "^-", "#000000", "column, same force"),
    )
    for arrangement, what, style, colour, name in curves:
        chosen = [r for r in rows if r["arrangement"] == arrangement and r[f"voltage_{what}"]]
        count = [int(r["count"]) for r in chosen]
        found = np.array([electric(r, what) for r in chosen]) / alone
        for axis, values, title in zip(axes, found.T, titles, strict=True):
            inside = "white" if "--" in style else colour
            axis.plot(count, values, style, color=colour, label=name, markerfacecolor=inside)
            axis.set_title(title, fontsize=10)
            axis.set_xlabel("touching aligned fibers")
            axis.grid(True, color="#e4e4e4", linewidth=0.6)
    axes[0].set_xscale("log", base=2)
    axes[0].set_yscale("log", base=2)
    axes[0].set_xticks([2**n for n in range(5)])
    axes[0].set_yticks([4.0**n for n in range(-2, 3)])
    for ticks in (axes[0].xaxis, axes[0].yaxis):
        ticks.set_major_formatter("{x:g}")
    axes[0].set_ylabel("over that of one fiber")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncol=3, fontsize=9, frameon=False)
    figure.suptitle(f"{ALIKE:g} uN on each um of a fiber; meter: 10 pF on fibers of 1 cm", fontsize=11)
    figure.tight_layout(rect=(0.0, 0.07, 1.0, 1.0))
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def electric(row: dict[str, str], what: str) -> tuple[float, float, float, float]:
    """Charge in a short circuit, capacitance, voltage, and voltage with a meter in parallel, at a force."""
    voltage, capacitance = float(row[f"voltage_{what}"]), float(row[f"capacitance_{what}"])
    charge = voltage * capacitance
    return charge, capacitance, voltage, charge / (capacitance + METER)


DRAWINGS = {"growth": draw_growth, "cooperativity": draw_cooperativity}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("out", nargs="?", type=Path, default=Path("results/mats"))
    parser.add_argument("--studies", nargs="+", choices=list(STUDIES), default=list(STUDIES))
    parser.add_argument("--fibers", nargs="+", type=int, default=[10, 30, 100], help="of growth; -100: finer, 2 ranks")
    parser.add_argument("--draw", action="store_true", help="only draw the tables in OUT")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    for name in given.studies:
        if not given.draw:
            study(name, list(STUDIES[name](given.fibers)), given.out)
        rows = tables.rows(given.out / f"{name}.csv")
        if name in DRAWINGS and rows:
            DRAWINGS[name](rows, given.out / f"{name}.png")


if __name__ == "__main__":
    main()
