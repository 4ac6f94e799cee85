"""The search for closest points: bonds of points that leave the other surface."""

from __future__ import annotations

import pytest
from mpi4py import MPI

from piezomat.simulation import run
from tests.scenes import blocks


def test_bonds_tear_where_a_point_leaves_the_surface() -> None:
    """Slid sideways, the part of the upper block that has left the lower one is no longer bonded."""
    scene = blocks(
        boundaries=[
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": ["free", -0.001]},
            {"on": "top", "displacement": [0.6, "free"], "follows": "slide"},
        ],
        contact={"adhesion": {"law": "bilinear", "strength": 1.0, "energy": 0.01}},
        load={"steps": [1, 12], "factors": {"slide": [0.0, 1.0]}},
    )
    history = run(scene, MPI.COMM_SELF).history
    assert history[0]["bonded_area@lower-upper"] == pytest.approx(1.0, rel=1e-9)
    assert history[-1]["bonded_area@lower-upper"] < 0.6
