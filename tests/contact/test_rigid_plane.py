"""Rigid planes: their tangent against finite differences, closed forms of pressed blocks and capacitors, results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.contact.setup import interfaces_of
from piezomat.discretization.model import Model
from piezomat.forms.contact.laws.equal_potential import EqualPotential
from piezomat.forms.materials import VACUUM_PERMITTIVITY
from piezomat.meshes.body_mesh import create
from piezomat.meshes.contact.shadow import covered_area
from piezomat.results.files import read_history
from piezomat.scene import Scene, SceneError
from piezomat.simulation import plan, run
from tests.laws import summand

YOUNG, POISSON, PERMITTIVITY = 1000.0, 0.3, 1e-4
HEIGHT, WIDTH, DOWN, VOLTAGE = 0.8, 1.5, 0.01, 3.0
NORMAL, ELECTRIC = 5e4, 2e-3


def block(dimension: int = 2, **changes: Any) -> Scene:
    """A block on rollers, between a grounded plane below it and one that comes down with a potential."""
    down = [*[0.0] * (dimension - 1), -DOWN]
    up = [*[0.0] * (dimension - 1), 0.0]
    roller: list[Any] = [0, *["free"] * (dimension - 1)]
    keys: dict[str, Any] = {
        "geometry": {"shape": "cantilever", "length": WIDTH, "layers": [HEIGHT], "divisions": [3, 2]},
        "mesh": {"cells": "tensor"},
        "materials": {"soft": {"young": YOUNG, "poisson": POISSON, "permittivity": PERMITTIVITY}},
        "bodies": {"layer_1": "soft"},
        "boundaries": [{"on": "root", "displacement": roller}],
        "planes": [
            {"name": "floor", "point": "bottom", "potential": 0},
            {
                "name": "lid",
                "point": [*up[:-1], HEIGHT],
                "normal": [*up[:-1], -2.0],
                "motion": down,
                "follows": "press",
                "potential": VOLTAGE,
                "potential_follows": "volts",
            },
        ],
        "load": {"steps": [2, 1], "factors": {"press": [1.0, 1.0], "volts": [0.0, 1.0]}},
        "output": {"fields": "none", "picture": False},
    }
    if dimension == 3:
        keys["geometry"] |= {"width": WIDTH, "divisions": [2, 2, 2]}
        keys["boundaries"] += [{"on": "front", "displacement": ["free", 0, "free"]}]
    return Scene(**{**keys, **changes})


@pytest.mark.mpi
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_block_between_planes_is_in_the_uniform_state(comm: MPI.Comm, dimension: int) -> None:
    """Compressed by what the two penalties k leave of the motion, a capacitor in series with two penalties rho."""
    scene = block(dimension, contact={"medium": "none", "electric_range": 1e-8})
    last = run(scene, comm).history[-1]
    # Penalties are a factor of ten times stiffness or permittivity over the size of a facet.
    facet = WIDTH / 3 if dimension == 2 else WIDTH / 2
    stiffness = YOUNG * (1 - POISSON) / ((1 + POISSON) * (1 - 2 * POISSON))
    k, rho = 10.0 * stiffness / facet, 10.0 * PERMITTIVITY / facet
    modulus = YOUNG / (1 - POISSON**2) if dimension == 2 else YOUNG
    area = WIDTH if dimension == 2 else WIDTH**2
    pressure = DOWN / (HEIGHT / modulus + 2.0 / k)
    charge = VOLTAGE / (HEIGHT / PERMITTIVITY + 2.0 / rho) * area
    up = "yz"[dimension - 2]
    assert last[f"force_{up}@floor"] == pytest.approx(pressure * area, rel=1e-6)
    assert last[f"force_{up}@lid"] == pytest.approx(-pressure * area, rel=1e-6)
    assert last["charge@lid"] == pytest.approx(charge, rel=1e-6)
    assert last["charge@floor"] == pytest.approx(-charge, rel=1e-6)
    assert last["contact_area@lid"] == pytest.approx(area)
    assert last["max_pressure@lid"] == pytest.approx(pressure, rel=1e-6)
    assert last["max_penetration@lid"] == pytest.approx(pressure / k, rel=1e-6)
    assert last["mean_potential@lid"] == VOLTAGE and last["mean_potential@floor"] == 0.0
    stored = sum(last[name] for name in ("elastic", "electric", "contact"))
    assert last["external_work"] == pytest.approx(stored, rel=1e-6)
    # The field is that of the stretched block: the work counts what the load does to it, to first order in strain.
    assert last["elastic"] == pytest.approx(0.5 * pressure**2 / modulus * HEIGHT * area, rel=1e-6)


@pytest.mark.parametrize(
    ("volts", "given", "voltage"),
    [
        ([0.0, 1.0], None, VOLTAGE),
        ([0.5, -2.0], None, 2.0 * VOLTAGE),
        ([0.0, 1.0], 100.0, 100.0),
        ([0.1, 1.0], -1.0, 4.0),
    ],
)
def test_electric_contact_fades_out_over_a_gap_that_suits_the_voltage(
    volts: list[float], given: float | None, voltage: float, comm: MPI.Comm
) -> None:
    """The largest there is at once: of floor and lid at the end of either stage, and of the root if it has any."""
    load = {"steps": [2, 1], "factors": {"press": [1.0, 1.0], "volts": volts}}
    scene = block(contact={"medium": "none"}, load=load)
    (root,) = scene.boundaries
    scene = scene.model_copy(update={"boundaries": [root.model_copy(update={"potential": given})]})
    model = Model(scene, create(comm, scene.geometry, scene.sizes))
    assert model.prescription.largest_voltage() == pytest.approx(voltage)
    stiffness = model.materials[0].mean_stiffness
    wanted = 3.0 * voltage * np.sqrt(PERMITTIVITY / stiffness)
    for plane in interfaces_of(model).planes:
        fade = summand(plane.law, EqualPotential).fade
        assert fade == pytest.approx(np.maximum(0.1 * plane.facet_size, wanted))
        assert len(np.unique(fade)) == (1 if voltage == 100.0 else 2)


def test_an_insulating_plane_shows_the_voltage_of_what_touches_it(comm: MPI.Comm) -> None:
    scene = block(
        bodies={"layer_1": "pvdf"},
        planes=[
            {"name": "floor", "point": "bottom", "potential": 0},
            {"name": "lid", "point": "top", "motion": [0, -DOWN]},
        ],
        load={"steps": [1]},
    )
    open_circuit = run(scene, comm).history[-1]
    assert open_circuit["charge@lid"] == 0.0 and abs(open_circuit["charge@floor"]) < 1e-8
    assert abs(open_circuit["mean_potential@lid"]) > 0.1
    apart = block(planes=[{"name": "above", "point": [0, 2 * HEIGHT], "normal": [0, -1]}], load={"steps": [1]})
    row = run(apart, comm).history[-1]
    assert row["force_y@above"] == 0.0 and np.isnan(row["mean_potential@above"])


@pytest.mark.parametrize("medium", ["none", "air"])
@pytest.mark.parametrize("geometry", ["disc", "block"])
def test_the_tangent_and_the_residual_are_derivatives_of_the_energy(
    geometry: str, medium: str, comm: MPI.Comm, rng: np.random.Generator
) -> None:
    """A plane askew through bodies with random displacements and potentials, in reach of the electric fading."""
    planes = [{"name": "askew", "point": [0.1, 0.4], "normal": [0.6, 0.8], "potential": 2.0, "motion": [0.01, -0.02]}]
    planes += [{"name": "far", "point": [0, -50], "normal": [0, 1], "potential": 0}]  # between two potentials all pull
    scene = block(planes=planes, contact={"medium": medium}, load={"steps": [1]})
    if geometry == "disc":
        scene = Scene(
            geometry={"shape": "fiber_array", "columns": 1, "rows": 1},
            mesh={"size": 0.3, "order": 2},
            bodies={"*": "pvdf"},
            planes=planes,
            contact={"medium": medium},
        )
    model = Model(scene, create(comm, scene.geometry, scene.sizes))
    contact = interfaces_of(model)
    state = model.coordinate_vector()
    state.array[:] = 0.02 * rng.standard_normal(len(state.array))
    # Wide enough that points in the fading part of the law count too.
    for plane in contact.planes if medium == "none" else ():
        summand(plane.law, EqualPotential).fade[:] = 0.3
    contact.detect(state, 10.0)

    def energy(at: Any) -> float:
        contact.evaluate(at, tangent=False)
        found = contact.energies()
        return found["contact"] - found["electric"]

    def residual(at: Any) -> np.ndarray:
        result = state.duplicate()
        result.set(0.0)
        contact.add_residual(at, result)
        return result.array_r.copy()

    change = state.duplicate()
    change.array[:] = rng.standard_normal(len(change.array))
    contact.linearize(state)
    assert len(contact.blocks()[0]) > 2 and np.abs(contact.planes[0].response.hessian[:, 0, 1]).max() > 0.0
    product = state.duplicate()
    product.set(0.0)
    contact.add_product(change, product)
    here = residual(state)
    h = 1e-6
    ahead, behind = state + h * change, state - h * change
    slope = (energy(ahead) - energy(behind)) / (2 * h)
    assert here @ change.array_r == pytest.approx(slope, rel=1e-6)
    difference = (residual(ahead) - residual(behind)) / (2 * h)
    assert np.linalg.norm(difference - product.array_r) < 1e-5 * np.linalg.norm(product.array_r)


def facing(dimension: int, area: float | None = None, **changes: Any) -> Scene:
    """The block between planes of this area at a voltage; none: bare planes as large as the block."""
    scene = block(dimension, load={"steps": [1], "factors": {"press": [1.0], "volts": [1.0]}})
    planes = [row.model_dump(exclude_none=True) for row in scene.planes]
    planes[0]["area"] = area
    return block(dimension, **{"planes": planes, "load": scene.load, **changes})


@pytest.mark.mpi
@pytest.mark.parametrize("dimension", [2, 3])
def test_planes_are_a_plate_capacitor_where_no_body_lies_between_them(comm: MPI.Comm, dimension: int) -> None:
    """Three times the block's area is free; without an area there is nothing between bare planes."""
    covered, up = WIDTH ** (dimension - 1), "yz"[dimension - 2]
    bare, row = (run(facing(dimension, area), comm).history[-1] for area in (None, 4.0 * covered))
    distance, free = HEIGHT - DOWN, 3.0 * covered * VACUUM_PERMITTIVITY
    assert row["charge@lid"] - bare["charge@lid"] == pytest.approx(free * VOLTAGE / distance, rel=1e-6)
    assert row["electric"] - bare["electric"] == pytest.approx(0.5 * free * VOLTAGE**2 / distance, rel=1e-6)
    pull = 0.5 * free * (VOLTAGE / distance) ** 2
    for plane, sign in (("lid", 1.0), ("floor", -1.0)):
        column = f"force_{up}@{plane}"
        assert row[column] - bare[column] == pytest.approx(sign * pull, rel=1e-5)
    assert f"floor and lid ({free / HEIGHT:.3g} pC/" in plan(facing(dimension, 4.0 * covered), comm)
    assert "plate capacitor" not in plan(facing(dimension, None), comm)
    assert bare["max_field@lid"] == 0.0 and row["max_field@lid"] == pytest.approx(VOLTAGE / distance, rel=1e-12)


def test_a_plane_by_force_is_pulled_by_the_other_one() -> None:
    """It settles as under the force and the pull; and the capacitance of the free area is that of open electrodes."""

    def pushed(force: float, area: float | None, **lid: Any) -> dict[str, Any]:
        planes = [
            {"name": "floor", "point": "bottom", "area": area},
            {"name": "lid", "point": "top", "force": [0, -force]},
        ]
        electrodes = [{"name": "ground", "on": ["floor"], "potential": 0}, {"name": "upper", "on": ["lid"], **lid}]
        free = block(planes=planes, electrodes=electrodes, load={"steps": [1]}, solver={"tolerance": 1e-12})
        return run(free, MPI.COMM_SELF).history[-1]

    row = pushed(1.0, 4.0 * WIDTH, potential=200.0)
    distance, free = HEIGHT - row["travel@lid"], 3.0 * WIDTH * VACUUM_PERMITTIVITY
    pull = 0.5 * free * (200.0 / distance) ** 2
    other = pushed(1.0 + pull, None, potential=200.0)
    assert row["travel@lid"] == pytest.approx(other["travel@lid"], rel=1e-8)
    assert row["travel@lid"] - pushed(1.0, None, potential=200.0)["travel@lid"] > 0.1 * row["travel@lid"]
    charged = [pushed(1.0, area, charge=1e-3) for area in (4.0 * WIDTH, None)]
    difference = charged[0]["capacitance"] - charged[1]["capacitance"]
    assert difference == pytest.approx(free / distance, rel=0.05)
    assert charged[0]["voltage@upper"] < charged[1]["voltage@upper"]


@pytest.mark.mpi
def test_what_bodies_cover_of_a_plane(comm: MPI.Comm) -> None:
    """Two squares that overlap, in a plane askew, and intervals; each on another rank."""
    square = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    squares = np.stack([square, square + [0.5, 0.25, 3.0]])[comm.rank :: comm.size]
    turned = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    for axes in (np.eye(3), turned):
        assert covered_area(comm, squares @ axes.T, axes[:, 2]) == pytest.approx(2.0 - 0.5 * 0.75, rel=3e-3)
    lines = np.array([[[0.0, 0], [1, 1]], [[3, 0], [2, 0]], [[0.5, 2], [1.5, 0]]])[comm.rank :: comm.size]
    assert covered_area(comm, lines, np.array([0.0, 1.0])) == pytest.approx(2.5, rel=1e-14)


def test_a_resumed_run_knows_where_its_planes_were(comm: MPI.Comm, tmp_path: Path) -> None:
    whole = run(block(), comm).history
    short = block(load={"steps": [2], "factors": {"press": [1.0], "volts": [0.0]}})
    run(short, comm, tmp_path)
    text = (tmp_path / "scene.toml").read_text()
    (tmp_path / "scene.toml").write_text(text)
    longer = block()
    resumed = run(longer, comm, tmp_path, resume=True).history
    for first, second in zip(whole, resumed, strict=True):
        for name in ("force_y@lid", "charge@lid", "external_work", "elastic"):
            assert first[name] == pytest.approx(second[name], rel=1e-8, abs=1e-12), name
    assert [row["step"] for row in read_history(tmp_path / "history.csv")] == [1, 2, 3]


def test_plan_names_the_planes(comm: MPI.Comm) -> None:
    text = plan(block(), comm)
    assert "lid (electrode at 3 V times volts, moves by [0.0, -0.01] times press)" in text
    assert "with planes alone" in text


@pytest.mark.mpi
def test_a_body_that_never_touches_anything_is_named(comm: MPI.Comm) -> None:
    """Three discs with gaps between them: floor and lid press the outer ones, the middle one hangs free."""
    scene = Scene(
        geometry={"shape": "fiber_array", "columns": 1, "rows": 3, "gap": 0.1},
        mesh={"size": 0.4, "contact_size": 0.2, "cells": "tensor"},
        bodies={"*": "elastic"},
        planes=[
            {"name": "floor", "point": "bottom", "motion": [0, 0.05]},
            {"name": "lid", "point": "top", "motion": [0, -0.05]},
        ],
        contact={},
        load={"steps": [1]},
    )
    found = run(scene, comm, quiet=True).summary["warnings"]
    (warning,) = [text for text in found if "never touched" in text]
    assert warning.endswith("never touched anything: fiber_2")


@pytest.mark.parametrize(
    ("plane", "message"),
    [
        ({"name": "lid", "point": [0, 1]}, r"planes\[0\]\.normal: found nothing"),
        ({"name": "lid", "point": [0, 1], "normal": [0, 0]}, r"planes\[0\]\.normal: found \[0"),
        ({"name": "lid", "point": [0, 1, 0], "normal": [0, 1]}, r"planes\[0\]\.point: .*2 components"),
        ({"name": "lid", "point": "front"}, r'planes\[0\]\.point: found "front"'),
        ({"name": "lid", "point": "above"}, r"planes\[0\]\.point"),
        ({"name": "lid", "point": "top", "follows": "press"}, r"planes\[0\]\.follows: .*without motion"),
        ({"name": "lid", "point": "top", "motion": [0, 1], "follows": "pres"}, r"planes\[0\]\.follows: .*press"),
        ({"name": "root", "point": "top"}, r'planes\[0\]\.name: found "root"'),
        ({"name": "lid", "point": "top", "potental": 1}, r"planes\[0\]\.potental.*potential"),
    ],
)
def test_a_wrong_plane_is_named(plane: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        block(planes=[plane], load={"steps": [1], "factors": {"press": [1.0]}})


def test_planes_need_names_of_their_own_and_something_must_hold_the_bodies() -> None:
    twice = [{"name": "lid", "point": "top"}, {"name": "lid", "point": "bottom"}]
    with pytest.raises(SceneError, match=r"planes\[1\]\.name.*planes\[0\]"):
        block(planes=twice, load={"steps": [1]})
    with pytest.raises(SceneError, match=r"boundaries: found nothing"):
        block(planes=[], boundaries=[], load={"steps": [1]})
    again = Scene(**block().model_dump(mode="json", exclude_none=True))
    assert again.planes == block().planes
