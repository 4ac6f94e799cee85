"""Convergence: steps without a load, or without a change, end at once."""

from __future__ import annotations

import pytest
from mpi4py import MPI

from piezomat.simulation import run
from tests.scenes import blocks


@pytest.mark.parametrize("tilt", [0.0, 30.0])
def test_a_step_without_any_load_ends_at_once(tilt: float) -> None:
    """Gaps that are zero but for rounding were held against no force at all."""
    geometry = {"shape": "stacked_blocks", "height": [0.5, 0.5], "divisions": [[3, 3], [4, 4]], "tilt": tilt}
    boundaries = [{"on": "bottom", "displacement": [0, 0]}, {"on": "top", "displacement": [0, 0]}]
    last = run(blocks(geometry=geometry, boundaries=boundaries), MPI.COMM_SELF).history[-1]
    assert abs(last["force_y@top"]) < 1e-8 and last["cutbacks"] == 0


def test_a_step_that_changes_nothing_ends_at_once() -> None:
    boundaries = [
        {"on": "bottom", "displacement": [0, 0]},
        {"on": "right", "traction": [1.0, 0.0], "follows": "pull"},
    ]
    load = {"steps": [1, 1], "factors": {"pull": [1.0, 1.0]}}
    geometry = {"shape": "cantilever", "length": 2.0, "layers": [0.5], "divisions": [4, 2]}
    scene = blocks(
        geometry=geometry,
        bodies={"layer_1": "soft"},
        boundaries=[{**boundaries[0], "on": "root"}, {**boundaries[1], "on": "tip"}],
        contact=None,
        load=load,
    )
    first, second = run(scene, MPI.COMM_SELF).history
    assert second["elastic"] == pytest.approx(first["elastic"], rel=1e-12)
