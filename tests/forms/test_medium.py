"""The medium in the gaps: one energy, a capacitor eps/g of open gaps, two parts that add up, closed and far ends."""

from __future__ import annotations

import numpy as np
import pytest

from piezomat.forms.arrays import Array
from piezomat.forms.contact.laws.medium import AIR, CLOSED, CUT, LARGEST_GAP, Medium, closed_gap
from piezomat.forms.contact.laws.penalty import NormalPenalty
from piezomat.forms.contact.laws.response import Response
from piezomat.forms.materials import VACUUM_PERMITTIVITY
from tests.derivative import slope

CLOSED_GAP, REACH, NEAR, STIFFNESS = 0.001, 0.5, 0.02, 1e4


def medium(points: int, part: str = "whole", switch: float = 0.0) -> Medium:
    """Air at some points, or the part of it that is near or the rest."""
    near = None if part == "whole" else np.full(points, NEAR)
    switched = np.full(points, switch) if switch else None
    return Medium(np.full(points, AIR), CLOSED_GAP, REACH, near, part == "rest", switch=switched)


def gaps() -> Array:
    """From pressed to beyond the reach, away from where second derivatives jump."""
    gap = np.concatenate([np.linspace(-0.01, 0.03, 401), np.linspace(0.03, 0.6, 300)]) + 1e-5
    return gap[np.min([np.abs(gap - kink) for kink in (0.0, NEAR, CUT * REACH, REACH)], axis=0) > 3e-6]


@pytest.mark.parametrize(("part", "switch"), [("whole", 0.0), ("near", 0.0), ("rest", 0.0), ("whole", 0.02)])
def test_gradient_and_hessian_are_derivatives_of_the_energy(part: str, switch: float, rng: np.random.Generator) -> None:
    gap = gaps()
    law = NormalPenalty(np.full(len(gap), STIFFNESS)) + medium(len(gap), part, switch)
    q, virgin = np.column_stack([gap, rng.uniform(-3.0, 3.0, len(gap))]), law.virgin(len(gap))

    def at(more_gap: float, more_jump: float = 0.0) -> Response:
        return law.respond(q + [more_gap, more_jump], virgin)

    r, (stiffness, mixed), (_, curvature) = at(0.0), *at(0.0).hessian.transpose(1, 2, 0)
    np.testing.assert_allclose(r.traction, slope(lambda h: at(h).enthalpy, 1e-7), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(stiffness, slope(lambda h: at(h).traction, 1e-7), rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(r.charge, slope(lambda h: at(0.0, h).enthalpy, 1e-2), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(curvature, slope(lambda h: at(0.0, h).charge, 1e-2), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(mixed, slope(lambda h: at(h).charge, 1e-7), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(mixed, slope(lambda h: at(0.0, h).traction, 1e-2), rtol=1e-9, atol=1e-9)


def test_an_open_gap_is_a_plate_capacitor_and_a_closed_one_is_finite() -> None:
    gap = np.array([-1.0, 0.0, 0.003, 0.1, 0.3, CUT * REACH, REACH, 2.0])
    capacitance, falls, _ = medium(len(gap)).capacitance(gap)
    np.testing.assert_allclose(capacitance[:2], VACUUM_PERMITTIVITY / CLOSED_GAP, rtol=1e-14)
    np.testing.assert_allclose(falls[:2], 0.0, atol=1e-16)
    root = np.hypot(gap[2:6], CLOSED_GAP)
    np.testing.assert_allclose(capacitance[2:6], VACUUM_PERMITTIVITY / root, rtol=1e-14)
    assert not capacitance[6:].any() and not falls[6:].any()


def test_its_two_parts_add_up_and_are_apart_where_they_end() -> None:
    gap = gaps()
    whole, near, rest = (medium(len(gap), part).capacitance(gap) for part in ("whole", "near", "rest"))
    for one, other, both in zip(near, rest, whole, strict=True):
        np.testing.assert_allclose(one + other, both, rtol=1e-12, atol=1e-12 * np.abs(both).max())
    assert not near[0][gap > NEAR].any() and not rest[0][gap <= 0.0].any()
    assert medium(1, "near").interaction_range == NEAR and medium(1, "rest").interaction_range == REACH


def test_without_pull_the_capacitance_is_a_given_function() -> None:
    q = np.array([[0.002, 1.0], [0.05, -2.0]])
    law = Medium(np.full(2, AIR), CLOSED_GAP, REACH, pulls=False)
    r, pulling = (one.respond(q, one.virgin(2)) for one in (law, medium(2)))
    np.testing.assert_array_equal(r.charge, pulling.charge)
    assert not r.traction.any() and not r.hessian[:, 0].any() and pulling.traction.all()


def test_the_default_closes_a_gap_as_far_as_the_bodies_ask_for() -> None:
    """PVDF of 1 um: 0.8 nm; PZT-5H: 0.007 nm; of thick plastic no more than 1 nm."""
    for relative, thickness, expected in (
        (12.0, 1.0, 1.0 / (CLOSED * 12.0)),
        (1470.0, 1.0, 6.8e-6),
        (3.0, 9.0, LARGEST_GAP),
    ):
        found = closed_gap(AIR, relative * VACUUM_PERMITTIVITY / thickness)
        assert found == pytest.approx(expected, rel=1e-2)
