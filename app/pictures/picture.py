"""One picture of a run: bodies, contact zone, contact pressure, force and voltage over the load steps.

Only the files of the run's folder are read. Panels that would show nothing are left out.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon, Rectangle
from matplotlib.ticker import MaxNLocator

from piezomat.forms.arrays import Array, Integers
from piezomat.pictures.curves import draw_curves, electric_curve, force_curves
from piezomat.pictures.data import Bodies, ContactData, RunData, magnification, read_run
from piezomat.pictures.fields import Field, field_of
from piezomat.pictures.lengths import Lengths, direction_name
from piezomat.pictures.plots import DARK, GREY, LABEL, TITLE, draw_pressure_2d, draw_pressure_3d, head, plain
from piezomat.pictures.render import WITHOUT, Image, render, section
from piezomat.pictures.surroundings import COLOURS, PlaneMark, electrodes_of, planes_of, poling_of
from piezomat.results.atomic import replacing
from piezomat.results.vtk import ResultsError
from piezomat.scene.errors import named, near, shown

DPI = 150
PANELS = ("bodies", "zone", "pressure", "curves")
FORMATS = ("png", "pdf", "svg")
_WITHOUT = ListedColormap([WITHOUT])
# A body longer than so many times its height is not drawn to scale: nothing would be seen of it.
SLENDER = 8.0


class Choice(NamedTuple):
    """What of a run is drawn, by default what says most: step, field, component, x axis of the curves, panels."""

    step: int | None = None
    field: str | None = None
    component: str | None = None
    x: str | None = None
    panels: tuple[str, ...] = ()


class Zone(NamedTuple):
    """The contact zone: its centre, the directions in space drawn to the right and up, half its size."""

    centre: Array
    right: Array
    up: Array
    half: tuple[float, float]


def view(directory: Path, choice: Choice | None = None, format: str = "png") -> list[Path]:
    """Draw DIR/picture.png (or .pdf, .svg) from the results in DIR; the files written. Not collective.

    ResultsError: there is nothing to show, a result is missing or damaged, or what is chosen does not exist.
    """
    choice = choice or Choice()
    if format not in FORMATS:
        raise ResultsError(f"--format: found {shown(format)}; allowed: {named(list(FORMATS))}")
    path = Path(directory) / f"picture.{format}"
    figure = draw(read_run(Path(directory), choice.step), choice)
    with replacing(path) as file:
        # Text stays text, in fonts that journals take.
        with rc_context({"pdf.fonttype": 42, "svg.fonttype": "none"}):
            figure.savefig(file, dpi=DPI, format=format)
    return [path]


def draw(run: RunData, choice: Choice | None = None) -> Figure:
    """The figure of a run; the axes of a panel have its name as label: bodies, zone, pressure, curves."""
    choice = choice or Choice()
    panels: dict[str, Callable[[Any], None]] = {}
    bodies, contact = run.bodies, run.contact
    lengths = Lengths.of(bodies.size if bodies else 0.0)
    field = field_of(bodies, choice.field, choice.component) if bodies else None
    if bodies and field:
        zone = _zone(bodies, contact.main()) if contact else None
        panels["bodies"] = lambda ax: _draw_bodies(ax, run, bodies, field, zone, lengths)
        if zone:
            panels["zone"] = lambda ax: _draw_zone(ax, bodies, field, zone, lengths)
    if contact and contact.closed.any():
        if run.flat:
            panels["pressure"] = lambda ax: draw_pressure_2d(ax, contact, run.pair_name, bodies, lengths)
        else:
            panels["pressure"] = lambda ax: draw_pressure_3d(ax, contact, bodies, lengths)
    forces, electric = force_curves(run), electric_curve(run)
    # Without forces a single step would show nothing but a prescribed potential.
    if forces or (electric and len(run.history) > 1):
        panels["curves"] = lambda ax: draw_curves(ax, run, forces, electric, choice.x)

    if not panels:
        raise ResultsError(f"the results of '{run.title}' have nothing to show: no fields, force or voltage")
    panels = _chosen(panels, choice.panels)
    rows, heights, size = _layout(list(panels), bodies)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    figure.get_layout_engine().set(w_pad=0.12, h_pad=0.12, wspace=0.03, hspace=0.03)
    grid = figure.add_gridspec(len(rows), 2, height_ratios=heights)
    axes = {}
    for place, names in enumerate(rows):
        for column, name in enumerate(names):
            columns = column if len(names) == 2 else slice(None)
            axes[name] = figure.add_subplot(grid[place, columns], label=name)
            panels[name](axes[name])
    if field and {"bodies", "zone"} & set(axes):
        beside = axes.get("zone", axes.get("bodies"))
        beside.set_anchor("E")
        colours = ScalarMappable(Normalize(*field.limits), field.colours)
        bar = figure.colorbar(colours, ax=beside, extend=field.extend, pad=0.02, aspect=28, panchor=False)
        bar.set_label(field.label, **LABEL)
    title = plain(run.title)
    if run.step is not None and len(run.history) > 1:
        title += f" (step {run.step})"
    # Some 7.5 letters of this size are as wide as an inch.
    points = 15 if size[0] > 8.0 else 12
    figure.suptitle(
        "\n".join(textwrap.wrap(title, int(7.5 * size[0] * 15 / points))), fontsize=points, fontweight="bold"
    )
    return figure


def _chosen(panels: dict[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """The panels of these names, all without any. ResultsError: there is none of a name."""
    for name in names:
        if name not in panels:
            wrong = f"--panel: found {shown(name)}; allowed: {named(list(panels))}{near(name, list(panels))}"
            raise ResultsError(wrong if name not in PANELS else f"{wrong} (this run has nothing to show there)")
    return {name: panels[name] for name in names} if names else panels


def _layout(panels: list[str], bodies: Bodies | None) -> tuple[list[list[str]], list[float], tuple[float, float]]:
    """Panels of each row, two or one that takes its width; the rows' heights, and the size of the figure, in inches."""
    extent = np.sort(np.ptp(bodies.points, axis=0))[-2:] if bodies else np.ones(2)
    long = _is_flat(bodies) and extent[1] > 2.5 * extent[0]
    if len(panels) == 4:
        return [panels[:2], panels[2:]], [5.9, 4.9], (13.0, 10.8)
    if len(panels) == 3:
        if long:
            return [panels[:1], panels[1:]], [5.9, 4.9], (13.0, 10.8)
        # Bodies in 2D fill a panel of some 4.3 inches with their width; title and legend take another 1.4.
        height = min(5.9, 4.3 * np.divide(*np.ptp(bodies.points, axis=0)[1::-1]) + 1.4) if _is_flat(bodies) else 5.9
        return [panels[:2], panels[2:]], [height, 4.9], (13.0, height + 4.9)
    if len(panels) == 2:
        return ([panels[:1], panels[1:]], [4.6, 3.9], (11.0, 8.5)) if long else ([panels], [5.8], (13.0, 5.8))
    return [panels], [5.2], (8.0, 4.0) if long else (6.2, 5.2)


def _is_flat(bodies: Bodies | None) -> bool:
    return bodies is not None and bodies.flat


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


def _draw_bodies(ax: Any, run: RunData, bodies: Bodies, field: Field, zone: Zone | None, lengths: Lengths) -> None:
    factor = magnification(bodies.displacement, bodies.size)
    scale = "true scale" if factor == 1 else f"displacement × {factor:,.6g}"
    title = f"Deformed bodies, {scale}; grey: without load"
    deformed = bodies.points + factor * bodies.displacement
    planes, electrodes = planes_of(run, bodies, factor), electrodes_of(run)
    marked = [kind for name, kind in electrodes.items() if bodies.on_place(name).any()]
    kinds = list(dict.fromkeys([*(plane.kind for plane in planes), *marked]))
    marks = [Line2D([], [], color=COLOURS[kind], linewidth=3) for kind in kinds]
    poling = poling_of(run, 2 if bodies.flat else 3)
    if not bodies.flat:
        image = render(bodies, factor, field, GREY, planes, electrodes)
        ax.imshow(image.pixels, extent=image.extent, interpolation="lanczos")
        head(ax, title, marks, kinds)
        _draw_axes_and_scale(ax, image, lengths, poling)
        return
    _draw_outline(ax, bodies.points, bodies.outline, color=GREY, linewidth=1.6, zorder=1)
    _draw_mesh_2d(ax, bodies, deformed, field)
    for name, kind in electrodes.items():
        on = bodies.on_place(name)[bodies.outline].all(axis=1)
        _draw_outline(ax, deformed, bodies.outline[on], color=COLOURS[kind], linewidth=4.0, zorder=5)
    every = np.vstack([deformed, bodies.points])[:, :2]
    every = np.vstack([every, *([plane.point[:2]] for plane in planes)])
    low, high = every.min(axis=0), every.max(axis=0)
    margin = 0.05 * (high - low)
    low, high = low - margin, high + margin
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    for plane in planes:
        _draw_plane_2d(ax, plane, float(np.ptp([low, high], axis=0).max()))
    if np.ptp([low, high], axis=0).max() > SLENDER * np.ptp([low, high], axis=0).min():
        title += "; x and y to different scales"
    else:
        ax.set_aspect("equal")
    if poling is not None:
        marks.append(Line2D([], [], linestyle="none"))
        kinds.append(f"poled along {_direction(poling)}")
    head(ax, title, marks, kinds)
    lengths.label(ax.xaxis, "x")
    lengths.label(ax.yaxis, "y")
    if zone is not None:
        # where the zone is in the picture, whose displacements may be magnified
        half = np.array(zone.half)
        inside = np.linalg.norm(bodies.points + bodies.displacement - zone.centre, axis=1) < half.min()
        shift = (factor - 1) * bodies.displacement[inside].mean(axis=0) if inside.any() else np.zeros(3)
        corner = (zone.centre + shift)[:2] - half
        ax.add_patch(Rectangle(corner, *(2 * half), fill=False, edgecolor="black", zorder=6))


def _direction(vector: Array) -> str:
    """A direction in words: +y, or its components."""
    axis = int(np.argmax(np.abs(vector)))
    if abs(vector[axis]) > 0.9999:
        return f"{'+' if vector[axis] > 0 else '-'}{'xyz'[axis]}".replace("-", "\N{MINUS SIGN}")
    return f"({', '.join(f'{value:.2g}' for value in vector)})".replace("-", "\N{MINUS SIGN}")


def _draw_plane_2d(ax: Any, plane: PlaneMark, reach: float) -> None:
    """A rigid plane as a line with hatches behind it."""
    along = np.array([-plane.normal[1], plane.normal[0]])
    ends = [plane.point[:2] - 2 * reach * along, plane.point[:2] + 2 * reach * along]
    behind = [end - 0.015 * reach * plane.normal[:2] for end in ends]
    ax.add_patch(
        Polygon([ends[0], ends[1], behind[1], behind[0]], facecolor="none", edgecolor=COLOURS[plane.kind], hatch="////",
                linewidth=0.0, zorder=4)
    )  # fmt: skip
    ax.plot(*np.array(ends).T, color=COLOURS[plane.kind], linewidth=3.0, zorder=5, scalex=False, scaley=False)


def _draw_mesh_2d(ax: Any, bodies: Bodies, points: Array, field: Field) -> None:
    """Cells coloured by nodal values, and the bodies' outline."""
    for body in np.unique(bodies.body):
        triangles = bodies.triangles(body)
        if field.shown[body]:
            _draw_values(ax, points, triangles, field.values, field)
        else:
            ax.tripcolor(points[:, 0], points[:, 1], triangles, np.zeros(len(triangles)), cmap=_WITHOUT, zorder=2)
    _draw_outline(ax, points, bodies.outline, color=DARK, linewidth=0.9, zorder=3)


def _draw_values(ax: Any, points: Array, triangles: Integers, values: Array, field: Field) -> None:
    """Bands of values linear in each triangle (colours blended from its corners would be of no value)."""
    if len(triangles):
        ax.tricontourf(
            points[:, 0], points[:, 1], triangles, values, levels=np.linspace(*field.limits, 129),
            cmap=field.colours, extend="both", zorder=2,
        )  # fmt: skip


def _draw_outline(ax: Any, points: Array, edges: Integers, **style: Any) -> None:
    ax.add_collection(LineCollection(points[edges][:, :, :2], capstyle="round", **style))


def _draw_zone(ax: Any, bodies: Bodies, field: Field, zone: Zone, lengths: Lengths) -> None:
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
    for axis, direction in ((ax.xaxis, zone.right), (ax.yaxis, zone.up)):
        exact = np.abs(direction).max() > 0.9999
        lengths.label(axis, direction_name(direction) if exact else f"about {direction_name(direction)}")


def _draw_axes_and_scale(ax: Any, image: Image, lengths: Lengths, poling: Array | None) -> None:
    """Below the image: axes, poling, and a bar of a round length, true for what lies in the image's plane."""
    left, right, bottom, top = image.extent
    width, foot = right - left, 0.16 * (top - bottom)
    ax.set_axis_off()
    ax.set_ylim(bottom - foot, top)
    origin = np.array([left + 0.55 * foot, bottom - 0.62 * foot])
    for name, direction in zip("xyz", np.eye(3), strict=True):
        tip = origin + 0.5 * foot * np.array([direction @ image.right, direction @ image.up])
        ax.annotate("", tip, origin, arrowprops={"arrowstyle": "-|>", "color": DARK, "shrinkA": 0, "shrinkB": 0})
        ax.text(*(origin + 1.35 * (tip - origin)), name, ha="center", va="center", **LABEL)
    if poling is not None:
        start = origin + np.array([1.2 * foot, 0.0])
        tip = start + 0.62 * foot * np.array([poling @ image.right, poling @ image.up])
        ax.annotate(
            "", tip, start, arrowprops={"arrowstyle": "-|>", "color": DARK, "lw": 2, "shrinkA": 0, "shrinkB": 0}
        )
        ax.text(start[0] + 0.12 * foot, start[1], "poling", va="center", **LABEL)
    decade = 10.0 ** np.floor(np.log10(0.3 * width))
    length = max(step * decade for step in (1, 2, 5) if step * decade <= 0.3 * width)
    ends, height = np.array([right - 0.04 * width - length, right - 0.04 * width]), bottom - 0.75 * foot
    ax.plot(ends, [height, height], color=DARK, linewidth=3, solid_capstyle="butt")
    ax.annotate(lengths.text(length), (ends.mean(), height), (0, 5), textcoords="offset points", ha="center", **LABEL)
