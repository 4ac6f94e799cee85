"""Line search: trials leave the state of Newton's method alone."""

from __future__ import annotations

import pytest
from mpi4py import MPI

from piezomat.simulation import run
from tests.scenes import blocks


def test_finite_kinematics_press_like_small_ones_where_little_moves() -> None:
    """The line search evaluated its trials in Newton's own state."""
    forces = []
    for kinematics in ("small", "finite"):
        boundaries = [
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": [0, -1e-4]},
        ]
        scene = blocks(boundaries=boundaries, model={"kinematics": kinematics})
        forces.append(run(scene, MPI.COMM_SELF).history[-1]["contact_force_y@lower-upper"])
    assert forces[1] == pytest.approx(forces[0], rel=1e-3) and forces[0] < -0.05
