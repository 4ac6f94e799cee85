"""Snap-through: which parts of a step take it for one, counted in evaluations of contact."""

from __future__ import annotations

from typing import Any

import pytest
from mpi4py import MPI

from piezomat.solver.load_steps import steps
from tests.marching import stepper_of
from tests.scenes import pressed

MOST = (
    20  # evaluations of a step in which bodies are apart: 8 were counted, and 262 where rounding was taken for a snap
)

BONDS = {"law": "bilinear", "strength": 40.0, "energy": 0.2}
APART = 0.5  # load factor up to which no body is within reach of the other's bonds


@pytest.mark.parametrize(
    ("dimension", "adhesion"), [(2, BONDS), (2, None), pytest.param(3, BONDS, marks=pytest.mark.slow)]
)
def test_steps_of_bodies_apart_cost_less_than_those_in_contact(dimension: int, adhesion: dict[str, Any] | None) -> None:
    """Before contact and after it, where no bond is left."""
    load = {"steps": [8, 16], "factors": {"press": [1.0, -1.0]}}
    geometry = {**pressed(dimension).geometry.model_dump(exclude_unset=True), "gap": 0.032}
    scene = pressed(dimension, contact={"adhesion": adhesion} if adhesion else {}, load=load, geometry=geometry)
    apart, touching = [], []
    with stepper_of(scene, MPI.COMM_SELF) as stepper:
        contact, calls = stepper.terms.contact, []
        evaluate = contact.evaluate

        def counted(*arguments: Any, **keys: Any) -> Any:
            calls.append(1)
            return evaluate(*arguments, **keys)

        contact.evaluate = counted
        for step in steps(scene.load):
            calls.clear()
            stepper.advance(step, lambda part: None)
            nearest = max(step.before["press"], step.after["press"])
            (apart if nearest <= APART else touching).append(len(calls))
    assert max(apart) <= min(MOST, max(touching))
