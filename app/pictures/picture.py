"""One picture of a run: bodies, contact zone, contact pressure, force and voltage over the load steps.

Only the files of the run's folder are read. Panels that would show nothing are left out.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from piezomat.forms.arrays import Array, Integers
from piezomat.pictures.data import Bodies, ContactData, RunData, magnification, prefixed, read_run
from piezomat.pictures.plots import (
    DARK,
    GREY,
    LABEL,
    TITLE,
    direction_name,
    draw_curves,
    draw_pressure_2d,
    draw_pressure_3d,
    electric_curve,
    force_curves,
    plain,
)
from piezomat.pictures.render import Image, render, section
from piezomat.results.atomic import replacing
from piezomat.results.vtk import ResultsError

DPI = 150
FIELD_COLOURS = "viridis"
# A body longer than so many times its height is not drawn to scale: nothing would be seen of it.
SLENDER = 8.0


class Field(NamedTuple):
    """What colours the bodies: nodal values in the unit of the label, and their limits."""

    values: Array
    label: str
    limits: tuple[float, float]
    extend: str


class Zone(NamedTuple):
    """The contact zone: its centre, the directions in space drawn to the right and up, half its size."""

    centre: Array
    right: Array
    up: Array
    half: tuple[float, float]


def view(directory: Path) -> list[Path]:
    """Draw DIR/picture.png from the results in DIR; the files written. Not collective: call it on one rank.

    ResultsError: there is nothing to show, or a result is missing or damaged.
    """
    path = Path(directory) / "picture.png"
    figure = draw(read_run(Path(directory)))
    with replacing(path) as file:
        figure.savefig(file, dpi=DPI, format="png")
    return [path]


def draw(run: RunData) -> Figure:
    """The figure of a run; the axes of a panel have its name as label: bodies, zone, pressure, curves."""
    panels: dict[str, Callable[[Any], None]] = {}
    bodies, contact = run.bodies, run.contact
    field = _field(bodies) if bodies else None
    if bodies and field:
        zone = _zone(bodies, contact.main()) if contact else None
        panels["bodies"] = lambda ax: _draw_bodies(ax, bodies, field, zone)
        if zone:
            panels["zone"] = lambda ax: _draw_zone(ax, bodies, field, zone)
    if contact and contact.closed.any():
        if run.flat:
            panels["pressure"] = lambda ax: draw_pressure_2d(ax, contact, run.pair_name)
        else:
            panels["pressure"] = lambda ax: draw_pressure_3d(ax, contact)
    forces, electric = force_curves(run), electric_curve(run)
    # Without forces a single step would show nothing but a prescribed potential.
    if forces or (electric and len(run.history) > 1):
        panels["curves"] = lambda ax: draw_curves(ax, run, forces, electric)

    if not panels:
        raise ResultsError(f"the results of '{run.title}' have nothing to show: no fields, force or voltage")
    rows, size = _layout(list(panels), bodies)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    figure.get_layout_engine().set(w_pad=0.12, h_pad=0.12, wspace=0.03, hspace=0.03)
    grid = figure.add_gridspec(len(rows), 2, height_ratios=[1.2, 1.0][: len(rows)])
    axes = {}
    for place, names in enumerate(rows):
        for column, name in enumerate(names):
            columns = column if len(names) == 2 else slice(None)
            axes[name] = figure.add_subplot(grid[place, columns], label=name)
            panels[name](axes[name])
    if field:
        beside = axes.get("zone", axes["bodies"])
        beside.set_anchor("E")
        colours = ScalarMappable(Normalize(*field.limits), FIELD_COLOURS)
        bar = figure.colorbar(colours, ax=beside, extend=field.extend, pad=0.02, aspect=28, panchor=False)
        bar.set_label(field.label, **LABEL)
    title = plain(run.title)
    if run.step is not None and len(run.history) > 1:
        title += f" (step {run.step})"
    figure.suptitle("\n".join(textwrap.wrap(title, int(7.5 * size[0]))), fontsize=15, fontweight="bold")
    return figure


def _layout(panels: list[str], bodies: Bodies | None) -> tuple[list[list[str]], tuple[float, float]]:
    """Panels of each row, two or one that takes its width, and the size of the figure in inches."""
    extent = np.sort(np.ptp(bodies.points, axis=0))[-2:] if bodies else np.ones(2)
    long = bodies is not None and bodies.flat and extent[1] > 2.5 * extent[0]
    if len(panels) == 4:
        return [panels[:2], panels[2:]], (13.0, 10.8)
    if len(panels) == 3:
        return ([panels[:1], panels[1:]] if long else [panels[:2], panels[2:]]), (13.0, 10.8)
    if len(panels) == 2:
        return ([panels[:1], panels[1:]], (11.0, 8.5)) if long else ([panels], (13.0, 5.8))
    return [panels], (11.0, 5.0) if long else (8.5, 6.5)


def _field(bodies: Bodies) -> Field:
    """The potential if there is one, else the von Mises stress; that to its 99.8th percentile, as corners are
    singular."""
    if bodies.potential is not None:
        factor, unit = prefixed(bodies.potential, "V")
        values, label, extend = factor * bodies.potential, f"potential ({unit})", "neither"
        low, high = float(values.min()), float(values.max())
    else:
        factor, unit = prefixed(bodies.von_mises, "MPa")
        values, label = factor * bodies.von_mises, f"von Mises stress ({unit})"
        low, high = 0.0, float(np.percentile(values, 99.8))
        extend = "max" if high < values.max() else "neither"
    if high - low <= 1e-9 * max(abs(low), abs(high), 1e-300):
        low, high = low - 0.5 * (abs(low) or 1.0), high + 0.5 * (abs(high) or 1.0)
    return Field(values, label, (low, high), extend)


def _zone(bodies: Bodies, contact: ContactData) -> Zone | None:
    """The zone of contact of one pair; None where it is no small part of the bodies, or far from touching."""
    closed = contact.closed
    if not closed.any() and contact.gap.min() > 0.5 * bodies.size:
        return None
    normal, first, _ = contact.axes
    near = closed if closed.any() else contact.gap <= contact.gap.min() + 1e-3 * bodies.size
    places = contact.position[near]
    centre = (places.min(axis=0) + places.max(axis=0)) / 2
    reach = float(np.linalg.norm(places - centre, axis=1).max())
    half = min(max(1.8 * reach, 0.08 * bodies.size), 0.2 * bodies.size)
    if reach > 0.9 * half:
        return None
    right, up = (np.eye(3)[0], np.eye(3)[1]) if bodies.flat else (first, normal)
    return Zone(centre, right, up, (1.2 * half, half))


def _draw_bodies(ax: Any, bodies: Bodies, field: Field, zone: Zone | None) -> None:
    factor = magnification(bodies.displacement, bodies.size)
    scale = "true scale" if factor == 1 else f"displacement × {factor:,.6g}"
    title = f"Deformed bodies, {scale}; grey: without load"
    deformed = bodies.points + factor * bodies.displacement
    if not bodies.flat:
        image = render(bodies, factor, field.values, field.limits, FIELD_COLOURS, GREY)
        ax.imshow(image.pixels, extent=image.extent, interpolation="lanczos")
        ax.set_title(title, **TITLE)
        _draw_axes_and_scale(ax, image)
        return
    _draw_outline(ax, bodies.points, bodies.outline, color=GREY, linewidth=1.6, zorder=1)
    _draw_mesh_2d(ax, bodies, deformed, field)
    every = np.vstack([deformed, bodies.points])[:, :2]
    low, high = every.min(axis=0), every.max(axis=0)
    margin = 0.05 * (high - low)
    ax.set_xlim(low[0] - margin[0], high[0] + margin[0])
    ax.set_ylim(low[1] - margin[1], high[1] + margin[1])
    if np.ptp([low, high], axis=0).max() > SLENDER * np.ptp([low, high], axis=0).min():
        title += "; x and y to different scales"
    else:
        ax.set_aspect("equal")
    ax.set_title(title, **TITLE)
    ax.set_xlabel("x (µm)", **LABEL)
    ax.set_ylabel("y (µm)", **LABEL)
    if zone is not None:
        # where the zone is in the picture, whose displacements may be magnified
        half = np.array(zone.half)
        inside = np.linalg.norm(bodies.points + bodies.displacement - zone.centre, axis=1) < half.min()
        shift = (factor - 1) * bodies.displacement[inside].mean(axis=0) if inside.any() else np.zeros(3)
        corner = (zone.centre + shift)[:2] - half
        ax.add_patch(Rectangle(corner, *(2 * half), fill=False, edgecolor="black", zorder=6))


def _draw_mesh_2d(ax: Any, bodies: Bodies, points: Array, field: Field) -> None:
    """Cells coloured by nodal values, and the bodies' outline."""
    for body in np.unique(bodies.body):
        _draw_values(ax, points, bodies.triangles(body), field.values, field)
    _draw_outline(ax, points, bodies.outline, color=DARK, linewidth=0.9, zorder=3)


def _draw_values(ax: Any, points: Array, triangles: Integers, values: Array, field: Field) -> None:
    """Bands of values linear in each triangle (colours blended from its corners would be of no value)."""
    if len(triangles):
        ax.tricontourf(
            points[:, 0], points[:, 1], triangles, values, levels=np.linspace(*field.limits, 129),
            cmap=FIELD_COLOURS, extend="both", zorder=2,
        )  # fmt: skip


def _draw_outline(ax: Any, points: Array, edges: Integers, **style: Any) -> None:
    ax.add_collection(LineCollection(points[edges][:, :, :2], capstyle="round", **style))


def _draw_zone(ax: Any, bodies: Bodies, field: Field, zone: Zone) -> None:
    """The contact zone at true scale; in 3D, the section through its centre along its normal."""
    plane = np.column_stack([zone.right, zone.up])
    if bodies.flat:
        _draw_mesh_2d(ax, bodies, bodies.points + bodies.displacement, field)
        ax.set_title("Contact zone, true scale", **TITLE)
    else:
        across = np.cross(zone.right, zone.up)
        for points, triangles, values in section(bodies, field.values, zone.centre, across):
            _draw_values(ax, points @ plane, triangles, values, field)
        ax.set_title("Section through the contact zone, true scale", **TITLE)
    at = zone.centre @ plane
    ax.set_aspect("equal")
    ax.set_xlim(at[0] - zone.half[0], at[0] + zone.half[0])
    ax.set_ylim(at[1] - zone.half[1], at[1] + zone.half[1])
    ax.xaxis.set_major_locator(MaxNLocator(6))
    ax.set_xlabel(f"{direction_name(zone.right)} (µm)", **LABEL)
    ax.set_ylabel(f"{direction_name(zone.up)} (µm)", **LABEL)


def _draw_axes_and_scale(ax: Any, image: Image) -> None:
    """Below the image: the axes' directions, and a bar of a round length, true for what lies in its plane."""
    left, right, bottom, top = image.extent
    width, foot = right - left, 0.16 * (top - bottom)
    ax.set_axis_off()
    ax.set_ylim(bottom - foot, top)
    origin = np.array([left + 0.55 * foot, bottom - 0.62 * foot])
    for name, direction in zip("xyz", np.eye(3), strict=True):
        tip = origin + 0.5 * foot * np.array([direction @ image.right, direction @ image.up])
        ax.annotate("", tip, origin, arrowprops={"arrowstyle": "-|>", "color": DARK, "shrinkA": 0, "shrinkB": 0})
        ax.text(*(origin + 1.35 * (tip - origin)), name, ha="center", va="center", **LABEL)
    decade = 10.0 ** np.floor(np.log10(0.3 * width))
    length = max(step * decade for step in (1, 2, 5) if step * decade <= 0.3 * width)
    ends, height = np.array([right - 0.04 * width - length, right - 0.04 * width]), bottom - 0.75 * foot
    ax.plot(ends, [height, height], color=DARK, linewidth=3, solid_capstyle="butt")
    ax.annotate(f"{length:,.6g} µm", (ends.mean(), height), (0, 5), textcoords="offset points", ha="center", **LABEL)
