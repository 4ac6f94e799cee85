"""What a picture shows of a run: what moves, planes, ground and poling, the fields and panels that are chosen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from piezomat import cli
from piezomat.pictures.curves import abscissa, driver_of, electric_curve, force_curves
from piezomat.pictures.data import read_run
from piezomat.pictures.fields import field_of
from piezomat.pictures.picture import Choice, draw, view
from piezomat.pictures.surroundings import electrodes_of, planes_of, poling_of
from piezomat.results.folder import MARK
from piezomat.results.vtk import ResultsError
from tests.results.test_pictures import check_layout, panels_of, write


def with_surroundings(tmp_path: Path, **options: Any) -> Any:
    """The made-up run with a lid that moves, ground below, and an upper body without permittivity."""
    run = read_run(write(tmp_path, **options))
    history = [row | {"travel@lid": 0.06 * row["factor:press"], "displacement_y@top": 0.0} for row in run.history]
    history = [
        row | {"force_y@lid": 2.0 * row["force_y@top"], "charge@lid": 1e-3 * row["factor:press"]} for row in history
    ]
    scene = {
        "bodies": {"lower": "pvdf", "upper": "elastic"},
        "boundaries": [{"on": "bottom", "potential": 0.0, "displacement": [0, 0]}],
        "planes": [
            {"name": "lid", "point": "top", "motion": [0, -0.06], "potential": 0.0},
            {"name": "wall", "point": [-0.7, 0.0], "normal": [2.0, 0.0]},
        ],
    }
    bodies = run.bodies
    density = np.where((bodies.body == 0)[:, None], 1.0, 0.0) * np.ones((len(bodies.body), 3))
    on_bottom = (bodies.points[:, 1] < -0.499).astype(int)
    bodies = replace(
        bodies, in_cells={"electric_displacement": density, "stress": bodies.stress}, places=on_bottom,
        place_names=("bottom",),
    )  # fmt: skip
    return replace(run, history=history, scene=scene, bodies=bodies, names=(["lower", "upper"], ["lid", "wall"]))


def test_curves_are_over_the_travel_of_what_moves(tmp_path: Path) -> None:
    run = with_surroundings(tmp_path)
    assert driver_of(run) == ("lid", "travel@lid", "force_y@lid")
    assert abscissa(run, None) == ("travel@lid", "travel of lid (µm)")
    assert abscissa(run, "factor:press") == ("factor:press", "factor:press")
    with pytest.raises(ResultsError, match=r'--x: found "travel@li"; .*did you mean "travel@lid"'):
        abscissa(run, "travel@li")
    assert force_curves(run) == [("force_y@lid", "force on lid, y")]
    # Both electrodes are at 0 V: a short circuit, whose charge is of interest.
    assert electric_curve(run) == ("charge@lid", "charge on lid", "pC")
    ax = next(ax for ax in draw(run).axes if ax.get_label() == "curves")
    (force, *_) = ax.get_lines()
    assert force.get_xdata().tolist() == pytest.approx([row["travel@lid"] for row in run.history])
    assert force.get_ydata().tolist() == pytest.approx([row["force_y@lid"] for row in run.history])
    # Where it stays during half of the steps, the load steps are.
    resting = [row | {"travel@lid": 0.06 * min(row["factor:press"], 0.5)} for row in run.history]
    assert abscissa(replace(run, history=resting), None) == ("step", "load step")


def test_planes_ground_and_poling(tmp_path: Path) -> None:
    run = with_surroundings(tmp_path)
    lid, wall = planes_of(run, run.bodies, 2.0)
    assert lid.kind == "ground (0 V)" and lid.point[1] == pytest.approx(0.5 - 2.0 * 0.06) and lid.normal[1] == -1.0
    assert wall.kind == "rigid plane" and wall.point[0] == -0.7 and wall.normal.tolist() == [1.0, 0.0, 0.0]
    assert electrodes_of(run) == {"bottom": "ground (0 V)"}
    assert poling_of(run, 2).tolist() == [0.0, 1.0, 0.0]
    turned = run.scene | {"materials": {"mine": {"like": "pvdf", "poling": [1, 0]}}, "bodies": {"*": "mine"}}
    assert poling_of(replace(run, scene=turned), 2).tolist() == [1.0, 0.0, 0.0]
    turned["materials"]["mine"]["axis1"] = "along"
    assert poling_of(replace(run, scene=turned), 2) is None
    mixed = turned | {"bodies": {"lower": "mine", "upper": "pvdf"}}
    assert poling_of(replace(run, scene=mixed), 2) is None
    figure = draw(run)
    check_layout(figure)
    bodies = next(ax for ax in figure.axes if ax.get_label() == "bodies")
    assert {text.get_text() for text in bodies.get_legend().get_texts()} == {
        "ground (0 V)",
        "rigid plane",
        "poled along +y",
    }
    # The upper body has no permittivity: it is grey where a potential is shown, and not where a stress is.
    assert field_of(run.bodies).shown.tolist() == [True, False]
    assert field_of(run.bodies, "von_mises").shown.tolist() == [True, True]


def test_fields_and_components_can_be_chosen(tmp_path: Path) -> None:
    run = with_surroundings(tmp_path)
    stress = field_of(run.bodies, "stress", "yy")
    assert stress.label == "stress yy (MPa)" and stress.values == pytest.approx(
        run.bodies.at_nodes(run.bodies.stress[:, 1])
    )
    moved = field_of(run.bodies, "displacement")
    assert moved.label == "magnitude of the displacement (µm)" and moved.limits[0] == pytest.approx(0.0, abs=1e-12)
    assert moved.colours == "viridis"
    signed = replace(run.bodies, potential=run.bodies.potential - 0.1)
    assert field_of(signed).colours == "RdBu_r" and np.sum(field_of(signed).limits) == 0.0
    for words, match in (
        (("presure", None), "--field: found .presure."),
        (("potential", "x"), "--component"),
        (("displacement", "xx"), '--component: found "xx"; allowed: x, y, z'),
        (("electric_field", "x"), "do not hold"),
    ):
        with pytest.raises(ResultsError, match=match):
            field_of(run.bodies, *words)


@pytest.mark.parametrize("form", ["png", "pdf", "svg"])
def test_a_panel_alone_in_every_format(form: str, tmp_path: Path) -> None:
    write(tmp_path)
    (path,) = view(tmp_path, Choice(step=12, panels=("curves",)), form)
    assert path == tmp_path / f"picture.{form}" and path.stat().st_size > 5000
    heads = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}
    assert path.read_bytes().startswith(heads[form])
    figure = draw(read_run(tmp_path), Choice(panels=("pressure",)))
    assert panels_of(figure) == ["pressure"] and figure.get_size_inches()[0] < 7.0
    check_layout(figure)
    if form == "svg":
        assert "force on" in path.read_text(encoding="utf-8") or "contact force" in path.read_text(encoding="utf-8")


def test_a_choice_that_does_not_exist_is_named(tmp_path: Path) -> None:
    write(tmp_path)
    for choice, match in (
        (Choice(step=3), "--step: found 3; allowed: 8, 12"),
        (Choice(panels=("curve",)), '--panel: found "curve"; .*did you mean "curves"'),
    ):
        with pytest.raises(ResultsError, match=match):
            view(tmp_path, choice)
    with pytest.raises(ResultsError, match="--format"):
        view(tmp_path, None, "gif")


def test_many_pairs_are_a_map(tmp_path: Path) -> None:
    for dim in (2, 3):
        run = read_run(write(tmp_path, dim=dim))
        pair = np.arange(len(run.contact.gap)) % 7
        figure = draw(replace(run, contact=replace(run.contact, pair=pair)))
        check_layout(figure)
        ax = next(ax for ax in figure.axes if ax.get_label() == "pressure")
        assert "Contact pressure of 7 pairs" in ax.get_title() and ax.get_xlabel() == "x (µm)"
        shown = sum(len(c.get_offsets()) for c in ax.collections if c.get_zorder() == 3)
        assert shown == run.contact.closed.sum()


def test_the_command_draws_what_is_chosen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path)
    (tmp_path / MARK).touch()
    assert cli.main(["view", str(tmp_path), "--panel", "curves", "zone", "--step", "8", "--format", "svg"]) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "picture.svg")
    assert cli.main(["view", str(tmp_path), "--step", "3"]) == 2
    assert capsys.readouterr().err.startswith("--step: found 3; allowed: 8, 12")
