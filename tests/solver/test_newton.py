"""Newton's method: quadratic at the end of a step, few iterations, settled pairings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.scene import Scene
from piezomat.simulation import run
from piezomat.solver import active_set_prediction
from tests.marching import reports


def pressed(**changes: Any) -> Scene:
    """Two half discs pressed together, coarse."""
    keys: dict[str, Any] = {
        "geometry": {"shape": "facing_halves"},
        "mesh": {"size": 0.12, "contact_size": 0.03},
        "bodies": {"lower": "pvdf", "upper": "pvdf"},
        "boundaries": [
            {"on": "bottom", "displacement": [0, 0], "potential": 0},
            {"on": "top", "displacement": [0, -0.04], "follows": "press"},
        ],
        "contact": {},
        "load": {"steps": [4], "factors": {"press": [1.0]}},
        "solver": {"tolerance": 1e-11},
    }
    return Scene(**{**keys, **changes})


def orders(residuals: list[float]) -> list[float]:
    """Orders of convergence from three residuals in a row, where they fall and rounding has no say."""
    r = np.array(residuals)
    return [
        float(np.log(r[i + 1] / r[i]) / np.log(r[i] / r[i - 1]))
        for i in range(1, len(r) - 1)
        if r[i - 1] < 0.1 and r[i] < 0.1 * r[i - 1] and 1e-11 < r[i + 1]
    ]


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"mesh": {"size": 0.15, "contact_size": 0.05, "order": 2}},
        {"model": {"kinematics": "finite"}},
        {"contact": {"adhesion": {"law": "bilinear", "strength": 40.0, "energy": 0.4}}},
    ],
    ids=["small", "order 2", "finite", "adhesion"],
)
def test_the_end_of_a_step_is_quadratic(changes: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the set of points in contact has settled, the order is that of Newton's method or better."""
    # With predictions there are too few iterations to tell an order from.
    monkeypatch.setattr(active_set_prediction, "MAX_PREDICTIONS", 0)
    residuals = [solve.residuals for report in reports(pressed(**changes), MPI.COMM_SELF) for solve in report.solves]
    last = [order[-1] for order in map(orders, residuals) if order]
    assert len(last) >= 1 and max(last) >= 1.8


def test_a_projection_at_a_vertex_of_the_master_does_not_stall() -> None:
    """Equal facets on both sides, shifted sideways by bits of a facet: points sit next to the master's vertices."""
    for shift in (0.0, 1e-4, 3e-3, 0.0149):
        boundaries = [
            {"on": "bottom", "displacement": [0, 0], "potential": 0},
            {"on": "top", "displacement": [shift, -0.02], "follows": "press"},
        ]
        history = run(pressed(boundaries=boundaries, solver={}), MPI.COMM_SELF).history
        assert all(row["cutbacks"] == 0 and row["newton"] <= 9 for row in history)
