"""Pictures: each kind of run gives its panels, nothing overlaps, and what is shown is what was computed."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.transforms import Bbox
from mpi4py import MPI

from piezomat.pictures.curves import electric_curve
from piezomat.pictures.data import Bodies, ContactData, frame, magnification, prefixed, read_run
from piezomat.pictures.fields import Field
from piezomat.pictures.picture import draw, view
from piezomat.pictures.render import render, section
from piezomat.results.files import Results
from piezomat.results.vtk import ContactPoints, FieldPiece, Grid, ResultsError

RADIUS = 0.5
PRESSED = 0.06  # how far the upper body is pressed down at most, um


def half_disc(side: float, cells: int, order: int) -> tuple[Any, Any]:
    """Quadrilaterals of a half disc that touches the origin from below (side -1) or above (1)."""
    u, v = np.meshgrid(np.linspace(-1, 1, 2 * cells * order + 1), np.linspace(1, 0, cells * order + 1), indexing="xy")
    x, y = u * np.sqrt(1 - v**2 / 2), v * np.sqrt(1 - u**2 / 2)
    number = np.arange(u.size).reshape(u.shape)
    at = [(0, 0), (0, order), (order, order), (order, 0)]
    if order == 2:
        at += [(0, 1), (1, 2), (2, 1), (1, 0), (1, 1)]
    nodes = [
        [number[j + dj, i + di] for dj, di in at]
        for j in range(0, cells * order, order)
        for i in range(0, 2 * cells * order, order)
    ]
    points = np.column_stack([RADIUS * x.ravel(), side * RADIUS * (1 - y.ravel()), np.zeros(u.size)])
    return points, np.array(nodes)


def swept(points: Any, cells: Any, length: float, layers: int, along: int) -> tuple[Any, Any]:
    """Hexahedra: quadrilaterals of the x-y plane, stood upright, swept along axis 0 or 1."""
    places = np.linspace(-length / 2, length / 2, layers + 1)
    zeros = np.zeros(len(points))
    across = [(zeros + s, points[:, 0]) if along == 0 else (points[:, 0], zeros + s) for s in places]
    x = np.vstack([np.column_stack([a, b, points[:, 1]]) for a, b in across])
    n = len(points)
    return x, np.vstack([np.hstack([cells + k * n, cells + (k + 1) * n]) for k in range(layers)])


def fiber_pair(dim: int, order: int = 1, cells: int = 4) -> tuple[Grid, Any]:
    """Two half discs, or two crossed half cylinders, and the body of each cell."""
    bodies = [half_disc(side, cells, order) for side in (-1.0, 1.0)]
    if dim == 3:
        bodies = [swept(*body, 2.0, 5, along) for along, body in enumerate(bodies)]
    (x0, c0), (x1, c1) = bodies
    cell_type = {(2, 1): 9, (2, 2): 28, (3, 1): 12}[dim, order]
    grid = Grid(np.vstack([x0, x1]), np.vstack([c0, c1 + len(x0)]), cell_type)
    return grid, np.repeat([0, 1], [len(c0), len(c1)])


def write(
    out: Path,
    *,
    dim: int = 2,
    order: int = 1,
    electric: bool = True,
    contact: bool = True,
    fields: bool = True,
    steps: int = 12,
    apart: bool = False,
    scale: float = 1.0,
    amount: float = 1.0,
    comm: MPI.Comm = MPI.COMM_SELF,
) -> Path:
    """Folder of a run with made-up results: pressed for two thirds of the steps, then, if `apart`, pulled."""
    grid, body = fiber_pair(dim, order)
    up = dim - 1
    axes = "xyz"[:dim]
    columns = ["step", "stage", "factor:press"]
    columns += [f"force_{axis}@{place}" for place in ("bottom", "top") for axis in axes]
    columns += [f"{kind}@top" for kind in ("charge", "mean_potential") if electric]
    columns += [f"contact_force_{axis}@lower-upper" for axis in axes if contact]
    x = grid.points
    height = np.abs(x[:, up]) / RADIUS
    owner = np.arange(len(grid.cells)) * comm.size // len(grid.cells)
    cells = grid.cells[owner == comm.rank]
    used, local = np.unique(cells, return_inverse=True)
    with Results(out, comm) as results:
        results.start('title = "Two fibers for $1 and $2, pressed"\n', columns)
        for step in range(1, steps + 1):
            turn = max(1, 2 * steps // 3)
            load = min(step / turn, 1 - 1.3 * max(step - turn, 0) / (steps / 3) if apart else 1.0)
            force = 12.0 * np.sign(load) * abs(load) ** 1.5
            row: dict[str, Any] = dict.fromkeys(columns, 0.0) | {
                "step": step,
                "stage": 1,
                "factor:press": load,
            }
            row |= {f"force_{axes[-1]}@top": -force, f"force_{axes[-1]}@bottom": force}
            row |= {"mean_potential@top": 0.2 * load} if electric else {}
            row |= {f"contact_force_{axes[-1]}@lower-upper": -force} if contact else {}
            results.row(row)
            if not fields or step not in (turn, steps):
                continue
            displacement = np.zeros((len(x), 3))
            upper = np.isin(np.arange(len(x)), grid.cells[body == 1])
            displacement[:, up] = -PRESSED * amount * load * np.where(upper, 0.5 + 0.5 * height, 0.5 - 0.5 * height)
            potential = 0.2 * load * np.where(upper, 0.5 + 0.5 * height, 0.5 - 0.5 * height)
            stress = np.zeros((len(cells), 6))
            stress[:, up] = -100 * load * np.exp(-np.linalg.norm(x[cells].mean(axis=1), axis=1) / 0.1)
            none = np.zeros((len(cells), 3))
            piece = FieldPiece(
                Grid(scale * x[used], local.reshape(cells.shape), grid.cell_type),
                scale * displacement[used],
                stress,
                body[owner == comm.rank],
                *((potential[used], none, none) if electric else ()),
            )
            results.fields(step, float(step), piece)
            if contact:
                results.contact(step, contact_points(dim, load, scale, comm), float(step))
    return out


def contact_points(dim: int, load: float, scale: float, comm: MPI.Comm) -> ContactPoints:
    """Hertz's pressure over a half-width of 0.1 sqrt(load), and a bonded ring around it."""
    places = np.linspace(-0.2, 0.2, 25)[comm.rank :: comm.size]
    grid = np.meshgrid(places, np.linspace(-0.2, 0.2, 25) if dim == 3 else [0.0])
    across = np.stack([axis.ravel() for axis in grid], axis=1)
    distance, half = np.linalg.norm(across, axis=1), 0.1 * np.sqrt(max(load, 0.0))
    n = len(across)
    position = np.zeros((n, 3))
    position[:, : dim - 1] = across[:, : dim - 1]
    position[:, dim - 1] = -PRESSED * load / 2
    normal = np.zeros((n, 3))
    normal[:, dim - 1] = 1
    status = np.where(distance < half, 1, np.where(distance < 1.3 * half, 2, 0))
    pressure = np.where(status == 1, 40 * np.sqrt(np.maximum(1 - (distance / max(half, 1e-9)) ** 2, 0)), 0.0)
    pressure[status == 2] = -5.0
    return ContactPoints(scale * position, normal, scale * distance**2, pressure, status, np.zeros(n, int), np.zeros(n))


def check_layout(figure: Any) -> None:
    """Every panel with its texts lies in the figure, apart from the others, and no tick labels collide."""
    figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()
    page = figure.bbox
    boxes: dict[str, Any] = {"title": figure._suptitle.get_window_extent(renderer)}
    for number, ax in enumerate(figure.axes):
        # a second y axis has no label of its own; it belongs to the curves
        name = ax.get_label() or "curves"
        name = f"{name} {number}" if name == "<colorbar>" else name
        box = ax.get_tightbbox(renderer)
        boxes[name] = Bbox.union([boxes[name], box]) if name in boxes else box
        for axis, interval in ((ax.xaxis, "intervalx"), (ax.yaxis, "intervaly")):
            if ax.axison and axis.get_visible():
                ticks = [t.get_window_extent(renderer) for t in axis.get_ticklabels() if t.get_text()]
                ends = sorted(tuple(getattr(t, interval)) for t in ticks)
                assert all(first[1] <= second[0] + 1 for first, second in pairwise(ends))
    for box in boxes.values():
        assert page.x0 <= box.x0 and box.x1 <= page.x1 and page.y0 <= box.y0 and box.y1 <= page.y1
    for (name, a), (other, b) in combinations(boxes.items(), 2):
        apart = min(a.x1, b.x1) - max(a.x0, b.x0) <= 1 or min(a.y1, b.y1) - max(a.y0, b.y0) <= 1
        assert apart, f"{name} overlaps {other}"


def panels_of(figure: Any) -> list[str]:
    names = [ax.get_label() for ax in figure.axes]
    return [name for name in names if name in ("bodies", "zone", "pressure", "curves")]


EVERY = ["bodies", "zone", "pressure", "curves"]
CASES: dict[str, tuple[dict[str, Any], list[str]]] = {
    "flat": ({}, EVERY),
    "flat, order 2, mechanics": ({"order": 2, "electric": False}, EVERY),
    "millimetres, many steps": ({"scale": 1e4, "steps": 100}, EVERY),
    "crossed, mechanics, small": ({"dim": 3, "electric": False, "amount": 1e-3}, EVERY),
    "no contact": ({"contact": False}, ["bodies", "curves"]),
    "one step": ({"steps": 1, "dim": 3}, EVERY),
    "one step, no contact, mechanics": (
        {"steps": 1, "contact": False, "electric": False},
        ["bodies", "curves"],
    ),
    "history alone": ({"fields": False}, ["curves"]),
}


@pytest.mark.parametrize("case", CASES)
def test_panels_and_layout(tmp_path: Path, case: str) -> None:
    options, panels = CASES[case]
    figure = draw(read_run(write(tmp_path, **options)))
    assert panels_of(figure) == panels
    check_layout(figure)


def test_picture_is_written_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from matplotlib.figure import Figure
    from matplotlib.image import imread

    write(tmp_path)
    assert view(tmp_path) == [tmp_path / "picture.png"]
    picture = imread(tmp_path / "picture.png")
    assert picture.shape[0] > 1000 and picture.shape[1] > 1500
    before = (tmp_path / "picture.png").read_bytes()

    def half(self: Figure, file: Any, **options: Any) -> None:
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Figure, "savefig", half)
    with pytest.raises(OSError, match="No space"):
        view(tmp_path)
    assert (tmp_path / "picture.png").read_bytes() == before
    assert not list(tmp_path.glob(".*"))


def test_texts_say_scale_units_and_step(tmp_path: Path) -> None:
    def words(**options: Any) -> str:
        figure = draw(read_run(write(tmp_path, **options)))
        texts = [figure._suptitle.get_text()]
        for ax in figure.axes:
            texts += [ax.get_title(), ax.get_xlabel(), ax.get_ylabel()]
            legend = ax.get_legend()
            texts += [text.get_text() for text in legend.get_texts()] if legend else []
        return "\n".join(texts)

    flat = words()
    assert "(step 12)" in flat and r"\$1 and \$2" in flat
    assert "true scale; grey: without load" in flat
    assert "potential (mV)" in flat and "pressure (MPa)" in flat and "force (µN/µm)" in flat
    assert "x (µm)" in flat and "contact force, lower-upper, y" in flat and "mean potential of top" in flat
    small = words(amount=0.01, electric=False)
    assert "displacement × 50;" in small and "von Mises stress (MPa)" in small and "potential" not in small
    crossed = words(dim=3)
    assert "force (µN)" in crossed and "seen along z" in crossed
    assert "(step" not in words(steps=1)


def test_the_step_in_contact_is_shown_when_the_last_is_apart(tmp_path: Path) -> None:
    run = read_run(write(tmp_path, apart=True))
    assert run.step == 8 and run.contact is not None and run.contact.closed.any()
    assert "step shown" in {line.get_label() for ax in draw(run).axes for line in ax.lines}
    assert read_run(write(tmp_path)).step == 12


def test_without_touching_there_is_no_pressure(tmp_path: Path) -> None:
    run = read_run(write(tmp_path))
    assert run.contact is not None
    apart = replace(run.contact, status=np.zeros_like(run.contact.status), pressure=0 * run.contact.pressure)
    figure = draw(replace(run, contact=apart))
    assert panels_of(figure) == ["bodies", "zone", "curves"]
    check_layout(figure)


def test_the_electric_curve_is_that_of_an_electrode_if_there_is_one(tmp_path: Path) -> None:
    """Its voltage, or the charge on it where the voltage does not change."""
    run = read_run(write(tmp_path, fields=False))
    assert electric_curve(run)[0] == "mean_potential@top"
    open_circuit = [row | {"voltage@lid": 0.1 * row["factor:press"], "charge@lid": 0.0} for row in run.history]
    assert electric_curve(replace(run, history=open_circuit)) == ("voltage@lid", "voltage of lid", "V")
    short = [row | {"voltage@lid": 0.0, "charge@lid": 1e-3 * row["factor:press"]} for row in run.history]
    assert electric_curve(replace(run, history=short)) == ("charge@lid", "charge on lid", "pC")
    held = [row | {"voltage@lid": 3.0, "charge@lid": 0.0} for row in run.history]
    assert electric_curve(replace(run, history=held)) == ("voltage@lid", "voltage of lid", "V")


def test_several_pairs_and_long_names(tmp_path: Path) -> None:
    run = read_run(write(tmp_path))
    assert run.contact is not None
    names = [f"a_body_with_a_long_name_{k}-another_with_a_long_name_{k}" for k in range(3)]
    history = [
        row | {f"contact_force_{axis}@{name}": row["force_y@top"] for name in names for axis in "xy"}
        for row in run.history
    ]
    for row in history:
        del row["contact_force_x@lower-upper"], row["contact_force_y@lower-upper"]
    pair = np.arange(len(run.contact.gap)) % 3
    figure = draw(replace(run, history=history, contact=replace(run.contact, pair=pair)))
    check_layout(figure)
    legends = [text.get_text() for ax in figure.axes if ax.get_legend() for text in ax.get_legend().get_texts()]
    assert set(names) < set(legends)


def test_pairs_of_many_bodies_are_named_by_them(tmp_path: Path) -> None:
    run = read_run(write(tmp_path))
    history = [{key: value for key, value in row.items() if not key.startswith("contact_")} for row in run.history]
    run = replace(run, history=history, names=(["a", "b", "c"], ["floor", "lid"]))
    assert [run.pair_name(number) for number in (1, 5, 9, 10)] == ["a-b", "b-c", "floor", "lid"]
    figure = draw(replace(run, contact=replace(run.contact, pair=np.where(np.arange(len(run.contact.gap)) % 2, 5, 10))))
    legends = [text.get_text() for ax in figure.axes if ax.get_legend() for text in ax.get_legend().get_texts()]
    assert {"b-c", "lid"} < set(legends)


@pytest.mark.mpi
def test_pieces_of_all_ranks_are_one_picture(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    write(shared_tmp_path / "parts", dim=3, comm=comm)
    if comm.rank == 0:
        parts = read_run(shared_tmp_path / "parts").bodies
        whole = read_run(write(shared_tmp_path / "whole", dim=3)).bodies
        assert parts is not None and whole is not None
        assert len(parts.points) == len(whole.points) == len(fiber_pair(3)[0].points)
        assert len(parts.cells) == len(whole.cells)
        for name in ("points", "displacement", "potential"):
            ours, theirs = getattr(parts, name)[parts.cells], getattr(whole, name)[whole.cells]
            assert np.array_equal(ours, theirs)
        assert np.allclose(parts.von_mises[parts.cells], whole.von_mises[whole.cells], rtol=1e-14)
        assert len(np.unique(parts.cells[parts.body == 0])) + len(np.unique(parts.cells[parts.body == 1])) == len(
            parts.points
        )


def test_outline_and_triangles_cover_the_bodies() -> None:
    for order in (1, 2):
        grid, body = fiber_pair(2, order, cells=8)
        none = np.zeros((len(grid.points), 3))
        bodies = Bodies(grid.points, grid.cells, grid.cell_type, none, None, np.zeros((len(body), 6)), body)
        corners = grid.points[np.vstack([bodies.triangles(0), bodies.triangles(1)])]
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2
        assert area == pytest.approx(np.pi * RADIUS**2, rel=0.01)
        edges = grid.points[bodies.outline]
        length = np.linalg.norm(np.diff(edges, axis=1), axis=2).sum()
        assert length == pytest.approx(2 * np.pi * RADIUS + 4 * RADIUS, rel=0.01)


def test_rendered_image_has_the_stated_scale_and_colours() -> None:
    grid, body = fiber_pair(3)
    none, zeros = np.zeros((len(grid.points), 3)), np.zeros((len(body), 6))
    bodies = Bodies(grid.points, grid.cells, grid.cell_type, none, None, zeros, body)
    field = Field(np.zeros(len(grid.points)), "", (0.0, 1.0), "neither", "viridis", np.ones(2, bool))
    image = render(bodies, 1.0, field, "#b0b0b0")
    left, right, bottom, top = image.extent
    rows, columns = image.pixels.shape[:2]
    assert (right - left) / (top - bottom) == pytest.approx(columns / rows, rel=1e-6)
    # how far the bodies reach in the image, in pixels and by projection
    filled = (image.pixels < 250).any(axis=2)
    flat = grid.points @ np.column_stack([image.right, image.up])
    for axis, (size, length) in enumerate(((right - left, columns), (top - bottom, rows))):
        places = np.flatnonzero(filled.any(axis=axis))
        assert (places[-1] - places[0]) * size / length == pytest.approx(np.ptp(flat[:, axis]), rel=0.02)
    # dark violet, the lowest colour of viridis, though shaded
    middle = image.pixels[filled]
    assert (middle[:, 1] < 0.8 * middle[:, 2]).mean() > 0.9


def test_section_is_the_cut_of_the_deformed_bodies() -> None:
    grid, body = fiber_pair(3)
    shift = np.tile([0.0, 0.0, 0.25], (len(grid.points), 1))
    bodies = Bodies(grid.points, grid.cells, grid.cell_type, shift, None, np.zeros((len(body), 6)), body)
    parts = section(bodies, grid.points[:, 2], np.array([0.0, 0.0, 0.25]), np.array([0.0, -1.0, 0.0]))
    areas = []
    for points, triangles, values in parts:
        a, b = (points[triangles[:, k]] - points[triangles[:, 0]] for k in (1, 2))
        areas.append(np.linalg.norm(np.cross(a, b), axis=1).sum() / 2)
        assert np.allclose(values, points[:, 2] - 0.25, atol=1e-6)
    # the lower fiber lies along x and is cut lengthwise, the upper one across
    assert areas == [pytest.approx(2.0 * RADIUS, rel=0.01), pytest.approx(np.pi * RADIUS**2 / 2, rel=0.05)]


def test_prefixes() -> None:
    assert prefixed([0.2], "V") == (pytest.approx(1e3), "mV")
    assert prefixed([-1500.0, 2.0], "V") == (pytest.approx(1e-3), "kV")
    assert prefixed([999.0], "µN/µm") == (pytest.approx(1.0), "µN/µm")
    assert prefixed([1000.0], "µN") == (pytest.approx(1e-3), "mN")
    assert prefixed([2e4], "MPa") == (pytest.approx(1e-3), "GPa")
    assert prefixed([3e-5, np.nan, np.inf], "MPa") == (pytest.approx(1e6), "Pa")
    assert prefixed([5e-20], "pC") == (pytest.approx(1e6), "aC")
    assert prefixed([3e-5], "pC") == (pytest.approx(1e6), "aC")
    assert prefixed([0.0], "MPa") == (1.0, "MPa")
    assert prefixed([5.0], "s") == (1.0, "s")


def test_magnification() -> None:
    def of(largest: float) -> float:
        return magnification(np.array([[0.0, 0, 0], [largest, 0, 0]]), 2.0)

    assert of(0.04) == of(1.0) == of(0.0) == 1.0
    assert of(0.039) == 2.0
    assert of(1e-3) == 100.0
    assert of(1.1e-3) == 50.0


def test_frame() -> None:
    for normal in ([0, 0, -2.0], [0, 1e-3, 1.0], [1.0, 0, 0], [-0.6, 0.8, 0.0], [0.5, -0.5, 0.7]):
        axes = np.array(frame(np.array(normal)))
        assert np.allclose(axes @ axes.T, np.eye(3), atol=1e-14)
        assert np.allclose(np.abs(axes[0] @ normal), np.linalg.norm(normal))
        assert axes[0, np.argmax(np.abs(axes[0]))] > 0
    assert np.allclose(frame(np.array([0, 0, -3.0])), [[0, 0, 1], [1, 0, 0], [0, 1, 0]])


def test_main_pair_and_mean_normal_of_two_passes() -> None:
    up, down = [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]
    contact = ContactData(
        position=np.zeros((4, 3)),
        normal=np.array([up, down, up, down]),
        gap=np.array([1.0, -0.1, 0.0, 0.0]),
        pressure=np.array([0.0, 5.0, 4.0, 4.0]),
        status=np.array([0, 1, 1, 1]),
        pair=np.array([3, 3, 7, 7]),
    )
    assert contact.main().pair.tolist() == [7, 7]
    assert np.allclose(contact.axes[0], up)
    nothing = replace(contact, pressure=np.zeros(4))
    assert nothing.main().pair.tolist() == [3, 3]


def test_what_cannot_be_shown_is_said(tmp_path: Path) -> None:
    with pytest.raises(ResultsError, match="holds no results of a run"):
        view(tmp_path)
    with Results(tmp_path, MPI.COMM_SELF) as results:
        results.start("title = 'x'", ["step", "force_x@a"])
        with pytest.raises(ResultsError, match="holds no step of a run yet"):
            view(tmp_path)
        results.row({"step": 1, "force_x@a": 0.0})
        with pytest.raises(ResultsError, match="nothing to show"):
            view(tmp_path)
    write(tmp_path)
    next((tmp_path / "fields").glob("step_0012*")).unlink()
    with pytest.raises(ResultsError, match="a result of step 12, is missing"):
        view(tmp_path)
    write(tmp_path)
    (tmp_path / "scene.toml").write_text("title = ")
    with pytest.raises(ResultsError, match=r"cannot read .*scene\.toml"):
        view(tmp_path)
