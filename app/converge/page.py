"""A convergence study as text and as a chart."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from piezomat.converge.study import Level, Study
from piezomat.pictures.plots import GREY, LABEL, TITLE, plain
from piezomat.results.atomic import replacing, write_text
from piezomat.results.units import unit_of

COLOURS = {1: ("#0072B2", "o"), 2: ("#D55E00", "s")}


def write(study: Study, out: Path) -> str:
    """Write converge.txt, converge.csv and converge.png in a folder; the text. Not collective."""
    text = as_text(study)
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / "converge.txt", text + "\n")
    write_text(out / "converge.csv", _csv(study))
    with replacing(out / "converge.png") as file:
        chart(study).savefig(file, dpi=150, format="png")
    return text


def as_text(study: Study) -> str:
    """Table of the runs, limits with their uncertainty, the cheapest setting within the tolerance, what was assumed."""
    columns, dimension = study.columns, study.scene.dimension
    head = ["order", "size", "contact_size", "unknowns", "time (s)"]
    head += [f"{name} ({unit_of(name, dimension)})" for name in columns] + ["error"]
    rows = []
    for level in [*study.series(1), *study.series(2)]:
        sizes = [f"{level.overrides[key]:g}" for key in ("mesh.order", "mesh.size", "mesh.contact_size")]
        worst = max((study.error(level, name) for name in columns), default=float("nan"))
        values = [f"{level.values[name]:.5g}" for name in columns]
        rows.append([*sizes, f"{level.unknowns:,}", f"{level.seconds:.1f}", *values, f"{100 * worst:.2g} %"])
    widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]
    lines = [study.scene.title, ""]
    lines += ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in [head, *rows]]
    lines += ["", *(_limit(study, name) for name in columns), "", *_answer(study), "", "Assumed:"]
    return "\n".join([*lines, *(f"- {text}" for text in assumptions(study))])


def _limit(study: Study, name: str) -> str:
    found, unit = study.reference(name), unit_of(name, study.scene.dimension)
    value = f"{name}: {found.value:.5g} {unit}".rstrip()
    if not np.isfinite(found.uncertainty):
        return f"{value}, on one mesh alone: nothing can be said of its error"
    within = f"+- {found.uncertainty:.2g} ({100 * study.uncertainty(name):.2g} %)"
    if found.power is None:
        few = max(len(study.series(order)) for order in (1, 2)) < 3
        why = "there are fewer than three meshes" if few else "the sequence is not regular"
        return f"{value} {within}: the finest value, NOT extrapolated, since {why}"
    return f"{value} {within}, extrapolated: the error falls with the power {found.power:.1f} of the mesh size"


def _answer(study: Study) -> list[str]:
    goal = f"{100 * study.within:g} %"
    level = study.cheapest()
    if level is None:
        uncertain = [name for name in study.columns if not study.uncertainty(name) <= study.within]
        if uncertain:
            return [
                f"No run is surely within {goal}: the limit of {', '.join(uncertain)} is not known as well. Give more "
                "time (--budget), or a larger tolerance."
            ]
        return [f"No run is within {goal}: finer meshes are needed than the time allowed."]
    return [f"Cheapest within {goal}, {level.seconds:.0f} s for the whole load: --set {_options(level)}"]


def _options(level: Level) -> str:
    return " ".join(f"{key}={value:g}" for key, value in level.overrides.items())


def assumptions(study: Study) -> list[str]:
    """What a study takes for granted, one sentence each."""
    total = sum(study.scene.load.steps)
    found = [
        f"values are compared at step {study.step} of {total}, where the force on what moves is largest on the "
        "coarsest mesh; later steps are not looked at",
        "all sizes of the mesh change together, and contact method and solver stay those of the scene",
        "times are those of this machine, scaled to the whole load by the Newton iterations of the coarsest mesh",
    ]
    if study.taken < study.step:
        found.append("each stage up to there is one load step, which gives the same on the coarsest mesh")
    contact = study.scene.contact
    grows = contact is not None and contact.normal_penalty is None
    if grows:
        found.append("penalties grow with finer facets, so that their error is part of the series")
    for name, change in study.penalty_change.items():
        much = f"ten times the normal penalty changes {name} by {100 * change:.2g} %"
        found.append(f"on the coarsest mesh {much}" if grows else f"{much}, which no mesh removes")
    return found + [f"not used: {text}" for text in study.failures]


def chart(study: Study) -> Figure:
    """Error against time, a panel for each column; the band is the uncertainty of the limit."""
    count = len(study.columns)
    figure = Figure(figsize=(4.6 * count, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    for place, name in enumerate(study.columns):
        ax = figure.add_subplot(1, count, place + 1)
        every = []
        for order, (colour, mark) in COLOURS.items():
            runs = study.series(order)
            times = [run.seconds for run in runs]
            errors = [max(100 * study.error(run, name), 1e-3) for run in runs]
            every += errors
            if runs:
                ax.plot(times, errors, color=colour, marker=mark, label=f"order {order}")
        uncertainty = 100 * study.uncertainty(name)
        if np.isfinite(uncertainty):
            ax.axhspan(
                1e-4, max(uncertainty, 1e-4), color=GREY, alpha=0.35, linewidth=0, label="uncertainty of the limit"
            )
        ax.axhline(100 * study.within, color="black", linestyle=":", label=f"{100 * study.within:g} %")
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_ylim(0.5 * min([*every, 100 * study.within]), 2.0 * max([*every, 100 * study.within]))
        ax.set_xlabel("time of the whole load (s)", **LABEL)
        ax.set_ylabel("distance from the limit (%)", **LABEL)
        ax.set_title(plain(name), **TITLE)
        ax.grid(True, which="both", color="#e4e4e4", linewidth=0.5)
        if place == 0:
            ax.legend(fontsize=9)
    figure.suptitle(plain(study.scene.title), fontsize=12, fontweight="bold")
    return figure


def _csv(study: Study) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["order", "size", "contact_size", "cells", "unknowns", "seconds", *study.columns])
    for level in [*study.series(1), *study.series(2)]:
        sizes = [level.overrides["mesh.size"], level.overrides["mesh.contact_size"]]
        values = [level.values[name] for name in study.columns]
        table.writerow([level.order, *sizes, level.cells, level.unknowns, level.seconds, *values])
    return text.getvalue()
