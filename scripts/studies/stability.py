"""Maps of contact: where each method is right, converges to a wrong solution, or fails, and why.

    scripts/stability                             all maps, into results/stability: an hour or more on 2 cores
    scripts/stability out --maps penalty ratio    some of them, into another folder
    scripts/stability out --draw                  only draws the tables in out again

A map is a table NAME.csv with a row a cell (error, Newton iterations, cuts, seconds, reason) and a picture NAME.png.
Cells that are in the table are not run again. The methods are in stability_methods.py, scenes and references in
stability_maps.py.
"""

from __future__ import annotations

import argparse
import logging
import math
import multiprocessing
import time
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any
from unittest.mock import patch

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot
from matplotlib.colors import BoundaryNorm, ListedColormap
from mpi4py import MPI

from piezomat.contact import pair_laws
from piezomat.contact.interface_laws import with_equal_potential
from piezomat.forms.contact.laws.equal_potential import EqualPotential
from piezomat.forms.contact.laws.law import ContactLaw
from scripts.studies import tables
from scripts.studies.stability_map import Map
from scripts.studies.stability_maps import MAPS
from scripts.studies.stability_methods import METHODS

COLUMNS = ["method", "x", "y", "outcome", "error", "newton", "cutbacks", "seconds", "reason"]
# Told apart by colour-blind readers, and in grey: light, dark, white.
OUTCOMES = {"right": "#a9cfe8", "wrong": "#9a3b00", "failed": "#ffffff"}
WIDEST = 10.0  # inches of a picture
# Part of the reason of a failure -> its letter in a cell and what it means.
REASONS = {
    "needs more than": "N: Newton's method does not end",
    "flies away": "F: a body flies away",
    "nothing holds": "H: nothing holds a body",
    "singular": "S: singular",
    "kept moving": "P: the pairing does not settle",
}
OTHER = "O: other, see the table"


def minus_as_plus(*given: Any) -> ContactLaw:
    """The law with equal potentials with the sign as printed in the paper: a negative electric penalty."""
    law = with_equal_potential(*given)
    for part in law.summands():
        if isinstance(part, EqualPotential):
            part.penalty[:] *= -1.0
    return law


def run_cell(task: tuple[str, int, Any, Any]) -> dict[str, Any]:
    """Run one cell of a map; the row of its table."""
    from piezomat import simulation
    from piezomat.scene import SceneError

    name, column, x, y = task
    study, method = MAPS[name], METHODS[column]
    row: dict[str, Any] = {"method": method.name, "x": x, "y": y}
    start = time.perf_counter()
    try:
        sign = minus_as_plus if method.plus else with_equal_potential
        with patch.object(pair_laws, "with_equal_potential", sign):
            finished = simulation.run(study.scene(method, x, y), MPI.COMM_SELF)
        error = study.error(finished, x, y)
        row["outcome"] = "right" if error <= study.tolerance else "wrong"
        row["error"] = f"{error:.3g}"
        row["newton"] = sum(h["newton"] for h in finished.history)
        row["cutbacks"] = sum(h["cutbacks"] for h in finished.history)
    except (simulation.NotConverged, SceneError, ArithmeticError, ValueError) as failure:
        row |= {"outcome": "failed", "reason": " ".join(str(failure).split())}
    return {**row, "seconds": f"{time.perf_counter() - start:.2f}"}


def cells(study: Map, done: set[tuple[str, str, str]]) -> Iterator[tuple[str, int, Any, Any]]:
    """The cells of a map that are not in its table."""
    for column, method in enumerate(METHODS):
        if method.name not in study.methods:
            continue
        for y in study.y[1]:
            for x in study.x[1]:
                if (method.name, f"{x}", f"{y}") not in done:
                    yield study.name, column, x, y


def sweep(study: Map, out: Path, pool: Any) -> None:
    """Run the cells that are missing in the table; each row is written as soon as its cell has ended."""
    path = out / f"{study.name}.csv"
    done = {(row["method"], row["x"], row["y"]) for row in tables.rows(path)}
    todo = list(cells(study, done))
    for number, row in enumerate(pool.imap_unordered(run_cell, todo), 1):
        tables.append(path, COLUMNS, row)
        what = f"{row['method']}  {row['x']:g} {row['y']:g}  {row['outcome']}"
        print(f"{study.name} {number}/{len(todo)}  {what}", flush=True)


def letter(reason: str) -> str:
    """The letter of the reason of a failure and what it means."""
    return next((words for start, words in REASONS.items() if start in reason), OTHER)


def draw(study: Map, rows: list[dict[str, str]], path: Path) -> None:
    """A panel a method: green right, red wrong, grey failed; the number is the error in per cent."""
    found = {(row["method"], float(row["x"]), float(row["y"])): row for row in rows}
    methods = [m for m in METHODS if any(row["method"] == m.name for row in rows)]
    (x_name, xs), (y_name, ys) = study.x, study.y
    wide = 0.42 * len(xs) + 0.5
    columns = min(4, len(methods), max(1, int((WIDEST - 0.8) / wide)))
    lines = math.ceil(len(methods) / columns)
    figure, axes = pyplot.subplots(
        lines,
        columns,
        figsize=(columns * wide + 0.8, lines * (0.3 * len(ys) + 0.75) + 0.9),
        squeeze=False,
        sharex=True,
        sharey=True,
        layout="constrained",
    )
    kinds, letters = list(OUTCOMES), set()
    for axis, method in zip(axes.flat, methods, strict=False):
        image = [[math.nan] * len(xs) for _ in ys]
        for j, y in enumerate(ys):
            for i, x in enumerate(xs):
                row = found.get((method.name, float(x), float(y)))
                if row is None:
                    continue
                image[j][i] = kinds.index(row["outcome"])
                text = percent(row["error"]) if row["error"] else letter(row["reason"])[0]
                letters |= {letter(row["reason"])} if not row["error"] else set()
                colour = "white" if row["outcome"] == "wrong" else "black"
                axis.text(i, j, text, ha="center", va="center", fontsize=7, color=colour)
        norm = BoundaryNorm([-0.5, 0.5, 1.5, 2.5], 3)
        axis.imshow(image, cmap=ListedColormap(list(OUTCOMES.values())), norm=norm, aspect="auto", origin="lower")
        axis.set_title(method.name, fontsize=9)
        axis.set_xticks(range(len(xs)), [short(x) for x in xs], fontsize=7, rotation=90)
        axis.set_yticks(range(len(ys)), [short(y) for y in ys], fontsize=7)
    for axis in axes.flat[len(methods) :]:
        axis.set_visible(False)
    figure.suptitle(study.title, fontsize=11)
    key = (
        f"blue: within {100 * study.tolerance:g} % of: {study.reference}; dark: converged, but wrong; number: error, %"
    )
    if len(found) < len(methods) * len(xs) * len(ys):
        key += "; empty: not run"
    if letters:
        key += "\nwhite: failed. " + "; ".join(sorted(letters))
    figure.supxlabel(f"{x_name}\n{key}", fontsize=8)
    figure.supylabel(y_name, fontsize=8)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def short(value: float) -> str:
    """Label of a tick: a number, a fraction of small numbers, or a power of ten."""
    fraction = Fraction(value).limit_denominator(8)
    if fraction.denominator > 1 and fraction.numerator < 4 and abs(fraction - value) < 1e-9 and value != 0.5:
        return str(fraction)
    if value == 0.0 or 1e-3 <= value < 1e3:
        return f"{value:g}"
    return f"{value:.0e}".replace("e+0", "e").replace("e-0", "e-")


def percent(error: str) -> str:
    """An error in per cent, two digits at most."""
    value = 100.0 * float(error)
    return ">999" if value > 999 else f"{value:.0f}" if value >= 9.5 else f"{value:.1g}" if value >= 0.05 else "0"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("out", nargs="?", type=Path, default=Path("results/stability"))
    parser.add_argument("--maps", nargs="+", choices=list(MAPS), default=list(MAPS))
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--draw", action="store_true", help="only draw the tables in OUT")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    with multiprocessing.get_context("spawn").Pool(given.jobs, logging.disable, (logging.ERROR,)) as pool:
        for name in given.maps:
            if not given.draw:
                sweep(MAPS[name], given.out, pool)
            draw(MAPS[name], tables.rows(given.out / f"{name}.csv"), given.out / f"{name}.png")


if __name__ == "__main__":
    main()
