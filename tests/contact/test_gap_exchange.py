"""Charges across open gaps: the series of layers and gap, reciprocity, half discs against a calculation of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.contact.interface_laws import gap_medium
from piezomat.discretization.model import Model
from piezomat.forms.contact.laws.medium import Medium
from piezomat.forms.materials import VACUUM_PERMITTIVITY
from piezomat.meshes.body_mesh import create
from piezomat.scene import Scene
from piezomat.simulation import run
from tests.derivative import slope
from tests.laws import summand

PERMITTIVITY, GAP = 12.0 * VACUUM_PERMITTIVITY, 0.3


def plates(dimension: int, gap: float = GAP, voltage: float = 1.0, motion: float = 0.0, **changes: Any) -> Scene:
    """Two layers of 0.5 um, `gap` apart, between electrodes; the upper one is moved."""
    layers: dict[str, Any] = {"shape": "stacked_blocks", "height": [0.5, 0.5], "gap": gap}
    if dimension == 2:
        layers["divisions"] = [[3, 2], [3, 2]]
    else:
        layers |= {"depth": 1.0, "divisions": [[2, 2, 1], [2, 2, 2]]}
    sideways = [0] * (dimension - 1)
    keys: dict[str, Any] = {
        "geometry": layers,
        "materials": {"layer": {"young": 1e9, "poisson": 0.3, "permittivity": PERMITTIVITY}},
        "bodies": {"lower": "layer", "upper": "layer"},
        "boundaries": [
            {"on": "bottom", "displacement": [*sideways, 0], "potential": 0},
            {"on": "top", "displacement": [*sideways, motion], "follows": "move"},
        ],
        "electrodes": [{"name": "top", "on": ["top"], "potential": voltage}],
        "contact": {"medium_range": 2.0},
        "load": {"factors": {"move": [1.0]}},
        "output": {"fields": "none", "picture": False},
    }
    return Scene(**{**keys, **changes})


@pytest.mark.mpi
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("gap", [GAP, 0.002])
def test_layers_and_an_open_gap_are_capacitors_in_series(
    comm: MPI.Comm, dimension: int, order: int, gap: float
) -> None:
    """And nothing passes beside the layers: their sides do not face each other."""
    finished = run(plates(dimension, gap, mesh={"order": order, "cells": "tensor"}), comm)
    law = finished.contact.surface_pairs[0].law
    row, length = finished.history[-1], np.hypot(gap, summand(law, Medium).closed_gap)
    capacitance = 1.0 / (1.0 / PERMITTIVITY + length / VACUUM_PERMITTIVITY)
    assert row["charge@top"] == pytest.approx(capacitance, rel=1e-8)
    pull = 0.5 * capacitance**2 / VACUUM_PERMITTIVITY * gap / length
    assert row[f"force_{'xyz'[dimension - 1]}@top"] == pytest.approx(pull, rel=1e-8)
    assert row[f"contact_force_{'xyz'[dimension - 1]}@lower-upper"] == pytest.approx(pull, rel=1e-8)
    assert row["electric"] == pytest.approx(0.5 * capacitance, rel=1e-8)
    assert row["max_field@lower-upper"] == pytest.approx(capacitance / VACUUM_PERMITTIVITY, rel=1e-8)


def test_force_over_voltage_is_charge_over_approach() -> None:
    """Reciprocity, which the force across the gap is there for: soft layers, 30 V across 0.05 um of air."""

    def at(voltage: float, motion: float) -> dict[str, Any]:
        soft = {"layer": {"young": 1000.0, "poisson": 0.3, "permittivity": PERMITTIVITY}}
        return run(plates(2, 0.05, voltage, motion, materials=soft), MPI.COMM_SELF).history[-1]

    force = slope(lambda h: at(30.0 + h, 0.0)["force_y@top"], 0.1)
    charge = slope(lambda h: at(30.0, h)["charge@top"], 1e-4)
    assert force == pytest.approx(-charge, rel=1e-5)


@pytest.mark.parametrize(
    ("electrode", "density", "pulls"),
    [({}, 0.0, False), ({"charge": 1e-3}, 0.0, True), ({"potential": 10.0}, 0.0, True), ({}, 1e-4, True)],
)
def test_charges_that_are_given_pull_on_bodies_that_contact_alone_holds(
    electrode: dict[str, float], density: float, pulls: bool
) -> None:
    """Those of strain alone do not: they are next to nothing, and Newton's method would follow each loose fiber."""
    rows: list[dict[str, Any]] = [
        {"on": "bottom", "displacement": [0, 0], "potential": 0},
        {"on": "top", "displacement": [0, "free"], "traction": [0, -1.0]},
    ]
    if density:
        rows.append({"on": "lower_contact", "charge_density": density})
    scene = halves(
        mesh={"size": 0.3}, boundaries=rows, electrodes=[{"name": "top", "on": ["top"], **electrode}], load={}
    )
    assert gap_medium(Model(scene, create(MPI.COMM_SELF, scene.geometry, scene.sizes))).pulls == pulls


def halves(**changes: Any) -> Scene:
    """Half discs of PVDF pressed by 0.05 um, the upper flat side an open electrode."""
    keys: dict[str, Any] = {
        "geometry": {"shape": "facing_halves"},
        "mesh": {"size": 0.1, "contact_size": 0.032, "size_factors": {"upper": 0.9}, "order": 2},
        "bodies": {"lower": "pvdf", "upper": "pvdf"},
        "boundaries": [
            {"on": "bottom", "displacement": [0, 0], "potential": 0},
            {"on": "top", "displacement": [0, -0.05], "follows": "press"},
        ],
        "electrodes": [{"name": "top", "on": ["top"]}],
        "contact": {"medium_range": 2.0, "medium_gap": 1e-5, "normal_penalty_factor": 100},
        "load": {"steps": [2], "factors": {"press": [1.0]}},
        "output": {"fields": "none", "picture": False},
    }
    return Scene(**{**keys, **changes})


def test_half_discs_have_the_voltage_of_a_calculation_of_its_own() -> None:
    """15.99 V with rigid contact and electrostatics alone, times 0.991 for the effect back on the deformation."""
    assert run(halves(), MPI.COMM_SELF).history[-1]["voltage@top"] == pytest.approx(15.99 * 0.991, rel=0.01)


def test_half_discs_have_the_charge_of_a_calculation_of_its_own() -> None:
    """1.1929e-3 pC/um with rigid contact and electrostatics alone, times 0.999 for the effect back on the deformation.

    With stiff contact and a closed gap of next to nothing: 1.1909e-3, 1.1901e-3, 1.1910e-3 on facets of 0.05, 0.032
    and 0.02 um. The default of `medium_gap` takes 0.6 % of it, that of `normal_penalty_factor` 0.3 % at 0.032 um.
    """
    short = [{"name": "top", "on": ["top"], "potential": 0.0}]
    coarse = {"size": 0.1, "contact_size": 0.05, "size_factors": {"upper": 0.9}, "order": 2}
    row = run(halves(mesh=coarse, electrodes=short), MPI.COMM_SELF).history[-1]
    assert row["charge@bottom"] == pytest.approx(1.1929e-3 * 0.999, rel=3e-3)
    assert row["charge@top"] == pytest.approx(-row["charge@bottom"], rel=1e-6)


@pytest.mark.mpi
def test_the_answer_does_not_depend_on_the_number_of_ranks(comm: MPI.Comm) -> None:
    ours, alone = (
        run(halves(mesh={"size": 0.2, "contact_size": 0.08}, solver={"tolerance": 1e-11}), of).history[-1]
        for of in (comm, MPI.COMM_SELF)
    )
    for name in ("voltage@top", "force_y@top", "charge@bottom", "electric", "max_field@lower-upper"):
        assert ours[name] == pytest.approx(alone[name], rel=1e-7, abs=1e-12)


def test_bodies_apart_have_a_potential() -> None:
    """An open electrode on a fiber that touches nothing: that of the capacitor to the ground, which is zero."""
    row = run(halves(geometry={"shape": "facing_halves", "gap": 0.06}), MPI.COMM_SELF).history[-1]
    assert abs(row["voltage@top"]) < 1e-6 and row["contact_area@lower-upper"] == 0.0
    charged = [{"name": "top", "on": ["top"], "charge": 1e-4}]
    finished = run(halves(geometry={"shape": "facing_halves", "gap": 0.06}, electrodes=charged), MPI.COMM_SELF)
    assert finished.history[-1]["voltage@top"] == pytest.approx(1e-4 / finished.capacitance[-1][0][0], rel=1e-2)


def test_the_answer_does_not_depend_on_the_size_of_the_steps() -> None:
    """With the partners of the start of a step, one step instead of four gave 1 % more."""
    voltages = [
        run(halves(contact={}, load={"steps": [n], "factors": {"press": [1.0]}}), MPI.COMM_SELF).history[-1][
            "voltage@top"
        ]
        for n in (1, 4)
    ]
    assert voltages[0] == pytest.approx(voltages[1], rel=2e-5)
