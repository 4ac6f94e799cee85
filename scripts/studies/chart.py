"""Accuracy against processor seconds: every contact method, order 1 and 2, penalty and augmented, on four meshes each.

    scripts/chart                             all cases, into results/chart: some 30 minutes of a processor
    scripts/chart out --cases hertz           one of them, into another folder
    scripts/chart out --meshes 2              the two coarsest meshes of each curve alone (and the reference)
    scripts/chart --with ngsolve getfem       points of these programs too, installed if need be
    scripts/chart out --draw                  only draws the tables in out again

A case is a table NAME.csv with a row a run (a process, start-up and mesh included) and a picture NAME.png. Errors are
relative to the reference, a row of the table; those of the peak pressure are relative to Hertz at the force of the run.
Runs that are in the table are not run again. The cases are in chart_cases.py.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from piezomat.scene import Scene
from scripts.studies import tables
from scripts.studies.chart_cases import CASES, CURVES, ELECTRIC, NORMAL, Case, peak_pressure
from scripts.studies.other_programs import PROGRAMS, installed
from scripts.studies.two_fibers import Cost, Failed, measured, run_command, write_mesh

COLUMNS = ["curve", "size", "unknowns", "seconds", "memory_mb", "newton", "force", "potential", "pressure", "reason"]
# Of Okabe and Ito, whom colour-blind readers can tell apart; markers tell them apart in grey.
COLOURS = {"node": "#E69F00", "point": "#0072B2", "segment": "#CC79A7"}
MARKERS = {"node": "v", "point": "o", "segment": "s"}
FOREIGN = {"ngsolve": ("NGSolve", "D"), "getfem": ("GetFEM", "v")}
TRUTH = "reference"


def ours(scene: Scene) -> Cost:
    """A run of piezomat. Raises Failed."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "scene.toml"
        path.write_text(scene.to_toml(), encoding="utf-8")
        return measured(run_command(path))


def theirs(case: Case, size: float, program: tuple[list[str], dict[str, str]]) -> Cost:
    """A run of another program on the mesh of order 1. Raises Failed."""
    command, environment = program
    with tempfile.TemporaryDirectory() as scratch:
        path, mesh = Path(scratch) / "scene.toml", Path(scratch) / "mesh.msh"
        path.write_text(case.scene(CURVES[0], size).to_toml(), encoding="utf-8")
        write_mesh(path, mesh)
        penalties = [f"--normal={NORMAL / size!r}", f"--electric={ELECTRIC / size!r}"]
        return measured([*command, str(mesh), *penalties], environment)


def row(name: str, size: float, cost: Cost) -> dict[str, Any]:
    """A run's row of the table."""
    answer = cost.answer
    return {
        "curve": name,
        "size": size,
        "unknowns": answer["unknowns"],
        "seconds": f"{cost.seconds:.2f}",
        "memory_mb": f"{cost.memory:.0f}",
        "newton": sum(answer["newton"]),
        **{key: answer[key] for key in ("force", "potential", "pressure") if answer.get(key) is not None},
    }


def sweep(case: Case, out: Path, meshes: int, programs: dict[str, tuple[list[str], dict[str, str]]]) -> None:
    """Run the points that are missing in the table; each row is written as soon as its run has ended."""
    path = out / f"{case.name}.csv"
    done = {(row["curve"], row["size"]) for row in tables.rows(path)}
    foreign = programs if case.material == "pvdf" else {}
    sizes = case.sizes[:meshes]
    todo = [(TRUTH, case.finest), *((curve.name, size) for size in sizes for curve in CURVES)]
    todo += [(name, size) for size in sizes for name in foreign]
    by_name = {curve.name: curve for curve in CURVES}
    for name, size in todo:
        if (name, f"{size}") in done:
            continue
        try:
            if name in foreign:
                cost = theirs(case, size, foreign[name])
            elif name == TRUTH:
                cost = ours(case.reference())
            else:
                cost = ours(case.scene(by_name[name], size))
            found = row(name, size, cost)
        except Failed as failure:
            found = {"curve": name, "size": size, "reason": str(failure)}
        tables.append(path, COLUMNS, found)
        print(f"{case.name}  {name}  {size:g}  {found.get('reason') or found['seconds'] + ' s'}", flush=True)


def errors(case: Case, rows: list[dict[str, str]]) -> dict[str, list[tuple[float, float, float]]]:
    """Of each curve (seconds, relative error of the force, of the second quantity), coarsest mesh first."""
    truth = next((r for r in rows if r["curve"] == TRUTH and r["force"]), None)
    if truth is None:
        raise SystemExit(f"{case.name}: the reference failed; its row in the table says why")
    found: dict[str, list[tuple[float, float, float]]] = {}
    for r in sorted(rows, key=lambda r: -float(r["size"])):
        if r["curve"] == TRUTH or not r["force"]:
            continue
        right = peak_pressure(abs(float(r["force"]))) if case.second == "pressure" else float(truth[case.second])
        force = abs(float(r["force"]) / float(truth["force"]) - 1.0)
        second = abs(float(r[case.second]) / right - 1.0)
        found.setdefault(r["curve"], []).append((float(r["seconds"]), force, second))
    return found


def draw(case: Case, rows: list[dict[str, str]], path: Path) -> None:
    """Panels of force and second quantity, a row an order: a curve a method, dashed where augmented."""
    found = errors(case, rows)
    figure, axes = pyplot.subplots(2, 2, figsize=(10, 7.6), sharex=True, sharey="col")
    for order, pair in zip((1, 2), axes, strict=True):
        for axis, part, what in zip(pair, (1, 2), ("force", case.second), strict=True):
            for curve in (curve for curve in CURVES if curve.order == order):
                points = found.get(curve.name, [])
                style = {
                    "linestyle": "--" if curve.augmented else "-",
                    "linewidth": 3.0 if curve == case.choice else 1.2,
                }
                style |= {"color": COLOURS[curve.method], "marker": MARKERS[curve.method], "markersize": 6}
                axis.plot([p[0] for p in points], [p[part] for p in points], **style)
            for name, (_, marker) in FOREIGN.items() if order == 1 else ():
                points = found.get(name, [])
                axis.plot(
                    [p[0] for p in points], [p[part] for p in points], marker=marker, color="black", linewidth=0.8
                )
            label(axis, f"relative error of the {'peak ' if what == 'pressure' else ''}{what}")
            axis.set_title(f"order {order}", fontsize=10)
    for axis in axes[0]:
        axis.set_xlabel("")
    figure.suptitle(f"{case.title}\nbest for the time (thick): {case.choice.name}", fontsize=11)
    figure.legend(handles=legend(found), loc="lower center", ncol=4, fontsize=9, frameon=False)
    figure.tight_layout(rect=(0.0, 0.07, 1.0, 1.0))
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def label(axis: Axes, what: str) -> None:
    """Log axes, names and a grid."""
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.set_xlabel("processor seconds of the whole run")
    axis.set_ylabel(what)
    axis.grid(True, which="both", linewidth=0.3)


def legend(found: dict[str, Any]) -> list[Line2D]:
    """Handles that explain colours, markers and dashes, and the other programs in the table."""
    handles = [Line2D([], [], color=colour, marker=MARKERS[name], label=name) for name, colour in COLOURS.items()]
    dashes = (("-", "penalty"), ("--", "augmented"))
    handles += [Line2D([], [], color="grey", linestyle=line, label=name) for line, name in dashes]
    handles += [
        Line2D([], [], color="black", marker=marker, linewidth=0.8, label=f"{name}, order 1, penalty")
        for key, (name, marker) in FOREIGN.items()
        if key in found
    ]
    return handles


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="scripts/chart", description=__doc__.split("\n")[0])
    parser.add_argument("out", nargs="?", type=Path, default=Path("results/chart"))
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--meshes", type=int, choices=(1, 2, 3, 4), default=4, help="number of meshes of each curve")
    parser.add_argument("--with", dest="programs", nargs="+", choices=list(PROGRAMS), default=[], help="other programs")
    parser.add_argument("--draw", action="store_true", help="only draw the tables in OUT")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    programs = {} if given.draw else installed(given.programs)
    for name in given.cases:
        if not given.draw:
            sweep(CASES[name], given.out, given.meshes, programs)
        draw(CASES[name], tables.rows(given.out / f"{name}.csv"), given.out / f"{name}.png")


if __name__ == "__main__":
    main()
