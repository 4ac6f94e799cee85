"""Whole runs with material axes that follow fibers: equal to vectors, a closed form, symmetries, numbers of ranks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.meshes.shapes.mats import Fibers
from piezomat.results.fields import FieldOutput
from piezomat.scene import Scene
from piezomat.simulation import Run, plan, run
from tests.centre_lines import RADIUS, about_z, helix, ring, write_table
from tests.histories import assert_equal
from tests.scenes import pressed

R = 1.5  # of rings, um


def fiber(table: Path, material: dict[str, Any], **changes: Any) -> Scene:
    """A fiber of a table whose earthed ends are held, under a traction downward."""
    sections = {
        "geometry": {"shape": "fibers", "file": str(table)},
        "mesh": {"size": 0.4, "cells": "tensor"},
        "materials": {"fiber": {"like": "pvdf", **material}},
        "bodies": {"a": "fiber"},
        "boundaries": [
            {"on": "ends", "displacement": [0, 0, 0], "potential": 0},
            {"on": "surfaces", "traction": [0, 0, -1.0]},
        ],
        "output": {"fields": "none", "picture": False},
    }
    return Scene(**{**sections, **changes})


def fields(finished: Run) -> dict[str, Array]:
    """Fields in all cells, in the order of the mesh file, whichever rank has them. Collective."""
    piece = FieldOutput(finished.problem).piece()
    names = ("stress", "strain", "electric_field", "electric_displacement", "poling")
    here = fenicsx.original_cells(finished.model.mesh), {name: getattr(piece, name) for name in names}
    cells, found = zip(*finished.model.comm.allgather(here), strict=True)
    order = np.argsort(np.concatenate(cells))
    return {name: np.concatenate([part[name] for part in found])[order] for name in names}


def assert_near(found: Array, expected: Array, tolerance: float) -> None:
    """Equal within a tolerance of the largest."""
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * np.abs(expected).max(initial=0.0))


def crossed(lower: dict[str, Any], upper: dict[str, Any]) -> Scene:
    """Two half fibers at 30 degrees, pressed together."""
    return pressed(
        3,
        geometry={"shape": "crossed_fibers", "angle": 30.0, "length": 1.5},
        mesh={"size": 0.4, "contact_size": 0.2},
        materials={"lower": {"like": "pvdf", **lower}, "upper": {"like": "pvdf", **upper}},
        bodies={"lower": "lower", "upper": "upper"},
        output={"fields": "none", "picture": False},
    )


@pytest.mark.mpi
def test_straight_fibers_at_30_degrees_are_those_of_vectors(comm: MPI.Comm) -> None:
    """In contact, and in the fields of the results."""
    along = [float(np.cos(np.pi / 6)), 0.5, 0.0]
    up = [0.0, 0.0, 1.0]
    reference = run(crossed({"poling": up, "axis1": [1, 0, 0]}, {"poling": up, "axis1": along}), comm, quiet=True)
    given = fields(reference)
    for keys in ({"poling": "across"}, {"poling": up, "axis1": "along"}):
        followed = run(crossed(keys, keys), comm, quiet=True)
        assert_equal(followed.history, reference.history)
        for name, found in fields(followed).items():
            assert_near(found, given[name], 1e-8)
    text = " ".join(plan(crossed(keys, {"poling": "across"}), comm).split())
    assert "upper: axis 1 along the centre line, poling across it, at first upward (1 body)" in text
    assert "lower: axis 1 along the centre line, poling as near to [0.0, 0.0, 1.0] as is normal to it (1 body)" in text
    across = run(crossed({"poling": up}, {"poling": up}), comm, quiet=True)  # axis 1 along x in both
    column = "mean_potential@top"
    assert abs(across.history[-1][column] / reference.history[-1][column] - 1.0) > 1e-3


@pytest.mark.mpi
@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_a_rising_fiber_is_poled_normal_to_it(kinematics: str, comm: MPI.Comm, shared_tmp_path: Path) -> None:
    tangent = np.array([np.cos(0.4) * np.cos(0.5), np.cos(0.4) * np.sin(0.5), np.sin(0.4)])
    table = write_table(shared_tmp_path / "fiber.csv", np.array([np.zeros(3), 2.5 * tangent]), comm)
    normal = np.array([0.0, 0.0, 1.0]) - tangent[2] * tangent
    model = {"kinematics": kinematics}

    def found(keys: dict[str, Any]) -> dict[str, Array]:
        return fields(run(fiber(table, keys, model=model), comm, quiet=True))

    expected = found({"poling": normal.tolist(), "axis1": tangent.tolist()})
    for keys in ({"poling": "across"}, {"axis1": "along"}, {"poling": [0, 0, 2], "axis1": "along"}):
        for name, values in found(keys).items():
            assert_near(values, expected[name], 1e-9)
    field = expected["electric_field"]
    assert np.abs(found({})["electric_field"] - field).max() > 1e-2 * np.abs(field).max()


@pytest.mark.mpi
def test_a_flat_half_ring_that_is_isotropic_about_its_poling(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    """Across is upward all along it, and the direction of axis 1 has no effect: between electrodes, in contact."""
    table = write_table(shared_tmp_path / "ring.csv", ring(R, 0.0, np.pi), comm)
    piezo = {"e31": 0.03, "e32": 0.03, "e33": -0.075, "e15": 0.01, "e24": 0.01}
    changes = {
        "boundaries": [{"on": "ends", "displacement": [0, 0, "free"]}],
        "planes": [
            {"name": "bottom", "point": "bottom", "normal": [0, 0, 1], "potential": 0},
            {"name": "top", "point": "top", "normal": [0, 0, -1], "motion": [0, 0, -0.02], "potential": 0},
        ],
        "contact": {},
    }
    changes["planes"][1]["follows"] = "press"
    changes["load"] = {"steps": [2], "factors": {"press": [1.0]}}
    changes["solver"] = {"tolerance": 1e-11}
    history = {}
    for name, poling in (("across", "across"), ("up", [0, 0, 1]), ("down", [0, 0, -1])):
        history[name] = run(fiber(table, {"piezo": piezo, "poling": poling}, **changes), comm, quiet=True).history
    assert_equal(history["across"], history["up"], leave_out=("mean_potential@ends",))  # zero by symmetry
    charge = history["across"][-1]["charge@top"]
    assert abs(charge) > 1e-5
    assert history["down"][-1]["charge@top"] == pytest.approx(-charge, rel=1e-6)


@pytest.mark.mpi
def test_capacitance_of_an_anisotropic_quarter_ring(
    comm: MPI.Comm, shared_tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a voltage between its ends the potential is linear in the angle: D = eps_11 V / (angle rho) along the ring.

    The charge of an end is its integral over a disc, eps_11 V / angle 2 pi (R - sqrt(R^2 - r^2)).
    """
    monkeypatch.setattr(Fibers, "end_groups", lambda self: {"first": (1, 0.0), "last": (0, 0.0)})
    table = write_table(shared_tmp_path / "ring.csv", ring(R, 0.0, 0.5 * np.pi), comm)
    expected = 3e-4 * 2.0 / (0.5 * np.pi) * 2.0 * np.pi * (R - np.sqrt(R**2 - RADIUS**2))
    errors = []
    for size in (0.8, 0.4):
        scene = fiber(
            table,
            {"like": "elastic", "permittivity": [3e-4, 1e-4, 2e-4], "poling": "across"},
            mesh={"size": size, "cells": "tensor", "order": 2},
            boundaries=[
                {"on": "first", "displacement": [0, 0, 0], "potential": 0},
                {"on": "last", "potential": 2.0},
            ],
        )
        errors.append(run(scene, comm, quiet=True).history[-1]["charge@last"] / expected - 1.0)
    # The axes are constant in each cell, so that the error falls with the square of its length.
    assert abs(errors[1]) < 5e-3 and abs(4.0 * errors[1] - errors[0]) / 3.0 < 1e-3, errors


def test_an_arch_poled_outward_or_inward_has_opposite_voltages(tmp_path: Path) -> None:
    """The poling starts along x where the line starts upward: outward from one foot, inward from the other."""
    flat = ring(R, 0.0, np.pi, 401)
    arch = np.column_stack([flat[:, 0], np.zeros(401), flat[:, 1]])
    rows = []
    for name, points in (("outward", arch), ("inward", arch[::-1])):
        table = write_table(tmp_path / f"{name}.csv", points)
        rows.append(run(fiber(table, {"poling": "across"}), MPI.COMM_SELF, quiet=True).history[-1])
    outward, inward = rows
    assert abs(outward["mean_potential@surfaces"]) > 1e-3
    assert inward["mean_potential@surfaces"] == pytest.approx(-outward["mean_potential@surfaces"], rel=1e-6)
    for name in ("elastic", "electric", "force_z@ends"):
        assert inward[name] == pytest.approx(outward[name], rel=1e-8)


@pytest.mark.mpi
@pytest.mark.parametrize("poling", ["across", [0.3, 0.2, 1.0]])
def test_a_turned_scene_has_turned_results(poling: Any, comm: MPI.Comm, shared_tmp_path: Path) -> None:
    """A helix turned about the vertical, with its poling if that is a vector; also against a run on one rank."""
    turn = about_z(37.0)
    load = np.array([1.0, 0.5, -1.0])
    found: list[Run] = []
    for name, rotation in (("as it is", np.eye(3)), ("turned", turn)):
        points = helix(R, 3.0, 0.75, 400) @ rotation.T
        table = write_table(shared_tmp_path / f"{name}.csv", points, comm)
        direction = poling if isinstance(poling, str) else (rotation @ poling).tolist()
        scene = fiber(
            table,
            {"poling": direction, "axis1": "along"},
            boundaries=[
                {"on": "ends", "displacement": [0, 0, 0], "potential": 0},
                {"on": "surfaces", "traction": (rotation @ load).tolist()},
            ],
        )
        found.append(run(scene, comm, quiet=True))
        if name == "turned":
            assert_equal(found[-1].history, run(scene, MPI.COMM_SELF, quiet=True).history)
    before, after = (one.history[-1] for one in found)
    for name in ("elastic", "electric", "external_work", "mean_potential@surfaces"):
        assert after[name] == pytest.approx(before[name], rel=1e-8)
    forces = [np.array([row[f"force_{axis}@ends"] for axis in "xyz"]) for row in (before, after)]
    assert_near(forces[1], turn @ forces[0], 1e-8)
    polings = [fields(one)["poling"] for one in found]
    assert_near(polings[1], polings[0] @ turn.T, 1e-10)
