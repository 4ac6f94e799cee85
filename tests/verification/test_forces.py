"""Planes and rigid boundaries by force: closed forms, the same as by motion, and what cannot be."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from mpi4py import MPI

from piezomat.scene import Scene, SceneError
from piezomat.simulation import Run, run
from piezomat.solver.load_steps import Stepper, StepReport
from piezomat.solver.outcome import SolveError
from tests.histories import assert_equal
from tests.scenes import press, pressed

SOLVERS: dict[str, dict[str, Any]] = {
    "condensed": {},
    "factorized": {"petsc": {"pc_type": "lu"}},
    "multigrid": {"kind": "iterative", "petsc": {"ksp_rtol": 1e-12}},
}
YOUNG, POISSON = 1000.0, 0.3


def last(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> dict[str, Any]:
    """The last row of the history of a run."""
    return run(scene, comm).history[-1]


# --- Closed forms


def blocks(dimension: int, *planes: dict[str, Any], **changes: Any) -> Scene:
    """Two blocks, each 1 um high, on each other, 2 um wide (3D: 0.5 um deep), free to widen, under planes."""
    depth = {} if dimension == 2 else {"depth": 0.5}
    divisions = [[4, 3], [4, 2]] if dimension == 2 else [[3, 1, 2], [3, 1, 2]]
    up, held = dimension - 1, [*["free"] * (dimension - 1), 0]
    sides = [{"on": f"{body}_left", "displacement": [0, *["free"] * up]} for body in ("lower", "upper")]
    if dimension == 3:
        sides += [{"on": f"{body}_front", "displacement": ["free", 0, "free"]} for body in ("lower", "upper")]
    keys: dict[str, Any] = {
        "mesh": {"cells": "tensor"},
        "materials": {"soft": {"young": YOUNG, "poisson": POISSON}},
        "bodies": {"lower": "soft", "upper": "soft"},
        "boundaries": [{"on": "bottom", "displacement": held}, *sides],
        "planes": [{"name": "lid", "point": "top", **planes[0]}, *planes[1:]],
        "contact": {},
    }
    geometry = {"shape": "stacked_blocks", "height": [1.0, 1.0], "width": 2.0, "divisions": divisions}
    return press(geometry | depth, **{**keys, **changes})


PRESSURE = 1.5
# What penalties leave at two contacts is the same stress everywhere, but not the same travel.
PUSHES: dict[str, dict[str, Any]] = {
    "pressure": {"pressure": PRESSURE},
    "area": {"pressure": 2.0 * PRESSURE, "area": 1.0},
    "far": {"pressure": PRESSURE, "area": 2.0, "point": [0.0, 2.4], "normal": [0.0, -2.0]},
    "force": {"force": [0.0, -2.0 * PRESSURE]},
    "oblique": {"force": [1.0, -2.0 * PRESSURE]},
}


@pytest.mark.mpi
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("push", PUSHES)
def test_a_plane_that_is_pushed_presses_evenly(push: str, solver: str) -> None:
    found = run(blocks(2, PUSHES[push], solver={"tolerance": 1e-11, **SOLVERS[solver]}), MPI.COMM_WORLD)
    row, pressure = found.history[-1], PRESSURE
    if push == "oblique":  # the guide bears what is across the normal: contact balances what is along the force
        pressure = (1.0 + (2.0 * PRESSURE) ** 2) / (2.0 * PRESSURE) / 2.0
    assert row["force_y@lid"] == pytest.approx(-2.0 * pressure, rel=1e-8)
    assert row["force_y@bottom"] == pytest.approx(2.0 * pressure, rel=1e-8)
    assert row["max_pressure@lid"] == pytest.approx(pressure, rel=1e-8)
    assert row["elastic"] == pytest.approx(2.0 * pressure**2 * (1.0 - POISSON**2) / YOUNG * 2.0 / 2.0, rel=1e-8)
    # Work of the force on the way into the bodies, from where the plane touches them.
    stored = row["elastic"] + row["contact"]
    assert row["external_work"] == pytest.approx(stored, rel=1e-6)
    free = 0.4 if push == "far" else 0.0
    assert row["travel@lid"] - free == pytest.approx(2.0 * stored / (2.0 * pressure), rel=1e-6)
    assert row["stabilization"] < 1e-6 * stored


@pytest.mark.mpi
@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_a_pressure_in_three_dimensions(kinematics: str) -> None:
    row = last(blocks(3, {"pressure": 2.0}, model={"kinematics": kinematics}, solver={"tolerance": 1e-11}))
    assert row["force_z@lid"] == pytest.approx(-2.0 * 2.0 * 0.5, rel=1e-8)
    assert row["force_z@bottom"] == pytest.approx(2.0 * 2.0 * 0.5, rel=1e-8)


def test_blocks_between_two_planes_by_force() -> None:
    """Nothing but the two planes holds them upright: their travels together are those of one plane above a floor."""
    floor = {"name": "floor", "point": "bottom", "force": [0.0, 3.0]}
    row = last(blocks(2, {"force": [0.0, -3.0]}, floor, boundaries=blocks(2, {}).model_dump()["boundaries"][1:]))
    assert row["force_y@lid"] == pytest.approx(-3.0, rel=1e-8)
    assert row["force_y@floor"] == pytest.approx(3.0, rel=1e-8)
    stored = row["elastic"] + row["contact"]
    assert row["travel@lid"] + row["travel@floor"] == pytest.approx(2.0 * stored / 3.0, rel=1e-6)
    assert row["external_work"] == pytest.approx(stored, rel=1e-6)


# --- The same as by a motion


def fibers(lid: dict[str, Any], **changes: Any) -> Scene:
    """Two whole fibers on each other between planes."""
    keys: dict[str, Any] = {
        "geometry": {"shape": "fiber_array", "columns": 1, "rows": 2},
        "mesh": {"size": 0.25, "contact_size": 0.08},
        "bodies": {"*": "pvdf"},
        "boundaries": [],
        "planes": [
            {"name": "floor", "point": "bottom", "potential": 0.0},
            {"name": "lid", "point": "top", "follows": "press", **lid},
        ],
    }
    return pressed(2, **{**keys, **changes})


@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_a_force_on_a_plane_is_that_of_its_travel(kinematics: str) -> None:
    keys: dict[str, Any] = {"model": {"kinematics": kinematics}}
    by_force = last(fibers({"force": [0.0, -3.0]}, **keys))
    assert by_force["force_y@lid"] == pytest.approx(-3.0, rel=1e-8)
    assert by_force["force_y@floor"] == pytest.approx(3.0, rel=1e-8)
    by_motion = last(fibers({"motion": [0.0, -by_force["travel@lid"]]}, **keys))
    assert by_motion["travel@lid"] == by_force["travel@lid"]
    assert by_motion["force_y@lid"] == pytest.approx(-3.0, rel=1e-6)
    assert by_motion["mean_potential@lid"] == pytest.approx(by_force["mean_potential@lid"], rel=1e-6)
    assert by_motion["elastic"] == pytest.approx(by_force["elastic"], rel=1e-6)


@pytest.mark.mpi
def test_solvers_and_ranks_agree() -> None:
    """A plane by force that is an electrode too, on fibers that nothing holds; alone and on all ranks."""
    histories = {}
    for name, solver in SOLVERS.items():
        keys = {"electrodes": [{"name": "metal", "on": ["lid"]}], "solver": {"tolerance": 1e-11, **solver}}
        scene = fibers({"force": [0.0, -3.0]}, **keys)
        histories[name] = run(scene, MPI.COMM_WORLD).history
        if name == "condensed":
            leave_out = {"stabilization", "newton", "krylov", "linear_solves"}
            assert_equal(histories[name], run(scene, MPI.COMM_SELF).history, leave_out)
    for name, history in histories.items():
        row, condensed = history[-1], histories["condensed"][-1]
        for column in ("travel@lid", "voltage@metal", "elastic", "force_y@floor"):
            assert row[column] == pytest.approx(condensed[column], rel=1e-7), (name, column)


def test_work_and_energy_of_a_plane_that_is_pushed_and_let_go() -> None:
    """In small steps the work of the force is what is stored; without a force nothing of it remains."""
    history = run(
        fibers({"force": [0.0, -3.0]}, load={"steps": [8, 2], "factors": {"press": [1.0, 0.0]}}), MPI.COMM_SELF
    ).history
    first, pressed_most, released = history[0], history[7], history[9]
    stored = [sum(row[name] for name in ("elastic", "electric", "contact")) for row in (first, pressed_most)]
    # The first step moves the fibers up to each other, by what trapezoids know nothing of.
    work = pressed_most["external_work"] - first["external_work"]
    assert work == pytest.approx(stored[1] - stored[0], rel=2e-3)
    assert released["elastic"] < 1e-6 * stored[1]
    assert abs(released["force_y@lid"]) < 1e-5 * 3.0
    assert pressed_most["stabilization"] < 1e-4 * stored[1]


def test_capacitance_with_a_plane_by_force_is_that_at_the_force() -> None:
    """Charge over voltage with the plane free to move: against finite differences of runs; not that at its travel."""

    def at(voltage: float, **lid: Any) -> dict[str, Any]:
        ends = [{"name": "lid_metal", "on": ["lid"], "potential": voltage}, {"name": "ground", "on": ["floor"]}]
        ends[1]["potential"] = 0.0
        planes = fibers(lid or {"force": [0.0, -3.0]}).model_dump(exclude_none=True)["planes"]
        planes[0].pop("potential")
        return last(fibers({}, planes=planes, electrodes=ends, bodies={"*": "pzt5h"}, solver={"tolerance": 1e-11}))

    small = 1e-3
    at_rest, high, low = at(1.0), at(1.0 + small), at(1.0 - small)
    slope = (high["charge@lid_metal"] - low["charge@lid_metal"]) / (2.0 * small)
    assert at_rest["capacitance"] == pytest.approx(slope, rel=1e-4)
    held = at(1.0, motion=[0.0, -at_rest["travel@lid"]])
    assert abs(held["capacitance"] - slope) > 1e-2 * slope


@pytest.mark.slow
def test_open_voltage_and_charge_of_plies_under_a_pressure() -> None:
    """Lid and floor are electrodes: the charge of a short circuit is V (C + C'), with a capacitor and without."""

    def plies(lid: dict[str, Any], capacitance: float | None = None) -> dict[str, Any]:
        circuits = [] if capacitance is None else [{"between": ["metal", "ground"], "capacitance": capacitance}]
        scene = press(
            {"shape": "cross_ply", "angles": [0, 90], "width": 3.0, "depth": 3.0, "radius": 0.5, "spacing": 2.0},
            mesh={"size": 0.8, "contact_size": 0.6, "cells": "tensor"},
            bodies={"*": "pvdf"},
            boundaries=[{"on": "ends", "displacement": [0, 0, "free"]}],
            planes=[{"name": "floor", "point": "bottom"}, {"name": "lid", "point": "top", "pressure": 0.01}],
            electrodes=[{"name": "ground", "on": ["floor"], "potential": 0}, {"name": "metal", "on": ["lid"], **lid}],
            circuits=circuits,
            contact={"method": "node"},
        )
        return last(scene, MPI.COMM_SELF)

    isolated, short, connected = plies({}), plies({"potential": 0.0}), plies({}, 1e-4)
    for row in (isolated, short, connected):
        assert row["force_z@lid"] == pytest.approx(-0.01 * 9.0, rel=1e-8)
    mean = 0.5 * (isolated["capacitance"] + short["capacitance"])
    assert isolated["voltage@metal"] * mean == pytest.approx(-short["charge@metal"], rel=1e-6)
    assert connected["voltage@metal"] * (mean + 1e-4) == pytest.approx(-short["charge@metal"], rel=1e-6)


# --- Rigid boundaries


def half_discs(top: dict[str, Any], dimension: int = 2, **changes: Any) -> Scene:
    """Two half fibers, the upper one with this condition on its flat face."""
    rows = [
        {"on": "bottom", "displacement": [0.0] * dimension, "potential": 0.0},
        {"on": "top", "follows": "press", **top},
    ]
    return pressed(dimension, boundaries=rows, **changes)


def translation(found: Run) -> list[float]:
    """Of the rigid boundary `top` at the end of a run."""
    return [found.history[-1][f"displacement_{axis}@top"] for axis in "xyz"[: found.model.dim]]


@pytest.mark.mpi
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_free_half_disc_under_a_total_force(solver: str) -> None:
    """The step ends; the force is that of contact, and of a run that prescribes the travel."""
    keys = {"solver": {"tolerance": 1e-11, **SOLVERS[solver]}}
    found = run(half_discs({"rigid": True, "force": [0.0, -5.0]}, **keys), MPI.COMM_WORLD)
    row, moved = found.history[-1], translation(found)
    assert row["force_y@top"] == pytest.approx(-5.0, rel=1e-8)
    assert row["contact_force_y@lower-upper"] == pytest.approx(-5.0, rel=1e-8)
    assert row["force_y@bottom"] == pytest.approx(5.0, rel=1e-8)
    assert row["travel@top"] == pytest.approx(-moved[1], rel=1e-12)
    motion = last(half_discs({"displacement": moved}, **keys))
    assert motion["force_y@top"] == pytest.approx(-5.0, rel=1e-6)
    assert motion["mean_potential@top"] == pytest.approx(row["mean_potential@top"], rel=1e-6)


@pytest.mark.mpi
@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_a_rigid_face_of_crossed_fibers(kinematics: str) -> None:
    top = {"rigid": True, "displacement": [0.0, 0.0, "free"], "force": [0.0, 0.0, -2.0]}
    row = last(half_discs(top, 3, model={"kinematics": kinematics}))
    assert row["force_z@top"] == pytest.approx(-2.0, rel=1e-8)
    assert row["contact_force_z@lower-upper"] == pytest.approx(-2.0, rel=1e-7)
    assert abs(row["displacement_x@top"]) < 1e-12 and row["displacement_z@top"] == pytest.approx(-row["travel@top"])


def test_a_rigid_face_of_a_held_block_is_one_linear_solve() -> None:
    """Without contact: a cantilever pulled by a rigid end; the stretch of a bar and the work of the force."""
    rows = [
        {"on": "root", "displacement": [0.0, "free"]},
        {"on": "bottom", "displacement": ["free", 0.0]},
        {"on": "tip", "rigid": True, "displacement": ["free", "free"], "force": [2.0, 0.0]},
    ]
    geometry = {"shape": "cantilever", "length": 4.0, "layers": [1.0], "divisions": [4, 2]}
    scene = press(
        geometry,
        mesh={"cells": "tensor"},
        model={"plane": "stress"},
        materials={"soft": {"young": YOUNG, "poisson": 0.0}},
        bodies={"*": "soft"},
        boundaries=rows,
    )
    with pytest.raises(SceneError, match=r"boundaries\[2\].rigid: .* of which 1 nodes have a displacement y"):
        run(scene, MPI.COMM_SELF)
    rows[2]["displacement"] = ["free", 0.0]
    row = last(Scene(**{**scene.model_dump(exclude_none=True), "boundaries": rows}))
    assert row["travel@tip"] == pytest.approx(2.0 * 4.0 / YOUNG, rel=1e-10)
    assert row["force_x@root"] == pytest.approx(-2.0, rel=1e-10)
    assert row["external_work"] == pytest.approx(row["elastic"], rel=1e-10)
    assert row["newton"] == 1


# --- Steps that are cut, and runs that are resumed


@pytest.mark.mpi
def test_resumed_runs_go_on_from_the_travel(tmp_path_factory: pytest.TempPathFactory) -> None:
    comm = MPI.COMM_WORLD
    folder = Path(comm.bcast(str(tmp_path_factory.mktemp("resumed")) if comm.rank == 0 else None))
    steps = {"steps": [4], "factors": {"press": [1.0]}}
    scene = fibers({"force": [0.0, -3.0]}, load=steps, output={"fields": "none", "picture": False})
    whole = run(scene, comm).history
    half = scene.model_dump(exclude_none=True)
    half["load"] = {"steps": [2], "factors": {"press": [0.5]}}
    run(Scene(**half), comm, folder / "run")
    half["load"] = {"steps": [2, 2], "factors": {"press": [0.5, 1.0]}}
    resumed = run(Scene(**half), comm, folder / "run", resume=True).history
    assert resumed[1]["travel@lid"] == pytest.approx(whole[1]["travel@lid"], rel=1e-8)
    for column in ("travel@lid", "force_y@lid", "mean_potential@lid", "external_work", "elastic"):
        assert resumed[-1][column] == pytest.approx(whole[-1][column], rel=1e-8), column


def test_a_step_that_is_cut_ends_at_the_same_travel(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first solve of each whole step is given up when it is done: halves lead to the same equilibrium."""
    whole, solve = last(fibers({"force": [0.0, -3.0]})), Stepper._solve

    def given_up(stepper: Stepper, search_radius: float, prescribed: float, report: StepReport) -> None:
        solve(stepper, search_radius, prescribed, report)
        if report.cutbacks == 0:
            raise SolveError("given up")

    monkeypatch.setattr(Stepper, "_solve", given_up)
    cut = run(fibers({"force": [0.0, -3.0]}), MPI.COMM_SELF).history
    assert [row["cutbacks"] for row in cut] == [1, 1]
    assert cut[-1]["travel@lid"] == pytest.approx(whole["travel@lid"], rel=1e-7)
    assert cut[-1]["force_y@lid"] == pytest.approx(-3.0, rel=1e-8)


# --- Errors before any work


@pytest.mark.parametrize(
    ("lid", "message"),
    [
        ({"force": [0, -1], "motion": [0, -1]}, r"planes\[1\].force: found both motion and force"),
        ({"force": [0, -1], "pressure": 1.0}, r"planes\[1\].pressure: found both force and pressure"),
        ({"force": [0, 1]}, r"planes\[1\].force: found \[0.0, 1.0\]; allowed: a force towards the bodies"),
        ({"force": [1, 0]}, r"planes\[1\].force: found \[1.0, 0.0\]; allowed: a force towards the bodies"),
        ({"force": [0, 0, -1]}, r"planes\[1\].force: found \[0.0, 0.0, -1.0\]; allowed: 2 components"),
        ({"pressure": 1.0, "point": [0, 2], "normal": [0, -1]}, r"planes\[1\].area: found nothing"),
        ({"force": [0, -1], "area": 2.0}, r"planes\[1\].area: found 2.0; allowed: nothing without pressure"),
        ({}, r"planes\[1\].follows: found \"press\"; allowed: nothing without motion, force or pressure"),
    ],
)
def test_planes_that_cannot_be(lid: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        fibers(lid)


def test_a_plane_is_not_pulled_away() -> None:
    with pytest.raises(SceneError, match=r"load.factors.press: found \[1.0, -0.5\]; allowed: no negative values"):
        fibers({"force": [0, -1]}, load={"steps": [1, 1], "factors": {"press": [1.0, -0.5]}})


@pytest.mark.parametrize(
    ("top", "message"),
    [
        ({"force": [0, -1]}, r"boundaries\[1\].force: found \[0.0, -1.0\]; allowed: rigid = true with it"),
        ({"rigid": True, "displacement": [0, "free"]}, r"boundaries\[1\].force: found nothing"),
        ({"rigid": True, "force": [0, -1], "traction": [0, -1]}, r"boundaries\[1\].traction: .*force alone"),
        ({"rigid": True, "force": [0, 0], "displacement": [0, 0]}, r"boundaries\[1\].rigid: found true"),
        ({"rigid": True, "force": [1, -1], "displacement": [0, "free"]}, r"boundaries\[1\].force\[0\]: found 1.0"),
        ({"rigid": True, "force": [0, 0, -1]}, r"boundaries\[1\].force: .*2 components"),
    ],
)
def test_rigid_boundaries_that_cannot_be(top: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        half_discs(top)
