"""The plots of a picture: contact pressure, and force and voltage over the load steps."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.ticker import MaxNLocator

from piezomat.forms.arrays import Array
from piezomat.pictures.data import ContactData, RunData, prefixed
from piezomat.results.vtk import STATUS

PRESSURE_COLOURS = "plasma"
GREY, DARK = "#b0b0b0", "#303030"
FORCE_COLOUR, VOLTAGE_COLOUR = "#1f4e9e", "#c2410c"
STATUS_COLOURS = dict(zip(STATUS, ("#c8c8c8", "#1f4e9e", "#2a9d6f", "#c2410c"), strict=True))
TITLE, LABEL = {"fontsize": 12}, {"fontsize": 11}
_FORCE = re.compile(r"(?P<contact>contact_)?force_(?P<axis>[xyz])@(?P<place>.+)")


def draw_pressure_2d(ax: Any, contact: ContactData, name_of: Callable[[int], str]) -> None:
    """Pressure over the position along the contact; several pairs are laid middle on middle.

    The eight pairs with the largest pressures are named.
    """
    factor, unit = prefixed(contact.pressure, "MPa")
    pairs = {int(number): contact.of(contact.pair == number) for number in np.unique(contact.pair)}
    pairs = {number: pair for number, pair in pairs.items() if pair.closed.any()}
    pairs = dict(sorted(pairs.items(), key=lambda item: -float(item[1].pressure.max())))
    axis = ""
    for order, (number, pair) in enumerate(pairs.items()):
        _, along, _ = pair.axes
        place, pressure = pair.position @ along, factor * pair.pressure
        low, high = place[pair.closed].min(), place[pair.closed].max()
        near = np.abs(place - (low + high) / 2) <= 0.7 * (high - low or 1.0)
        if len(pairs) == 1:
            axis = f"{direction_name(along)}, " if along.max() > 0.9999 else ""
            groups = [(pair.status == code, STATUS_COLOURS[text], text) for code, text in enumerate(STATUS)]
        else:
            place = place - (low + high) / 2
            name = plain(name_of(number)) if order < 8 else ""
            groups = [(~pair.closed, GREY, ""), (pair.closed, f"C{order % 10}", name)]
        for chosen, colour, text in groups:
            if (chosen & near).any():
                ax.plot(
                    place[chosen & near], pressure[chosen & near], "o", color=colour, markersize=4,
                    markeredgewidth=0, label=text or None, zorder=2 if colour == GREY else 3,
                )  # fmt: skip
    ax.axhline(0, color=DARK, linewidth=0.7, zorder=1)
    where = f"{axis}along the contact" if len(pairs) == 1 else "along each contact, from its middle"
    ax.set_xlabel(f"{where} (µm)", **LABEL)
    ax.set_ylabel(f"pressure ({unit})", **LABEL)
    ax.grid(True, color="#e4e4e4", linewidth=0.6)
    _head(ax, "Contact pressure", *ax.get_legend_handles_labels())


def draw_pressure_3d(ax: Any, contact: ContactData) -> None:
    """Closed contact points seen along the mean normal, coloured by the pressure; the bonded ones ringed."""
    normal, first, second = contact.axes
    places = contact.position @ np.column_stack([first, second])
    factor, unit = prefixed(contact.pressure, "MPa")
    values = factor * contact.pressure
    low, high = places[contact.closed].min(axis=0), places[contact.closed].max(axis=0)
    middle, half = (low + high) / 2, 0.5 * float((high - low).max()) * 1.35
    half = half or 1.0
    near = (np.abs(places - middle) <= half).all(axis=1)
    # in typographic points: dots of this size about cover a panel of 3.6 inches
    dot = float(np.clip(72 * 3.6 / np.sqrt(max(int(near.sum()), 1)), 2.0, 16.0))
    colours = Normalize(min(float(values[contact.closed].min()), 0.0), max(float(values.max()), 0.0))
    for code, status in enumerate(STATUS):
        chosen = near & (contact.status == code)
        style: dict[str, Any] = {"s": (0.35 * dot) ** 2, "color": STATUS_COLOURS[status], "linewidths": 0}
        if status in ("touching", "bonded"):
            ring = 1.2 if status == "bonded" else 0.0
            style = {"s": dot**2, "c": values[chosen], "cmap": PRESSURE_COLOURS, "norm": colours}
            style |= {"edgecolors": STATUS_COLOURS["bonded"], "linewidths": ring}
        if chosen.any():
            ax.scatter(*places[chosen].T, label=status, **style)
    bar = ax.figure.colorbar(ScalarMappable(colours, PRESSURE_COLOURS), ax=ax, pad=0.02, aspect=24)
    bar.set_label(f"pressure ({unit})", **LABEL)
    ax.set_aspect("equal")
    ax.set_xlim(middle[0] - half, middle[0] + half)
    ax.set_ylim(middle[1] - half, middle[1] + half)
    ax.xaxis.set_major_locator(MaxNLocator(6))
    ax.set_xlabel(f"{direction_name(first)} (µm)", **LABEL)
    ax.set_ylabel(f"{direction_name(second)} (µm)", **LABEL)
    title = f"Contact pressure, seen along {direction_name(normal)}"
    _head(ax, title, *ax.get_legend_handles_labels())


def force_curves(run: RunData) -> list[tuple[str, str]]:
    """Columns and labels of the forces to be shown: of each contact pair its largest component, else of the
    boundary with the largest force. None where all are zero but for rounding."""
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
    kept = {key: entry for key, entry in best.items() if entry[0] > noise}
    contacts = sorted((entry for (contact, _), entry in kept.items() if contact), reverse=True)[:4]
    boundaries = sorted((entry for (contact, _), entry in kept.items() if not contact), reverse=True)[:1]
    return [(name, text) for _, name, text in contacts or boundaries]


def electric_curve(run: RunData) -> tuple[str, str, str] | None:
    """Column, label and unit of the electric curve.

    The potential that varies most over the steps, of an electrode if there are any, else a mean; if none does, the
    charge that does; if neither does, the largest potential.
    """
    names = list(run.history[0]) if run.history else []
    largest: tuple[float, str] = (0.0, "")
    has_electrodes = any(name.startswith("voltage@") for name in names)
    of = ("voltage@", "voltage of") if has_electrodes else ("mean_potential@", "mean potential of")
    for prefix, text, unit in ((*of, "V"), ("charge@", "charge on", "pC")):
        ranges = []
        for name in names:
            if name.startswith(prefix):
                values = run.column(name)
                ranges.append((float(np.ptp(values)), name))
                if unit == "V":
                    largest = max(largest, (float(np.abs(values).max()), name))
        spread, name = max(ranges, default=(0.0, ""))
        if spread > 0:
            return name, plain(f"{text} {name.removeprefix(prefix)}"), unit
    if largest[0] > 0:
        return largest[1], plain(f"{of[1]} {largest[1].removeprefix(of[0])}"), "V"
    return None


def draw_curves(ax: Any, run: RunData, forces: list[tuple[str, str]], voltage: tuple[str, str, str] | None) -> None:
    """Force (left axis) and voltage or charge (right axis) over the load steps."""
    steps = run.column("step")
    per_depth = "/µm" if run.flat else ""
    lines = []
    if forces:
        factor, unit = prefixed(np.concatenate([run.column(name) for name, _ in forces]), f"µN{per_depth}")
        for (name, text), style in zip(forces, ("-o", "--o", ":o", "-.o"), strict=False):
            lines += _curve(ax, steps, factor * run.column(name), text, unit, FORCE_COLOUR, style)
        _colour_axis(ax, f"force ({unit})", FORCE_COLOUR)
    kind = ""
    if voltage:
        name, text, unit = voltage
        kind = "voltage" if unit == "V" else "charge"
        factor, unit = prefixed(run.column(name), unit if unit == "V" else unit + per_depth)
        other = ax.twinx() if forces else ax
        # one step: beside the other mark, not on it
        aside = 0.2 if len(steps) == 1 and forces else 0.0
        lines += _curve(other, steps + aside, factor * run.column(name), text, unit, VOLTAGE_COLOUR, "-s")
        _colour_axis(other, f"{'potential' if kind == 'voltage' else kind} ({unit})", VOLTAGE_COLOUR)
    words = ["force"] * bool(forces) + [kind] * bool(kind)
    ax.set_xlabel("load step", **LABEL)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    if len(steps) == 1:
        ax.set_xlim(steps[0] - 1, steps[0] + 1)
    elif run.step is not None and run.step != steps[-1]:
        shown = ax.axvline(run.step, color=DARK, linewidth=1.0, linestyle=":", zorder=0, label="step shown")
        lines.append(shown)
    ax.grid(True, color="#e4e4e4", linewidth=0.6)
    title = f"{' and '.join(words).capitalize()} over the load steps"
    _head(ax, title, lines, [line.get_label() for line in lines])


def _curve(ax: Any, steps: Array, values: Array, text: str, unit: str, colour: str, style: str) -> list[Any]:
    """A curve, with marks if there are few steps; a single mark carries its value."""
    style = style if len(steps) <= 60 else style[:-1]
    drawn = ax.plot(steps, values, style, color=colour, markersize=4 if len(steps) > 1 else 8, label=text)
    if len(steps) == 1:
        value = f"{values[0]:.4g} {unit}".replace("-", "−")
        ax.annotate(value, (steps[0], values[0]), (8, 0), textcoords="offset points", va="center", color=colour)
        ax.set_ylim(*sorted((0.0, 1.25 * float(values[0]))))
    return drawn


def _head(ax: Any, title: str, handles: list[Any], labels: list[str]) -> None:
    """Title, and between it and the panel, where it covers nothing, the legend."""
    for columns in (4, 3, 2, 1):
        # a legend is filled column by column; about 80 letters, 7 of them for a mark, are as wide as a panel
        lines = -(-len(labels) // columns)
        widths = [max(map(len, labels[i : i + lines])) + 7 for i in range(0, len(labels), max(lines, 1))]
        if sum(widths) <= 80:
            break
    ax.set_title(title, **TITLE, pad=8 + 15 * lines)
    ax.legend(
        handles, labels, fontsize=10, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False,
        ncols=columns, borderpad=0.2, columnspacing=1.4, handletextpad=0.5,
    )  # fmt: skip


def _colour_axis(ax: Any, label: str, colour: str) -> None:
    ax.set_ylabel(label, color=colour, **LABEL)
    ax.tick_params(axis="y", colors=colour)


def plain(text: str) -> str:
    """The text with dollar signs escaped, between which matplotlib reads formulas."""
    return text.replace("$", r"\$")


def direction_name(direction: Array) -> str:
    """Name of a direction in space: an axis if it is one."""
    largest = int(np.argmax(np.abs(direction)))
    if abs(direction[largest]) > 0.9999:
        return "xyz"[largest]
    return "direction ({:.2f}, {:.2f}, {:.2f})".format(*direction)
