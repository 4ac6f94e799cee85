"""Active-set predictor: changes of gap and jump, the predicted residual, and steps that close the right points."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.contact.interfaces import Interfaces
from piezomat.contact.setup import interfaces_of
from piezomat.discretization.model import Model
from piezomat.forms.contact.integrals import FacetPairs, first_changes
from piezomat.forms.contact.laws.equal_potential import EqualPotential
from piezomat.meshes.body_mesh import create
from piezomat.scene import Scene
from piezomat.simulation import run
from piezomat.solver import active_set_prediction
from tests.facets import KINDS, PairBatch
from tests.histories import assert_equal
from tests.laws import summand
from tests.scenes import pressed


@pytest.mark.parametrize("name", KINDS)
def test_first_changes_are_derivatives_of_gap_and_jump(name: str, rng: np.random.Generator) -> None:
    batch = PairBatch(name, rng)
    q, d, h = batch.unknowns, rng.uniform(-1.0, 1.0, batch.unknowns.shape), 1e-6
    given = batch.kind, batch.project(q), batch.slave_shape
    found = first_changes(FacetPairs(*given, d.shape[2], batch.potentials(q)), d)
    gap = (batch.project(q + h * d).gap - batch.project(q - h * d).gap) / (2.0 * h)
    jump = (batch.jump(q + h * d) - batch.jump(q - h * d)) / (2.0 * h)
    np.testing.assert_allclose(found, np.column_stack([gap, jump]), atol=1e-7)
    mechanical = first_changes(FacetPairs(*given, batch.dim, None), d[..., : batch.dim])
    np.testing.assert_allclose(mechanical, gap[:, None], atol=1e-7)


def askew(**mesh: Any) -> Scene:
    """A disc with an electrode's plane askew through it."""
    plane = {"name": "askew", "point": [0.1, 0.4], "normal": [0.6, 0.8], "potential": 2.0, "motion": [0.01, -0.02]}
    return Scene(
        geometry={"shape": "fiber_array", "columns": 1, "rows": 1},
        mesh={"size": 0.3, **mesh},
        bodies={"*": "pvdf"},
        planes=[plane],
        contact={"medium": "none"},
    )


def paired(scene: Scene, comm: MPI.Comm, rng: np.random.Generator) -> tuple[Interfaces, Any, Any]:
    """The scene's contact, detected at a random state, that state and a random change of it."""
    model = Model(scene, create(comm, scene.geometry, scene.sizes))
    contact = interfaces_of(model)
    state, change = model.coordinate_vector(), model.coordinate_vector()
    state.array[:], change.array[:] = 0.05 * rng.standard_normal((2, len(state.array)))
    contact.detect(state, 10.0)
    return contact, state, change


@pytest.mark.parametrize("order", [1, 2])
def test_the_response_of_a_plane_is_predicted_exactly(order: int, comm: MPI.Comm, rng: np.random.Generator) -> None:
    """Gaps and jumps are linear there: predicted residual and tangent lead to the residual after the change."""
    contact, state, change = paired(askew(order=order), comm, rng)
    for p in contact.planes:
        summand(p.law, EqualPotential).fade[:] = 0.3  # points in the fading part of the electric law count too
    contact.evaluate(state, tangent=True)
    (p,) = contact.planes
    missed = contact.predict(change)
    contact.linearize(state)
    assert np.abs(contact.predict(change)).max() < 1e-12 * missed.max()
    found, expected = state.duplicate(), state.duplicate()
    for vector in (found, expected):
        vector.set(0.0)
    contact.add_product(change, found)
    contact.add_linearized_residual(found)
    contact.end_prediction()
    moved, at = state + change, p.projection.gap
    contact.add_residual(moved, expected)
    assert np.linalg.norm((found - expected).array) < 1e-12 * np.linalg.norm(expected.array)
    closes = (at > 0.0) != (p.projection.gap > 0.0)
    assert closes.any() and not closes.all() and missed.min() > 0.0


@pytest.mark.mpi
@pytest.mark.parametrize("penalty", [1e4, 1e8])
def test_the_start_value_closes_the_points_that_a_plane_meets(penalty: float, comm: MPI.Comm) -> None:
    """What is left to Newton's method is what the start value had left of a linear problem."""
    scene = Scene(
        geometry={"shape": "fiber_array", "columns": 1, "rows": 1},
        mesh={"size": 0.15},
        materials={"soft": {"young": 1000, "poisson": 0.3}},
        bodies={"*": "soft"},
        planes=[
            {"name": "floor", "point": "bottom"},
            {"name": "lid", "point": "top", "motion": [0, -0.1], "follows": "press"},
        ],
        contact={"normal_penalty": penalty},
        load={"steps": [2], "factors": {"press": [1.0]}},
    )
    assert all(row["newton"] <= 3 for row in run(scene, comm).history)


def test_the_equilibrium_is_that_without_prediction(comm: MPI.Comm, monkeypatch: pytest.MonkeyPatch) -> None:
    """In fewer iterations, the linear solves of which are counted."""
    scene = pressed(2, mesh={"size": 0.12, "contact_size": 0.03}, contact={"normal_penalty": 1e7})
    predicted = run(scene, comm).history
    monkeypatch.setattr(active_set_prediction, "MAX_PREDICTIONS", 0)
    without = run(scene, comm).history
    assert_equal(predicted, without, ("newton", "linear_solves", "krylov"))
    for ours, theirs in zip(predicted, without, strict=True):
        assert ours["newton"] < theirs["newton"] and ours["newton"] < ours["linear_solves"]


@pytest.mark.parametrize(
    ("method", "order", "penalty", "steps"),
    [("node", 1, 1e6, 4), ("point", 2, 1e6, 4), ("segment", 2, 1e4, 1), ("segment", 2, 1e5, 1)],
)
def test_predictions_that_fail_are_given_up(
    method: str, order: int, penalty: float, steps: int, comm: MPI.Comm
) -> None:
    """Where points go round corners; each of these once ran out of iterations, however its steps were cut."""
    facet = 0.012 * order
    scene = pressed(
        2,
        mesh={"size": 0.12, "contact_size": facet, "size_factors": {"upper": 0.9}, "order": order},
        contact={"method": method, "normal_penalty_factor": penalty, "passes": 1 if method == "node" else 2},
        load={"steps": [steps], "factors": {"press": [0.5]}},
    )
    history = run(scene, comm).history
    assert sum(row["cutbacks"] for row in history) == 0 and max(row["newton"] for row in history) <= 20
