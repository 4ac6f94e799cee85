"""The contact patch test of `method = "segment"`: uniform pressure crosses any two meshes exactly."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from app.output import FieldOutput
from app.scene import Scene
from app.simulation import run
from tests.references import contact_patch_stress
from tests.scenes import press

YOUNG, HEIGHTS, SHORTENING, TILT = 1e6, (0.3, 0.7), 0.01, 20.0
PENALTY = 1e3 * YOUNG

FLAT = [([1, 1], [1, 2]), ([3, 2], [2, 1]), ([2, 1], [3, 2]), ([7, 2], [5, 1])]
SOLID = [([1, 1, 1], [1, 1, 1]), ([3, 2, 1], [2, 3, 1]), ([2, 2, 1], [3, 1, 1])]


def patch(divisions: tuple[list[int], list[int]], cells: str, order: int, passes: int, tilt: float = 0.0) -> Scene:
    """Two blocks, one on the other, tilted as a whole, their far faces moved towards each other; nu = 0."""
    dim = len(divisions[0])
    up = np.zeros(dim)
    up[0], up[-1] = -np.sin(np.radians(tilt)), np.cos(np.radians(tilt))
    geometry = {"shape": "stacked_blocks", "height": list(HEIGHTS), "divisions": list(divisions), "tilt": tilt}
    if dim == 3:
        geometry["depth"] = 0.8
    return press(
        geometry,
        mesh={"cells": cells, "order": order},
        materials={"block": {"young": YOUNG, "poisson": 0}},
        bodies={"lower": "block", "upper": "block"},
        boundaries=[
            {"on": "bottom", "displacement": [0.0] * dim},
            {"on": "top", "displacement": (-SHORTENING * up).tolist()},
        ],
        contact={"method": "segment", "passes": passes, "normal_penalty": PENALTY},
        solver={"tolerance": 1e-12},
    )


def stress_error(scene: Scene, comm: MPI.Comm, tilt: float) -> float:
    """Greatest error of any stress component in the middle of any element, over the exact pressure."""
    stress = FieldOutput(run(scene, comm).model).piece().stress
    exact = contact_patch_stress(YOUNG, HEIGHTS, SHORTENING, PENALTY)
    s, c = np.sin(np.radians(tilt)), np.cos(np.radians(tilt))
    dim = scene.dimension
    # Voigt 11 22 33 23 13 12 of exact * up x up, up being the last axis of the stack.
    expected = np.array([s * s, c * c, 0, 0, 0, -s * c] if dim == 2 else [s * s, 0, c * c, 0, -s * c, 0]) * exact
    worst = float(np.abs(stress - expected).max(initial=0.0)) / abs(exact)
    return comm.allreduce(worst, op=MPI.MAX)


@pytest.mark.mpi
@pytest.mark.parametrize("passes", [1, 2])
@pytest.mark.parametrize("tilt", [0.0, TILT])
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("cells", ["simplex", "tensor"])
@pytest.mark.parametrize("divisions", FLAT, ids=str)
def test_in_two_dimensions(
    comm: MPI.Comm, divisions: tuple[list[int], list[int]], cells: str, order: int, tilt: float, passes: int
) -> None:
    assert stress_error(patch(divisions, cells, order, passes, tilt), comm, tilt) < 1e-10


@pytest.mark.mpi
@pytest.mark.parametrize(("passes", "tilt"), [(1, TILT), (2, 0.0)])
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("cells", ["simplex", "tensor"])
@pytest.mark.parametrize("divisions", SOLID, ids=str)
def test_in_three_dimensions(
    comm: MPI.Comm, divisions: tuple[list[int], list[int]], cells: str, order: int, tilt: float, passes: int
) -> None:
    assert stress_error(patch(divisions, cells, order, passes, tilt), comm, tilt) < 1e-10
