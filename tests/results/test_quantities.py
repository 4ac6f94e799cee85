"""The columns of the history: their names and order, and totals of contact that add up."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.assembly.problem import Problem
from piezomat.contact.setup import interfaces_of
from piezomat.discretization.model import Model
from piezomat.meshes.body_mesh import create
from piezomat.results.contact_totals import PairTotals
from piezomat.results.quantities import GROUPS, columns, pair_columns
from piezomat.scene import Scene
from piezomat.simulation import run
from piezomat.usage import Timer

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
    problem = Problem(model, interfaces_of(model), Timer())
    try:
        return columns(problem)
    finally:
        problem.close()


EFFORT = ["newton", "linear_solves", "krylov", "cutbacks", "seconds"]
ENERGIES = ["elastic", "electric", "contact", "adhesion", "stabilization", "external_work", "dissipated"]


def test_columns_of_every_kind() -> None:
    wanted = ["step", "stage", "factor:press", "force_x@bottom", "force_y@bottom", "charge@bottom"]
    wanted += ["mean_potential@bottom", "force_x@lid", "force_y@lid", "contact_area@lid", "max_pressure@lid"]
    wanted += ["max_penetration@lid", "charge@lid", "mean_potential@lid"]
    pair = ["contact_force_x", "contact_force_y", "contact_area", "max_pressure", "max_penetration"]
    pair += ["max_potential_jump", "bonded_area"]
    wanted += [f"{name}@lower-upper" for name in pair]
    assert columns_of(half_discs()) == [*wanted, *ENERGIES, *EFFORT]
    augmented = half_discs(contact={"augment": 1e-3})
    assert columns_of(augmented) == [*wanted, *ENERGIES, *EFFORT, "augmentations"]
    model = Model(augmented, create(MPI.COMM_SELF, augmented.geometry, augmented.sizes))
    assert pair_columns(model) == pair


def test_columns_without_potential_and_contact() -> None:
    boundaries = [{"on": "bottom", "displacement": [0, 0]}, {"on": "top", "displacement": [0, 0.01]}]
    scene = half_discs(bodies={"*": "elastic"}, boundaries=boundaries, planes=[], contact=None, load={})
    places = ["force_x@bottom", "force_y@bottom", "force_x@top", "force_y@top"]
    assert columns_of(scene) == ["step", "stage", *places, *ENERGIES, *EFFORT]


@pytest.mark.mpi
def test_a_row_has_a_value_for_each_column(comm: MPI.Comm) -> None:
    finished = run(half_discs(), comm)
    (row,) = finished.history
    assert list(row) == columns(finished.problem)
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
