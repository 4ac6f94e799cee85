"""Prescription: the largest motion and voltage of boundaries and planes over the load stages."""

from __future__ import annotations

from typing import Any

import pytest
from mpi4py import MPI

from tests.discretization.models import blocks

pytestmark = pytest.mark.mpi

BOUNDARIES: list[dict[str, Any]] = [
    {"on": "bottom", "displacement": ["free", 0.1], "potential": -2.0},
    {"on": "right", "displacement": [0.3, "free"], "follows": "push"},
]
LID = {"name": "lid", "point": "top", "motion": [0, -0.4], "follows": "press"}
LOAD = {"steps": [1, 2], "factors": {"push": [-2.0, 1.0], "press": [0.0, 0.5]}}


def test_motion_is_that_of_boundaries_and_planes(comm: MPI.Comm) -> None:
    """What does not follow a load factor has moved from the start, and does not move between two load levels."""
    given = blocks(comm, boundaries=BOUNDARIES, planes=[LID], load=LOAD).prescription
    assert given.motion({"push": 0.0, "press": 0.0}) == pytest.approx(0.1)
    assert given.motion({"push": 1.0, "press": 1.0}) == pytest.approx(0.4)
    assert given.motion({"push": 1.0, "press": 1.0}, {"push": 0.0, "press": 0.9}) == pytest.approx(0.3)
    assert given.motion({"push": 1.0, "press": 1.0}, {"push": 1.0, "press": 1.0}) == 0.0
    assert given.largest_motion() == pytest.approx(0.6)


def test_voltage_is_between_what_is_given_at_once(comm: MPI.Comm) -> None:
    """At the ends of the stages the lid has -6 and 3 V; without it there is one potential, and no voltage."""
    lid = LID | {"potential": 3.0, "potential_follows": "push"}
    assert blocks(comm, boundaries=BOUNDARIES, planes=[lid], load=LOAD).prescription.largest_voltage() == 5.0
    load = {"steps": [1], "factors": {"push": [1.0]}}
    assert blocks(comm, boundaries=BOUNDARIES, load=load).prescription.largest_voltage() == 0.0
