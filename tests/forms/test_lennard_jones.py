"""The Lennard-Jones law: closed forms, derivatives, where penalty and tail take over, and blocks that follow it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.forms.arrays import Array
from piezomat.forms.contact.laws.equal_potential import EqualPotential
from piezomat.forms.contact.laws.law import ContactLaw
from piezomat.forms.contact.laws.lennard_jones import CUTOFF_START, LennardJones
from piezomat.forms.contact.laws.response import Response
from piezomat.scene import Scene
from piezomat.simulation import run
from piezomat.solver.load_steps import SNAP_CUTBACKS
from tests.derivative import slope
from tests.scenes import press
from tests.verification import references as ref

STRENGTH, ENERGY, PENALTY = 5.0, 0.05, 2e5
LAW = LennardJones.of(STRENGTH, ENERGY, np.array([PENALTY]))
EXACT = ref.LennardJones(LAW.hamaker, LAW.distance)


def interface(points: int, electric: bool = False) -> ContactLaw:
    """The law with the same constants at every point."""
    law = LAW[np.zeros(points, int)]
    equal = EqualPotential(np.full(points, 0.3), np.full(points, 0.004), rest_gap=LAW.equilibrium_gap)
    return law + equal if electric else law


def respond(gap: Array) -> Response:
    law = interface(len(gap))
    return law.respond(gap[:, None], law.virgin(len(gap)))


def traction(gap: Array) -> Array:
    return respond(gap).traction


def test_the_traction_is_that_of_the_reference() -> None:
    gap = np.linspace(LAW.near[0], CUTOFF_START * LAW.distance, 500)
    np.testing.assert_allclose(traction(gap), [-EXACT.pressure(g) for g in gap], rtol=1e-12, atol=1e-12 * STRENGTH)


def test_rest_strongest_pull_and_work_are_the_closed_forms() -> None:
    assert pytest.approx(EXACT.equilibrium, rel=1e-13) == LAW.equilibrium_gap
    assert pytest.approx(EXACT.pull, rel=1e-13) == STRENGTH
    assert traction(np.array([EXACT.pull_gap]))[0] == pytest.approx(STRENGTH, rel=1e-13)
    gap = np.linspace(LAW.near[0], LAW.interaction_range, 200_001)
    assert traction(gap).max() == pytest.approx(STRENGTH, rel=1e-6)
    # The energy is the work up to the end of the tail; without an end it would be 1.1 % more.
    opening = np.linspace(LAW.equilibrium_gap, LAW.interaction_range, 400_001)
    values = traction(opening)
    assert (values[:-1] + values[1:]).sum() * np.diff(opening)[0] / 2 == pytest.approx(ENERGY, rel=1e-6)
    assert EXACT.work == pytest.approx(ENERGY, rel=0.012)
    # The steepest fall, which a drag must outdo.
    falls = -np.diff(values) / np.diff(opening)
    assert falls.max() == pytest.approx(float(LAW.softening(LAW.virgin(1))[0]), rel=1e-4)


@pytest.mark.parametrize("electric", [False, True])
def test_slopes_are_derivatives_of_the_energy(electric: bool, rng: np.random.Generator) -> None:
    """From deep penetration through the law to beyond its end."""
    r0 = LAW.distance
    gap = np.concatenate([rng.uniform(-0.2, 2.0, 400), rng.uniform(2.0, 2.2 * CUTOFF_START, 400)]) * r0
    kinks = np.array([LAW.near[0], CUTOFF_START * r0, 2.0 * CUTOFF_START * r0, LAW.equilibrium_gap])
    gap = gap[np.abs(gap[:, None] - kinks).min(axis=1) > 1e-4 * r0]
    law = interface(len(gap), electric)
    q, history, h = np.zeros((len(gap), 1 + electric)), law.virgin(len(gap)), 1e-5 * r0
    q[:, 0], q[:, 1:] = gap, rng.uniform(-2.0, 2.0, (len(gap), int(electric)))

    def at(change: float) -> Response:
        return law.respond(q + change * np.eye(1 + electric)[0], history)

    r = at(0.0)
    np.testing.assert_allclose(r.traction, slope(lambda h: at(h).enthalpy, h), rtol=1e-7, atol=1e-7 * STRENGTH)
    stiffness = slope(lambda h: at(h).traction, h)
    np.testing.assert_allclose(r.hessian[:, 0, 0], stiffness, rtol=1e-6, atol=1e-6 * STRENGTH / r0)


def test_law_penalty_and_tail_meet_with_one_slope() -> None:
    for place in (LAW.near[0], CUTOFF_START * LAW.distance, 2.0 * CUTOFF_START * LAW.distance):
        gap = place + np.array([-1e-9, 1e-9]) * LAW.distance
        r = respond(gap)
        assert r.traction[1] - r.traction[0] == pytest.approx(0.0, abs=1e-5 * STRENGTH)
        assert r.hessian[1, 0, 0] == pytest.approx(r.hessian[0, 0, 0], abs=1e-5 * PENALTY)
    np.testing.assert_allclose(respond(np.array([-1e-3, 0.0])).hessian, PENALTY, rtol=1e-14)
    assert not traction(np.array([2.0 * CUTOFF_START * LAW.distance])).any()
    assert interface(1).interaction_range == pytest.approx(2.0 * CUTOFF_START * LAW.distance)


def test_stored_energy_is_zero_far_off_and_lowest_at_rest() -> None:
    gap = np.array([1e30, LAW.equilibrium_gap, 0.9 * LAW.equilibrium_gap])
    r = respond(gap)
    np.testing.assert_allclose(r.energy("adhesion"), [0.0, -ENERGY, -ENERGY], atol=1e-12 * ENERGY)
    contact = r.energy("contact")
    assert contact[2] > 0.0 and contact[0] == contact[1] == 0.0
    assert not r.energy("dissipated").any()


def test_nothing_is_remembered_and_potentials_are_joined_where_surfaces_rest() -> None:
    law = interface(3, electric=True)
    gap = LAW.equilibrium_gap + np.array([-0.0021, 0.0, 0.0041])
    q = np.column_stack([gap, np.ones(3)])
    history = law.committed(q, law.virgin(3))
    assert not history.size and not law.bonded(history).any()
    np.testing.assert_array_equal(law.status(gap, history), [1, 1, 0])
    charge = law.respond(q, history).charge
    np.testing.assert_allclose(charge, [-0.3, -0.15, 0.0], rtol=1e-13)


def test_a_penalty_softer_than_the_law_is_an_error() -> None:
    at_rest = (EXACT.pressure(LAW.equilibrium_gap * (1 - 1e-6)) - EXACT.pressure(LAW.equilibrium_gap * (1 + 1e-6))) / (
        2e-6 * LAW.equilibrium_gap
    )
    LennardJones.of(STRENGTH, ENERGY, np.array([1.001 * at_rest]))
    with pytest.raises(ValueError, match="softer than the law at rest"):
        LennardJones.of(STRENGTH, ENERGY, np.array([1.001 * at_rest, 0.999 * at_rest]))


def attracting_blocks(young: float, divisions: int, gap: float, load: dict[str, Any], tolerance: float) -> Scene:
    """Two blocks of `divisions` cells, `gap` apart, that the load brings together."""
    return press(
        {"shape": "stacked_blocks", "height": [0.5, 0.5], "divisions": [[divisions, 1]] * 2, "gap": gap},
        mesh={"cells": "tensor"},
        materials={"block": {"young": young, "poisson": 0.0}},
        bodies={"lower": "block", "upper": "block"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": ["free", -1], "follows": "approach"},
            {"on": "left", "displacement": [0, "free"]},
        ],
        contact={
            "normal_penalty": PENALTY,
            "adhesion": {"law": "lennard_jones", "strength": STRENGTH, "energy": ENERGY},
        },
        load=load,
        solver={"tolerance": tolerance},
    )


@pytest.mark.mpi
def test_blocks_attract_and_repel_as_the_law_says(comm: MPI.Comm) -> None:
    """Two stiff blocks brought together from beyond the law's reach and pressed: at each step the force is T(gap)."""
    young, start, r0 = 1e6, 2.2 * CUTOFF_START * LAW.distance, LAW.distance
    load = {"steps": [20, 20], "factors": {"approach": [start - 2.0 * r0, start - 0.55 * r0]}}
    # The tolerance is relative to the forces that the stiff blocks bear at the start of a step.
    scene = attracting_blocks(young, 3, start, load, tolerance=1e-13)
    history = run(scene, comm).history
    force = np.array([row["force_y@top"] for row in history])
    gap = start - np.array([row["factor:approach"] for row in history]) - force / young
    assert force.max() > 0.9 * STRENGTH and force.min() < -STRENGTH
    np.testing.assert_allclose(force, traction(gap), atol=1e-6 * STRENGTH)
    inside = (gap > LAW.near[0]) & (gap < CUTOFF_START * r0)
    assert inside.sum() > 25
    expected = [-EXACT.pressure(g) for g in gap[inside]]
    np.testing.assert_allclose(force[inside], expected, atol=1e-6 * STRENGTH)
    # What the blocks rest at counts as contact, and the stored energy is the work done, as coarse steps sum it up.
    assert history[-1]["contact_area@lower-upper"] == pytest.approx(1.0)
    row = history[-1]
    stored = row["elastic"] + row["contact"] + row["adhesion"]
    assert stored == pytest.approx(row["external_work"], abs=0.1 * ENERGY)
    assert row["adhesion"] == pytest.approx(-ENERGY, rel=1e-9)
    assert row["dissipated"] == 0.0


COMPLIANCE = 3.0 / float(LAW.softening(LAW.virgin(1))[0])  # of both blocks, 1 um together: the inverse modulus


def soft_blocks(steps: int) -> Scene:
    """Blocks softer than the law's fall, brought together and apart: the distance is start - approach."""
    r0, start = LAW.distance, 2.2 * CUTOFF_START * LAW.distance
    load = {"steps": [steps, steps], "factors": {"approach": [start - 0.6 * r0, start - 6.0 * r0]}}
    return attracting_blocks(1.0 / COMPLIANCE, 2, start, load, tolerance=1e-11)


@pytest.fixture(scope="module")
def snapping() -> list[dict[str, Any]]:
    """The history of soft blocks in a hundred steps each way."""
    return run(soft_blocks(100), MPI.COMM_SELF).history


def test_soft_blocks_snap_in_and_off_to_the_right_branch(snapping: list[dict[str, Any]]) -> None:
    """Blocks softer than the law's fall: they follow the far branch in, the near one out, and jump where each ends."""
    r0, history = LAW.distance, snapping
    steps, start = len(history) // 2, 2.2 * CUTOFF_START * r0
    gap = np.linspace(0.4 * r0, 12.0 * r0, 100_001)
    distance = gap + COMPLIANCE * traction(gap)  # between the blocks' far ends, less their height
    expected = []
    for row in history:
        off = start - row["factor:approach"] - distance
        crossings = np.flatnonzero(off[:-1] * off[1:] <= 0.0)
        i = crossings[-1 if row["step"] <= steps else 0]
        expected.append(traction(gap[i : i + 1] + off[i] / (off[i] - off[i + 1]) * (gap[1] - gap[0]))[0])
    force = np.array([row["force_y@top"] for row in history])
    np.testing.assert_allclose(force, expected, atol=1e-5 * STRENGTH)
    # It snaps: the pull on the way out is greater than ever on the way in, and ends at once.
    assert force[steps:].max() > 1.4 * force[:steps].max()  # 5.0 and 3.4 uN
    assert -np.diff(force[steps:]).min() > 0.5 * STRENGTH


def test_what_a_snap_sets_free_is_found_whether_or_not_a_drag_leads_through_it(snapping: list[dict[str, Any]]) -> None:
    """Snap-in and snap-off release the energy of the closed form within 2 %, and the energy balance is closed.

    The drag leads through the snap-in, and Newton's method finds the other side of the snap-off by itself, with a step
    cut once: what is set free without a drag must not be lost.
    """
    history = snapping
    gap = np.linspace(0.6 * LAW.distance, 11.0 * LAW.distance, 100_001)
    r = respond(gap)
    distance = gap + COMPLIANCE * r.traction
    energy = r.enthalpy + 0.5 * COMPLIANCE * r.traction**2
    turns = np.flatnonzero(np.diff(np.sign(np.diff(distance)))) + 1
    off, on = turns[0], turns[-1]  # the near branch ends at a greatest distance, the far one at a least
    to = [np.flatnonzero(np.diff(np.sign(distance - distance[k]))) for k in (off, on)]
    expected = energy[off] - energy[to[0][-1]] + energy[on] - energy[to[1][0]]
    last = history[-1]
    assert last["stabilization"] == pytest.approx(expected, rel=0.02)
    stored = sum(last[name] for name in ("elastic", "contact", "adhesion", "dissipated"))
    assert last["external_work"] == pytest.approx(stored + last["stabilization"], abs=0.02 * expected)
    snaps = np.flatnonzero(np.diff([row["stabilization"] for row in history]) > 0.01 * expected) + 1
    assert [history[k]["cutbacks"] >= SNAP_CUTBACKS for k in snaps] == [True, False]
