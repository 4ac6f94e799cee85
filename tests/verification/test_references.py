"""The closed forms against their published or independently derived numbers, to every printed digit."""

from __future__ import annotations

import math
from decimal import Decimal
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize_scalar

from tests.verification import references as ref


def printed(text: str) -> Any:
    """What a number printed so may be: within half a unit of its last digit."""
    exponent = Decimal(text).as_tuple().exponent
    assert isinstance(exponent, int)
    return pytest.approx(float(text), rel=1e-12, abs=0.5 * 10.0**exponent)


@pytest.mark.parametrize(
    ("lateral", "circuit", "strain", "other"),
    [
        ("free", "short", ("1.2e-4", "1.2e-4", "-4e-4"), "3.3e-5"),
        ("free", "open", ("1.1336e-4", "1.1909e-4", "-3.9004e-4"), "-0.3016871"),
        ("fixed", "short", ("0", "0", "-2.971429e-4"), "2.228571e-5"),
        ("fixed", "open", ("0", "0", "-2.925409e-4"), "-0.2064990"),
    ],
)
def test_uniform_states(lateral: Any, circuit: Any, strain: tuple[str, ...], other: str) -> None:
    state = ref.uniform_state(ref.PVDF, lateral, circuit, -1.0)
    assert list(state.strain[:3]) == [printed(text) for text in strain]
    assert (state.displacement if circuit == "short" else state.field)[2] == printed(other)
    assert state.stress[2] == pytest.approx(-1)
    assert np.abs(state.field if circuit == "short" else state.displacement).max() < 1e-15


def test_material_of_the_fiber_papers() -> None:
    assert ref.PVDF.permittivity == printed("1.0625025e-4")
    c33 = ref.PVDF.stiffness[2, 2]
    assert ref.PVDF.e33**2 / (c33 * ref.PVDF.permittivity) == printed("0.0157")
    assert math.sqrt(ref.PVDF.young / ref.PVDF.permittivity) / 1e3 == printed("4.85")
    # d = e C^-1 = (22, 3, -33) pm/V, as the printed e follows from it.
    assert np.linalg.solve(ref.PVDF.stiffness, ref.PVDF.piezo[2])[:3] * 1e6 == pytest.approx([22, 3, -33], abs=1e-3)


@pytest.mark.parametrize(
    ("ratio", "gap", "jump", "stress", "displacement"),
    [
        (1000, "-5.108858e-7", "1.471664e-4", "-1.719327", "-1.563647e-5"),
        (100, "-5.085834e-6", "1.481141e-3", "-1.711579", "-1.573716e-5"),
        (10, "-4.866367e-5", "1.564143e-2", "-1.637720", "-1.661906e-5"),
        (math.inf, "0", "0", "-1.7201923", "-1.5625127e-5"),
    ],
)
def test_two_layers_in_contact(ratio: float, gap: str, jump: str, stress: str, displacement: str) -> None:
    layer = ref.Layer.of(ref.PVDF, 1.0)
    state = ref.layer_stack([layer] * 2, -1e-3, 1.0, ratio * layer.stiffness, ratio * layer.permittivity)
    assert (state.gap, state.jump) == (printed(gap), printed(jump))
    assert (state.stress, state.displacement) == (printed(stress), printed(displacement))


def test_two_layers_with_the_other_sign_are_singular() -> None:
    layer = ref.Layer(1.0, 3000.0, 0.0, 1e-4)
    with pytest.raises(np.linalg.LinAlgError):
        ref.layer_stack([layer] * 2, -1e-3, 1.0, 1e5, layer.permittivity / 2, electric_sign=1.0)


def test_contact_patch() -> None:
    assert ref.contact_patch_stress(1e6, [0.5, 0.5], 0.01, math.inf) == pytest.approx(-1e4, rel=1e-14)
    assert ref.contact_patch_stress(1e6, [0.5, 0.5], 0.01, 1e8) == pytest.approx(-0.01 / (1e-6 + 1e-8))


def test_bimorph() -> None:
    theory = [ref.bimorph_deflection(ref.PVDF_TZOU, x * 1e3, 1e3, 1.0, coupled=False) for x in range(20, 101, 20)]
    assert theory == [printed(text) for text in ("0.0138", "0.0552", "0.1242", "0.2208", "0.3450")]
    assert ref.bimorph_deflection(ref.PVDF_TZOU, 1e5, 1e3, 1.0, coupled=True) == printed("0.344143")


def test_hertz_line() -> None:
    assert ref.PVDF.contact_modulus == printed("1373.626")
    radius = ref.relative_radius(0.5, 0.5)
    one, four = (ref.hertz_line(load, radius, ref.PVDF.contact_modulus) for load in (1.0, 4.0))
    assert (one.size, one.peak) == (printed("0.0152227"), printed("41.8205"))
    assert (four.size, four.peak) == (pytest.approx(2 * one.size), pytest.approx(2 * one.peak))
    assert math.pi / 2 * one.size * one.peak == pytest.approx(one.load)


def test_hertz_point() -> None:
    contact = ref.hertz_point(0.01, 0.5, ref.PVDF.contact_modulus)
    assert contact.size == pytest.approx(math.sqrt(0.005))
    # The pressure p0 sqrt(1 - r^2/a^2) carries the load, whose work gives it back by the approach.
    assert 2 / 3 * math.pi * contact.size**2 * contact.peak == pytest.approx(contact.load)
    assert contact.peak == pytest.approx(2 * ref.PVDF.contact_modulus * contact.size / (math.pi * 0.5))


def test_nafems_cylinder() -> None:
    modulus = ref.contact_modulus((70e3, 0.3), (210e3, 0.3))
    contact = ref.hertz_line(35e3, ref.relative_radius(50.0, math.inf), modulus)
    assert (contact.size, contact.peak) == (printed("6.2146"), printed("3585.4"))


def test_jkr_pull_off_is_the_greatest_pull() -> None:
    energy, radius, modulus = 0.05, 0.25, 1373.626
    result = minimize_scalar(lambda a: ref.jkr_load(a, energy, radius, modulus), bounds=(0, radius))
    assert -result.fun == pytest.approx(ref.jkr_pull_off(energy, radius, modulus), rel=1e-8)
    scale = (math.pi * modulus * energy**2 * radius) ** (1 / 3)
    assert ref.jkr_pull_off(energy, radius, modulus) / scale == printed("1.1906")


@pytest.mark.parametrize(
    ("parameter", "pull_off"), [(0.5, "0.9171"), (1, "1.1130"), (2, "1.1801"), (3, "1.1880"), (5, "1.1902")]
)
def test_maugis_pull_off(parameter: float, pull_off: str) -> None:
    assert ref.maugis_pull_off(parameter) == printed(pull_off)


def test_maugis_state_fulfils_both_equations() -> None:
    lam, m = 0.7, 1.9
    a, load = ref.maugis_state(lam, m)
    mu = math.sqrt(m**2 - 1)
    log = math.log(m + mu)
    edge = lam * a**2 / 2 * (m * mu - log) + lam**2 * a / 2 * (mu * log - m * math.log(m))
    assert edge == pytest.approx(1)
    assert load == pytest.approx(a**2 - lam * a * mu)
    strength = ref.maugis_strength(lam, 0.05, 0.25, 1373.626)
    assert 4 * strength / (math.pi**2 * 1373.626**2 * 0.05 / 0.25) ** (1 / 3) == pytest.approx(lam)


def test_maugis_of_stiff_bodies_is_the_rigid_cylinder() -> None:
    """The limit without elasticity: the stress s0 wherever the gap of the parabola is below W/s0."""
    energy, radius, modulus, lam = 0.05, 0.25, 1373.626, 1e-4
    strength = ref.maugis_strength(lam, energy, radius, modulus)
    rigid = 2 * strength * math.sqrt(2 * radius * energy / strength)
    scale = (math.pi * modulus * energy**2 * radius) ** (1 / 3)
    assert ref.maugis_pull_off(lam) * scale == pytest.approx(rigid, rel=1e-2)


@pytest.mark.parametrize("compliance", [1e-4, 8e-3])
def test_series_bilinear(compliance: float) -> None:
    law = ref.SeriesBilinear(1e4, 5.0, 0.05, compliance)
    assert law.stable == (compliance < (0.02 - 5e-4) / 5)
    assert law.peak == pytest.approx(5 * (compliance + 1e-4))
    assert law.stress(law.peak) == pytest.approx(5)
    assert law.stress(law.release * (1 + 1e-12)) == 0
    work = quad(law.stress, 0, law.peak)[0] + quad(law.stress, law.peak * (1 + 1e-12), law.release)[0]
    assert law.work == pytest.approx(work)
    if law.stable:
        assert law.work == pytest.approx(law.energy)
        at = (law.peak + law.release) / 2
        gap = at - compliance * law.stress(at)
        assert law.stress(at) == pytest.approx(5 * (law.final - gap) / (law.final - law.onset))
    else:
        assert law.work > law.energy


def test_lennard_jones() -> None:
    law = ref.LennardJones(0.3, 0.02)
    scale = law.pull
    assert law.pressure(law.equilibrium) / scale == pytest.approx(0, abs=1e-12)
    strongest = minimize_scalar(law.pressure, bounds=(law.equilibrium, 5 * law.distance))
    assert (strongest.x, -strongest.fun) == (pytest.approx(law.pull_gap, rel=1e-3), pytest.approx(law.pull))
    work = quad(lambda g: -law.pressure(g), law.equilibrium, math.inf)[0]
    assert law.work == pytest.approx(work, rel=1e-6)
