"""The converged state is one of the true surface, not of the path: neither steps, nor ranks, nor sides matter."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.scene import Scene
from piezomat.simulation import Run, run
from tests.histories import Rows
from tests.scenes import pressed

pytestmark = pytest.mark.mpi

AXES = "xyz"
AIR: dict[str, Any] = {"passes": 1, "normal_penalty": 1e5}
LAW = AIR | {"electric_penalty": 0.1, "electric_range": 0.002}


def crossed(size: float, steps: int, sideways: tuple[float, float], **keys: Any) -> Scene:
    """Half cylinders of tetrahedra, one pass, with several facets across the contact."""
    return Scene(
        geometry={"shape": "crossed_fibers"},
        mesh={"contact_size": size, "size": 0.25, "size_factors": {"upper": 0.9}},
        bodies={"lower": "pvdf", "upper": "pvdf"},
        boundaries=[
            {"on": "bottom", "displacement": [0.0, 0.0, 0.0], "potential": 0.0},
            {"on": "top", "displacement": [*sideways, -0.05], "follows": "press"},
        ],
        load={"steps": [steps], "factors": {"press": [1.0]}},
        output={"fields": "none", "picture": False},
        **{"contact": LAW, **keys},
    )


def answer(history: Rows) -> np.ndarray:
    """Forces, over the largest, and the potential of the last step, over itself."""
    row = history[-1]
    forces = np.array([row[f"force_{axis}@top"] for axis in AXES])
    return np.append(forces / 20.0, row["mean_potential@top"] / 9.0)


def shared(result: Run) -> int:
    """Number of pressed points that several facets share."""
    count = 0
    for p in result.contact.surface_pairs:
        count += int((p.projection.gap[p.shared.row] < 0.0).sum())
    return result.problem.comm.allreduce(count)


@pytest.mark.parametrize(
    ("size", "sideways", "contact"),
    [
        (0.07, (0.0, 0.0), LAW),
        (0.06, (0.01, 0.0), LAW),
        (0.07, (0.01, 0.0), LAW | {"smoothing": True}),
        (0.07, (0.0, 0.0), AIR),
        (0.06, (0.01, 0.0), AIR),
    ],
)
def test_two_paths_end_alike_on_all_ranks(
    size: float, sideways: tuple[float, float], contact: dict[str, Any], comm: MPI.Comm
) -> None:
    """Points stayed on facets that they had left: 4e-4 in force, a third of the force sideways, 2.5e-4 in potential."""
    given = {"contact": contact, "solver": {"kind": "direct", "tolerance": 1e-10}}
    one = answer(run(crossed(size, 3, sideways, **given), MPI.COMM_SELF).history)
    result = run(crossed(size, 5, sideways, **given), comm)
    assert shared(result) > 5
    np.testing.assert_allclose(answer(result.history), one, atol=1e-8)
    assert abs(one[:2]).max() > 1e-4


def test_inexact_linear_solves_end_alike_on_all_ranks(comm: MPI.Comm) -> None:
    solver = {"kind": "iterative", "tolerance": 1e-9}
    one = answer(run(crossed(0.07, 3, (0.0, 0.0), solver=solver), MPI.COMM_SELF).history)
    two = answer(run(crossed(0.07, 3, (0.0, 0.0), solver=solver), comm).history)
    direct = answer(run(crossed(0.07, 5, (0.0, 0.0), solver={"kind": "direct", "tolerance": 1e-10}), comm).history)
    np.testing.assert_allclose(two, one, atol=1e-7)
    np.testing.assert_allclose(two, direct, atol=1e-7)


@pytest.mark.parametrize("medium", ["none", "air"])
@pytest.mark.parametrize("passes", [1, 2])
@pytest.mark.parametrize("factor", [1.0, 1.5])
def test_mirror_symmetry_where_a_node_is_over_a_vertex(factor: float, passes: int, medium: str, comm: MPI.Comm) -> None:
    """One of the two facets that a node was over took it: 1 % of the force acted sideways."""
    scene = pressed(
        2,
        mesh={"size": 0.2, "contact_size": 0.06, "cells": "tensor", "size_factors": {"upper": factor}},
        contact={"method": "node", "passes": passes, "medium": medium},
    )
    for row in run(scene, comm).history:
        assert abs(row["force_x@top"]) < 1e-9 * abs(row["force_y@top"])
        assert abs(row["force_y@top"]) > 1.0
