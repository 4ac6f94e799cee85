"""The columns of the history: their names and order, and totals of contact that add up."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.contact.setup import interfaces_of
from piezomat.discretization.model import Model
from piezomat.meshes.body_mesh import create
from piezomat.results.column_list import columns_of as columns_as_text
from piezomat.results.contact_totals import PairTotals
from piezomat.results.quantities import GROUPS, columns, pair_columns
from piezomat.scene import Scene
from piezomat.simulation import run

QUIET = {"fields": "none", "picture": False}


def half_discs(**sections: object) -> Scene:
    """Two half discs between a boundary below and a plane above, which is an electrode."""
    given = {
        "geometry": {"shape": "facing_halves"},
        "mesh": {"size": 0.25},
        "bodies": {"*": "pvdf"},
        "boundaries": [{"on": "bottom", "displacement": [0, 0], "potential": 0}],
        "planes": [{"name": "lid", "point": "top", "motion": [0, -0.01], "follows": "press", "potential": 1.0}],
        "contact": {},
        "load": {"factors": {"press": [1.0]}},
        "output": QUIET,
    }
    return Scene(**(given | sections))


def columns_of(scene: Scene) -> list[str]:
    model = Model(scene, create(MPI.COMM_SELF, scene.geometry, scene.sizes))
    return columns(model, interfaces_of(model))


EFFORT = ["newton", "linear_solves", "krylov", "cutbacks", "seconds"]
ENERGIES = ["elastic", "electric", "contact", "adhesion", "stabilization", "external_work", "dissipated"]


def test_columns_of_every_kind() -> None:
    wanted = ["step", "stage", "factor:press", "force_x@bottom", "force_y@bottom"]
    wanted += ["displacement_x@bottom", "displacement_y@bottom", "charge@bottom"]
    wanted += [
        "mean_potential@bottom",
        "travel@lid",
        "force_x@lid",
        "force_y@lid",
        "contact_area@lid",
        "max_pressure@lid",
    ]
    wanted += ["facets_across@lid", "max_penetration@lid", "max_field@lid", "charge@lid", "mean_potential@lid"]
    pair = ["contact_force_x", "contact_force_y", "contact_area", "max_pressure"]
    pair += ["facets_across", "max_penetration"]
    pair += ["max_potential_jump", "max_field", "bonded_area"]
    wanted += [f"{name}@lower-upper" for name in pair]
    assert columns_of(half_discs()) == [*wanted, *ENERGIES, *EFFORT]
    augmented = half_discs(contact={"augment": 1e-3})
    assert columns_of(augmented) == [*wanted, *ENERGIES, *EFFORT, "augmentations"]
    model = Model(augmented, create(MPI.COMM_SELF, augmented.geometry, augmented.sizes))
    assert pair_columns(model) == pair


def test_columns_without_potential_and_contact() -> None:
    boundaries = [{"on": "bottom", "displacement": [0, 0]}, {"on": "top", "displacement": [0, 0.01]}]
    scene = half_discs(bodies={"*": "elastic"}, boundaries=boundaries, planes=[], contact=None, load={})
    places = [
        f"{kind}_{axis}@{place}" for place in ("bottom", "top") for kind in ("force", "displacement") for axis in "xy"
    ]
    assert columns_of(scene) == ["step", "stage", *places, *ENERGIES, *EFFORT]


@pytest.mark.mpi
def test_a_row_has_a_value_for_each_column(comm: MPI.Comm) -> None:
    finished = run(half_discs(), comm)
    (row,) = finished.history
    assert list(row) == columns(finished.model, finished.contact)
    assert {type(value) for value in row.values()} == {int, float}
    # What the plane exerts is what the lower boundary bears, and what one body exerts on the other.
    assert row["force_y@lid"] == pytest.approx(-row["force_y@bottom"], rel=1e-6) and row["force_y@lid"] < 0.0
    assert row["contact_force_y@lower-upper"] == pytest.approx(row["force_y@lid"], rel=1e-6)
    assert row["mean_potential@lid"] == 1.0 and row["bonded_area@lower-upper"] == 0.0


def test_totals_of_points_add_up() -> None:
    one = PairTotals(np.array([1.0, -2.0]), 3.0, 1.0, 5.0, 0.1, 0.0)
    other = PairTotals(np.array([0.5, 2.0]), 1.0, 0.0, 4.0, 0.2, 7.0)
    total = PairTotals.none(2) + one + other
    assert total.force.tolist() == [1.5, 0.0]
    rest = (total.area, total.bonded_area, total.max_pressure, total.max_penetration, total.max_potential_jump)
    assert rest == (4.0, 1.0, 5.0, 0.2, 7.0)


def test_no_two_columns_have_one_name() -> None:
    names = [quantity.name.replace("{place}", group.symbol) for group in GROUPS for quantity in group.quantities]
    assert len(set(names)) == len(names)


@pytest.mark.mpi
def test_the_mean_displacement_of_a_boundary(comm: MPI.Comm) -> None:
    """Of what is prescribed, and of a free side: that of the exact uniform strain."""
    scene = Scene(
        geometry={"shape": "cantilever", "length": 2.0, "layers": [1.0], "divisions": [4, 2]},
        materials={"soft": {"young": 10.0, "poisson": 0.25}},
        model={"plane": "stress"},
        bodies={"layer_1": "soft"},
        boundaries=[
            {"on": "root", "displacement": [0, "free"]},
            {"on": "bottom", "displacement": ["free", 0]},
            {"on": "tip", "displacement": [0.02, "free"]},
            {"on": "top", "traction": [0, 0]},
        ],
        output=QUIET,
    )
    (row,) = run(scene, comm).history
    assert row["displacement_x@tip"] == pytest.approx(0.02, rel=1e-12)
    assert row["displacement_x@top"] == pytest.approx(0.01, rel=1e-9)
    assert row["displacement_y@top"] == pytest.approx(-0.25 * 0.01, rel=1e-9)


@pytest.mark.mpi
def test_strain_and_stress_of_a_mat(comm: MPI.Comm) -> None:
    """Of fibers between a floor and a lid: from the planes' motion and the lid's force, over the box's thickness and
    area; the recipe's numbers are in the summary."""
    scene = Scene.load(
        "fiber_array",
        {
            "geometry.columns": 2,
            "geometry.rows": 2,
            "mesh.size": 0.3,
            "mesh.contact_size": 0.15,
            "load.steps": [1],
            "output": QUIET,
        },
    )
    finished = run(scene, comm, quiet=True)
    row, recipe = finished.history[-1], finished.summary["recipe"]
    assert recipe["fibers"] == 4 and recipe["crossings"] > 0 and 0 < recipe["porosity"] < 1
    width = recipe["high"][0] - recipe["low"][0]
    assert recipe["area"] == pytest.approx(width)
    assert recipe["areal_density"] == pytest.approx(4 * np.pi * scene.geometry.radius**2 / width, rel=1e-6)
    height = recipe["high"][1] - recipe["low"][1]
    lid = next(plane for plane in scene.planes if plane.point == "top")
    assert row["strain"] == pytest.approx(lid.motion[1] / height, rel=1e-3) and row["strain"] < 0
    assert row["stress"] == pytest.approx(row["force_y@lid"] / width, rel=1e-12) and row["stress"] < 0


def test_the_columns_of_a_scene_as_text(comm: MPI.Comm) -> None:
    lines = columns_as_text(half_discs(), comm).splitlines()
    assert [line.split()[0] for line in lines] == columns_of(half_discs())
    assert "displacement_y@bottom um mean displacement of the boundary" in [" ".join(line.split()) for line in lines]
    force = next(line for line in lines if line.startswith("force_x@lid"))
    assert force.split()[1] == "uN/um"
