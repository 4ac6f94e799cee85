"""The curves of a picture: force, and voltage or charge, over the travel of what moves, or over the load steps."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np
from matplotlib.ticker import MaxNLocator

from piezomat.pictures.data import RunData, prefixed
from piezomat.pictures.plots import DARK, LABEL, head, plain
from piezomat.results.units import symbols, unit_of
from piezomat.results.vtk import AXES, ResultsError
from piezomat.scene.errors import named, near, shown
from piezomat.scene.sections import SIDES

FORCE_COLOUR, VOLTAGE_COLOUR = "#0072B2", "#D55E00"
MOVING = 0.5  # least share of the steps in which something moves, for curves over its travel
_FORCE = re.compile(r"(?P<contact>contact_)?force_(?P<axis>[xyz])@(?P<place>.+)")


class Driver(NamedTuple):
    """What moves: the boundary or plane, the column of its motion, and that of the force on it."""

    place: str
    motion: str
    force: str


class Electric(NamedTuple):
    """A column of voltages or charges, its label and unit."""

    column: str
    label: str
    unit: str


def driver_of(run: RunData) -> Driver | None:
    """The plane or boundary that the scene moves or loads and that moves most; None where nothing does."""
    if len(run.history) < 2:
        return None
    found = []
    dimension = 2 if run.flat else 3
    for plane in run.scene.get("planes", []):
        if any(plane.get(key) is not None for key in ("motion", "force", "pressure")):
            direction = plane.get("normal") or _inward(plane["point"], dimension)
            found.append(Driver(plane["name"], f"travel@{plane['name']}", f"force_{_axis(direction)}@{plane['name']}"))
    for row in run.scene.get("boundaries", []):
        moved = [0.0 if isinstance(value, str) else value for value in row.get("displacement") or []]
        direction = moved if any(moved) else row.get("force") or row.get("traction") or []
        if any(direction):
            axis = _axis(direction)
            found.append(Driver(row["on"], f"displacement_{axis}@{row['on']}", f"force_{axis}@{row['on']}"))
    known = [d for d in found if {d.motion, d.force} <= set(run.history[0])]
    ranges = [float(np.ptp(run.column(d.motion))) for d in known]
    return known[int(np.argmax(ranges))] if max(ranges, default=0.0) > 0.0 else None


def abscissa(run: RunData, wanted: str | None) -> tuple[str, str]:
    """Column and label of the curves' x axis. ResultsError: there is no such column."""
    names = list(run.history[0]) if run.history else []
    if wanted is not None and wanted not in names:
        raise ResultsError(f"--x: found {shown(wanted)}; allowed: {named(names)}{near(wanted, names)}")
    driver = driver_of(run)
    moves = driver is not None and np.count_nonzero(np.diff(run.column(driver.motion))) > MOVING * (
        len(run.history) - 1
    )
    column = wanted or (driver.motion if moves else "step")
    if column == "step":
        return column, "load step"
    kind, _, place = column.partition("@")
    words = kind.replace("_", " ") + (f" of {place}" if place else "")
    unit = symbols(unit_of(column, 2 if run.flat else 3))
    return column, plain(f"{words} ({unit})" if unit else words)


def force_curves(run: RunData) -> list[tuple[str, str]]:
    """Columns and labels of the forces to be shown: that on what moves; else of each contact pair its largest
    component, else of the boundary with the largest force. None where all are zero but for rounding."""
    best: dict[tuple[bool, str], tuple[float, str, str]] = {}
    for name in run.history[0] if run.history else ():
        match = _FORCE.fullmatch(name)
        if match:
            key = (match["contact"] is not None, match["place"])
            largest = float(np.abs(run.column(name)).max())
            if largest > best.get(key, (0.0,))[0]:
                kind = "contact force," if key[0] else "force on"
                best[key] = (largest, name, plain(f"{kind} {match['place']}, {match['axis']}"))
    noise = 0.0
    if run.bodies is not None:
        dimension = 2 if run.bodies.flat else 3
        noise = 1e-9 * float(np.abs(run.bodies.stress).max()) * run.bodies.size ** (dimension - 1)
    driver = driver_of(run)
    if driver is not None and np.abs(run.column(driver.force)).max() > noise:
        axis = driver.force.partition("@")[0][-1]
        return [(driver.force, plain(f"force on {driver.place}, {axis}"))]
    kept = {key: entry for key, entry in best.items() if entry[0] > noise}
    contacts = sorted((entry for (contact, _), entry in kept.items() if contact), reverse=True)[:4]
    boundaries = sorted((entry for (contact, _), entry in kept.items() if not contact), reverse=True)[:1]
    return [(name, text) for _, name, text in contacts or boundaries]


def electric_curve(run: RunData) -> Electric | None:
    """The voltage of an open electrode, or the charge where all have a potential; else a mean potential.

    Of several the one that varies most over the steps; if none does, the largest potential.
    """
    given = {row["on"] for row in run.scene.get("boundaries", []) if row.get("potential") is not None}
    for section in ("planes", "electrodes"):
        given |= {row["name"] for row in run.scene.get(section, []) if row.get("potential") is not None}
    names = list(run.history[0]) if run.history else []
    voltages = [name for name in names if name.startswith("voltage@")]
    means = [name for name in names if name.startswith("mean_potential@")]
    charges = [name for name in names if name.startswith("charge@")]
    open_ones = [name for name in voltages if name.partition("@")[2] not in given]
    closed = len(given) > 1 and not open_ones
    driver = driver_of(run)
    if driver is not None and f"mean_potential@{driver.place}" in means and driver.place not in given:
        means = [f"mean_potential@{driver.place}"]  # ends and walls have one too
    kinds = [(voltages, "voltage of", "V")] if voltages else [(means, "mean potential of", "V")]
    kinds = [(charges, "charge on", "pC"), *kinds] if closed else [*kinds, (charges, "charge on", "pC")]
    for columns, words, unit in kinds:
        spread, name = max(((float(np.ptp(run.column(name))), name) for name in columns), default=(0.0, ""))
        if spread > 0.0:
            return Electric(name, plain(f"{words} {name.partition('@')[2]}"), unit)
    words, columns = ("voltage of", voltages) if voltages else ("mean potential of", means)
    largest, name = max(((float(np.abs(run.column(name)).max()), name) for name in columns), default=(0.0, ""))
    return Electric(name, plain(f"{words} {name.partition('@')[2]}"), "V") if largest > 0.0 else None


def draw_curves(
    ax: Any, run: RunData, forces: list[tuple[str, str]], electric: Electric | None, wanted: str | None = None
) -> None:
    """Force (left axis) and voltage or charge (right axis) over the travel of what moves, or another column."""
    column, label = abscissa(run, wanted)
    places = run.column(column)
    per_depth = "/µm" if run.flat else ""
    lines = []
    if forces:
        factor, unit = prefixed(np.concatenate([run.column(name) for name, _ in forces]), f"µN{per_depth}")
        for (name, text), style in zip(forces, ("-o", "--o", ":o", "-.o"), strict=False):
            lines += _curve(ax, places, factor * run.column(name), text, unit, FORCE_COLOUR, style)
        _colour_axis(ax, f"force ({unit})", FORCE_COLOUR)
    kind = ""
    other = ax
    if electric is not None:
        name, text, unit = electric
        kind = {"voltage": "voltage", "mean_potential": "potential", "charge": "charge"}[name.partition("@")[0]]
        voltages = run.column(name)
        if unit == "V":  # the unit of the bodies' potential, so that there is one throughout
            scale = voltages if run.bodies is None or run.bodies.potential is None else run.bodies.potential
            factor, unit = prefixed(scale, unit)
        else:
            factor, unit = prefixed(voltages, unit + per_depth)
        other = ax.twinx() if forces else ax
        # one step: beside the other mark, not on it
        aside = 0.2 if len(places) == 1 and forces else 0.0
        lines += _curve(other, places + aside, factor * voltages, text, unit, VOLTAGE_COLOUR, "-s")
        _colour_axis(other, f"{kind} ({unit})", VOLTAGE_COLOUR)
    words = ["force"] * bool(forces) + [kind] * bool(kind)
    ax.set_xlabel(label, **LABEL)
    if column == "step":
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    else:
        ax.xaxis.set_major_locator(MaxNLocator(6))
    if len(places) == 1:
        ax.set_xlim(places[0] - 1, places[0] + 1)
    elif run.step is not None and run.step != run.history[-1]["step"]:
        at = float(places[[row["step"] for row in run.history].index(run.step)])
        lines.append(ax.axvline(at, color=DARK, linewidth=1.0, linestyle=":", zorder=0, label="step shown"))
    ax.grid(True, color="#e4e4e4", linewidth=0.6)
    over = "the load steps" if column == "step" else label.rpartition(" (")[0] or label
    head(ax, f"{' and '.join(words).capitalize()} over {over}", lines, [line.get_label() for line in lines])


def _curve(ax: Any, places: Any, values: Any, text: str, unit: str, colour: str, style: str) -> list[Any]:
    """A curve, with marks if there are few steps; a single mark carries its value."""
    style = style if len(places) <= 60 else style[:-1]
    drawn = ax.plot(places, values, style, color=colour, markersize=4 if len(places) > 1 else 8, label=text)
    if len(places) == 1:
        value = f"{values[0]:.4g} {unit}".replace("-", "\N{MINUS SIGN}")
        ax.annotate(value, (places[0], values[0]), (8, 0), textcoords="offset points", va="center", color=colour)
        ax.set_ylim(*sorted((0.0, 1.25 * float(values[0]))))
    return drawn


def _colour_axis(ax: Any, label: str, colour: str) -> None:
    ax.set_ylabel(label, color=colour, **LABEL)
    ax.tick_params(axis="y", colors=colour)


def _axis(direction: Any) -> str:
    return AXES[int(np.argmax(np.abs(direction)))]


def _inward(side: Any, dimension: int) -> Any:
    return np.eye(dimension)[SIDES[dimension][side][0]]
