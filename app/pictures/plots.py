"""The plots of contact pressure: over the position along the contact, or on a map of the contact points."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.ticker import MaxNLocator

from piezomat.forms.arrays import Array
from piezomat.pictures.data import Bodies, ContactData, prefixed
from piezomat.pictures.lengths import Lengths, direction_name
from piezomat.results.vtk import STATUS

PRESSURE_COLOURS = "plasma"
GREY, DARK = "#b0b0b0", "#303030"
# Of Okabe and Ito, whom colour-blind readers can tell apart.
STATUS_COLOURS = dict(zip(STATUS, ("#c8c8c8", "#0072B2", "#E69F00", "#CC79A7"), strict=True))
PAIR_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7")
TITLE, LABEL = {"fontsize": 12}, {"fontsize": 11}
MANY = 6.0  # largest dots of many pairs, in typographic points
ALONG = 0.94  # least cosine of a contact's normal and an axis, along which the contact is then seen


def draw_pressure_2d(
    ax: Any, contact: ContactData, name_of: Callable[[int], str], bodies: Bodies | None, lengths: Lengths
) -> None:
    """Pressure over the position along the contact, up to four pairs middle on middle; of more, a map."""
    pairs = {int(number): contact.of(contact.pair == number) for number in np.unique(contact.pair)}
    pairs = {number: pair for number, pair in pairs.items() if pair.closed.any()}
    if len(pairs) > len(PAIR_COLOURS) and bodies is not None:
        points = bodies.points + bodies.displacement
        edges = points[bodies.outline][:, :, :2]
        ax.add_collection(LineCollection(edges, color=GREY, linewidth=0.8, zorder=1))
        _map(ax, contact.of(contact.closed), np.eye(3)[0], np.eye(3)[1], lengths, points, MANY)
        head(ax, f"Contact pressure of {len(pairs)} pairs", [], [])
        return
    factor, unit = prefixed(contact.pressure, "MPa")
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
            name = plain(name_of(number))
            groups = [(~pair.closed, GREY, ""), (pair.closed, PAIR_COLOURS[order % len(PAIR_COLOURS)], name)]
        for chosen, colour, text in groups:
            if (chosen & near).any():
                ax.plot(
                    place[chosen & near], pressure[chosen & near], "o", color=colour, markersize=4,
                    markeredgewidth=0, label=text or None, zorder=2 if colour == GREY else 3,
                )  # fmt: skip
    ax.axhline(0, color=DARK, linewidth=0.7, zorder=1)
    lengths.label(ax.xaxis, f"{axis}along the contact" if len(pairs) == 1 else "along each contact, from its middle")
    ax.set_ylabel(f"pressure ({unit})", **LABEL)
    ax.grid(True, color="#e4e4e4", linewidth=0.6)
    head(ax, "Contact pressure", *ax.get_legend_handles_labels())


def draw_pressure_3d(ax: Any, contact: ContactData, bodies: Bodies | None, lengths: Lengths) -> None:
    """Closed contact points coloured by their pressure, seen along the axis nearest to the contact's normal.

    Of one pair the bonded points are ringed, and those that are apart are grey; of several the bodies are grey behind.
    """
    normal, first, second = contact.axes
    upright = int(np.argmax(np.abs(normal)))
    if abs(normal[upright]) > ALONG or len(np.unique(contact.pair[contact.closed])) > 1:
        across = [axis for axis in range(3) if axis != upright]
        first, second = np.eye(3)[across]
        seen = f"seen along {'xyz'[upright]}"
    else:
        seen = "seen along its normal"
    one = len(np.unique(contact.pair[contact.closed])) == 1
    if one or bodies is None:
        _map(ax, contact, first, second, lengths, None, 16.0)
        head(ax, f"Contact pressure, {seen}", *ax.get_legend_handles_labels())
        return
    points = bodies.points + bodies.displacement
    behind = points @ np.column_stack([first, second])
    ax.scatter(*behind.T, s=3.0, color="#e4e4e4", linewidths=0, zorder=1, rasterized=True)
    _map(ax, contact.of(contact.closed), first, second, lengths, points, MANY)
    head(ax, f"Contact pressure of {len(np.unique(contact.pair[contact.closed]))} pairs, {seen}", [], [])


def _map(
    ax: Any, contact: ContactData, right: Any, up: Any, lengths: Lengths, around: Array | None, largest: float
) -> None:
    """Contact points in the plane of two directions, as dots of at most so many typographic points.

    around (n, 3): points that the limits are those of; None: the contact points.
    """
    places = contact.position @ np.column_stack([right, up])
    factor, unit = prefixed(contact.pressure, "MPa")
    values = factor * contact.pressure
    closed = contact.closed
    if around is None:
        low, high = places[closed].min(axis=0), places[closed].max(axis=0)
        half = np.full(2, 0.5 * float((high - low).max()) * 1.35 or 1.0)
    else:
        flat = around @ np.column_stack([right, up])
        low, high = flat.min(axis=0), flat.max(axis=0)
        half = 0.53 * (high - low)
    middle = (low + high) / 2
    near = (np.abs(places - middle) <= half).all(axis=1)
    # in typographic points: dots of this size about cover a panel of 3.6 inches, and are large enough to be seen
    dot = float(np.clip(72 * 3.6 / np.sqrt(max(int(near.sum()), 1)), 4.5, largest))
    colours = Normalize(min(float(values[closed].min()), 0.0), max(float(values.max()), 0.0))
    order = np.argsort(values, kind="stable")  # the largest pressures on top
    for code, status in enumerate(STATUS):
        chosen = order[(near & (contact.status == code))[order]]
        style: dict[str, Any] = {"s": (0.35 * dot) ** 2, "color": STATUS_COLOURS[status], "linewidths": 0}
        if status in ("touching", "bonded"):
            ring = 1.2 if status == "bonded" else 0.0
            style = {"s": dot**2, "c": values[chosen], "cmap": PRESSURE_COLOURS, "norm": colours, "zorder": 3}
            style |= {"edgecolors": STATUS_COLOURS["bonded"], "linewidths": ring}
        if len(chosen):
            ax.scatter(*places[chosen].T, label=status, **style)
    bar = ax.figure.colorbar(ScalarMappable(colours, PRESSURE_COLOURS), ax=ax, pad=0.02, aspect=24)
    bar.set_label(f"pressure ({unit})", **LABEL)
    ax.set_aspect("equal")
    ax.set_xlim(middle[0] - half[0], middle[0] + half[0])
    ax.set_ylim(middle[1] - half[1], middle[1] + half[1])
    ax.xaxis.set_major_locator(MaxNLocator(6))
    for axis, direction in ((ax.xaxis, right), (ax.yaxis, up)):
        exact = np.abs(direction).max() > 0.9999
        lengths.label(axis, direction_name(direction) if exact else f"across, about {direction_name(direction)}")


def head(ax: Any, title: str, handles: list[Any], labels: list[str]) -> None:
    """Title, and between it and the panel, where it covers nothing, the legend."""
    lines = 0
    for columns in (4, 3, 2, 1):
        # a legend is filled column by column; about 70 letters, 7 of them for a mark, are as wide as a panel
        lines = -(-len(labels) // columns)
        widths = [max(map(len, labels[i : i + lines])) + 7 for i in range(0, len(labels), max(lines, 1))]
        if sum(widths) <= 70:
            break
    ax.set_title(title, **TITLE, pad=8 + 15 * lines)
    if labels:
        ax.legend(
            handles, labels, fontsize=10, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False,
            ncols=columns, borderpad=0.2, columnspacing=1.4, handletextpad=0.5,
        )  # fmt: skip


def plain(text: str) -> str:
    """The text with dollar signs escaped, between which matplotlib reads formulas."""
    return text.replace("$", r"\$")
