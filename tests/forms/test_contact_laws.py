"""Laws of the interface: each slope is that of the energy, no energy is lost on any path, what breaks stays broken."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from piezomat.forms.arrays import Array
from piezomat.forms.contact.laws.cohesive import CUTOFF_DROP, ELECTRIC_RELEASE, CohesiveLaw
from piezomat.forms.contact.laws.equal_potential import ConductingBonds, EqualPotential
from piezomat.forms.contact.laws.law import ContactLaw, LawMode
from piezomat.forms.contact.laws.penalty import NormalPenalty
from piezomat.forms.contact.laws.response import ENERGIES, Response
from tests.derivative import slope

STRENGTH, ENERGY, PENALTY, RHO, FADE = 5.0, 0.05, 2000.0, 0.3, 0.004
ELASTIC = STRENGTH / PENALTY  # 0.0025 um
FINAL = 2.0 * ENERGY / STRENGTH  # 0.02 um, of the bilinear law


def interface(kind: str, always: bool = False, points: int = 1, electric: bool = False) -> ContactLaw:
    """A law of that kind with the same constants at every point."""
    penalty = np.full(points, PENALTY)
    normal = NormalPenalty(penalty)
    equal = EqualPotential(np.full(points, RHO), np.full(points, FADE), -0.5 if kind == "unilateral" else 0.0)
    if kind == "unilateral":
        return normal + equal if electric else normal
    bonds = {"bilinear": CohesiveLaw.bilinear, "cutoff": CohesiveLaw.cutoff}[kind](STRENGTH, ENERGY, penalty, always)
    return normal + (ConductingBonds((bonds, equal)) if electric else bonds)


def bonds_of(law: ContactLaw) -> CohesiveLaw | None:
    """The bonds among the summands of a law."""
    return next((part for part in law.summands() if isinstance(part, CohesiveLaw)), None)


def kinematics(gap: Array, jump: Array | None = None) -> Array:
    """Gaps and, if there are any, jumps, as laws have them."""
    return gap[:, None] if jump is None else np.column_stack([gap, jump])


LAWS = [
    ("unilateral", False),
    ("bilinear", False),
    ("bilinear", True),
    ("cutoff", False),
    ("cutoff", True),
]
each_law = pytest.mark.parametrize(("kind", "always"), LAWS)
each_adhesion = pytest.mark.parametrize(("kind", "always"), LAWS[1:])


def histories() -> Array:
    """Never touched, touched, opened to every branch of the bonds, broken: touched, and the largest opening."""
    opening = np.array([0.0, 0.0, 0.3 * ELASTIC, 2.0 * ELASTIC, 0.5 * FINAL, 0.93 * FINAL, 1.5 * FINAL])
    return np.column_stack([np.arange(len(opening)) > 0, opening])


def of_law(law: ContactLaw, history: Array) -> Array:
    """A history of bonds as the law has it: a law without bonds remembers nothing."""
    return history[:, : law.history_size]


def touched(law: ContactLaw, points: int, opening: float = 0.0) -> Array:
    """The history of points that have touched."""
    return of_law(law, np.column_stack([np.ones(points), np.full(points, opening)]))


def samples(law: ContactLaw, rng: np.random.Generator, count: int = 400) -> tuple[Array, Array]:
    """Random gaps from pressed to broken, away from the kinks of the laws, each with every history."""
    states = histories()
    gap = np.repeat(rng.uniform(-0.01, 1.3 * FINAL, count), len(states))
    rows = np.tile(np.arange(len(states)), count)
    history = states[rows]
    kinks = [np.zeros_like(gap), history[:, 1]]
    if (a := bonds_of(law)) is not None:
        kinks += [np.full_like(gap, float(k[0])) for k in (a.elastic, a.plateau, a.final, ELECTRIC_RELEASE * a.final)]
    kinks += [np.full_like(gap, end * FADE) for end in (-0.5, 0.5, 1.0)]
    far = np.min([np.abs(gap - k) for k in kinks], axis=0) > 5e-6
    return gap[far], of_law(law, history[far])


def on_all(law: ContactLaw, points: int) -> ContactLaw:
    """The law of one point at many."""
    return law[np.zeros(points, int)]


def after(law: ContactLaw, history: Array, *gaps: float | Array) -> Array:
    """The history after converged steps that ended at these gaps."""
    for gap in gaps:
        history = law.committed(np.broadcast_to(gap, len(history))[:, None], history)
    return history


def electrified(kind: str, always: bool, rng: np.random.Generator) -> tuple[ContactLaw, Array, Array, Response]:
    """A law at many kinematics with a history, and its response without the jumps."""
    law = interface(kind, always, electric=True)
    gap, history = samples(law, rng)
    law, jump = on_all(law, len(gap)), rng.uniform(-3.0, 3.0, len(gap))
    return law, kinematics(gap, jump), history, law.respond(kinematics(gap, 0.0 * gap), history)


@each_law
def test_without_pulling_the_electric_contact_leaves_the_traction_alone(
    kind: str, always: bool, rng: np.random.Generator
) -> None:
    law, q, history, mechanical = electrified(kind, always, rng)
    pulling, idle = law.respond(q, history), law.respond(q, history, LawMode(attraction=False))
    np.testing.assert_array_equal(idle.charge, pulling.charge)
    np.testing.assert_array_equal(idle.hessian[:, 1, 1], pulling.hessian[:, 1, 1])
    np.testing.assert_array_equal(idle.energy("electric"), pulling.energy("electric"))
    np.testing.assert_array_equal(idle.traction, mechanical.traction)
    np.testing.assert_array_equal(idle.hessian[:, 0], mechanical.hessian[:, 0])
    assert (pulling.traction != idle.traction).any()


@each_law
def test_an_inexact_tangent_leaves_out_what_the_electric_contact_adds_below_zero(
    kind: str, always: bool, rng: np.random.Generator
) -> None:
    law, q, history, mechanical = electrified(kind, always, rng)
    exact, inexact = law.respond(q, history), law.respond(q, history, LawMode(consistent=False))
    stiffness = np.maximum(exact.hessian[:, 0, 0], mechanical.hessian[:, 0, 0])
    np.testing.assert_array_equal(inexact.hessian[:, 0, 0], stiffness)
    assert (exact.hessian[:, 0, 0] < stiffness).any()
    np.testing.assert_array_equal(inexact.hessian[:, 1], exact.hessian[:, 1])
    np.testing.assert_array_equal(inexact.gradient, exact.gradient)
    np.testing.assert_array_equal(inexact.enthalpy, exact.enthalpy)


@each_law
@pytest.mark.parametrize("electric", [False, True])
def test_gradient_and_hessian_are_derivatives_of_the_enthalpy(
    kind: str, always: bool, electric: bool, rng: np.random.Generator
) -> None:
    law = interface(kind, always, electric=electric)
    gap, history = samples(law, rng)
    assert len(gap) > 2000
    law = on_all(law, len(gap))
    q = kinematics(gap, rng.uniform(-3.0, 3.0, len(gap)) if electric else None)
    r = law.respond(q, history)

    def at(k: int, change: float) -> Response:
        return law.respond(q + change * np.eye(q.shape[1])[k], history)

    for k, h in enumerate([1e-6, 1e-2][: q.shape[1]]):
        gradient = slope(lambda h, k=k: at(k, h).enthalpy, h)
        np.testing.assert_allclose(r.gradient[:, k], gradient, atol=[1e-7 * STRENGTH, 1e-12][k])
        hessian = slope(lambda h, k=k: at(k, h).gradient, h)
        atol = [[1e-6 * PENALTY, 1e-6], [1e-9, 1e-12]][k]
        for i in range(q.shape[1]):
            np.testing.assert_allclose(r.hessian[:, k, i], hessian[:, i], atol=atol[i])
    np.testing.assert_array_equal(r.hessian, np.swapaxes(r.hessian, 1, 2))
    if electric:  # all branches of the electric switch are met
        s = -r.hessian[:, 1, 1] / RHO
        assert (s == 0.0).any() and (s == 1.0).any() and ((s > 0.1) & (s < 0.9)).any()
    else:
        assert not r.charge.any() and not r.energy("electric").any()


def path(law: ContactLaw, rng: np.random.Generator, turns: int = 8) -> list[float]:
    """Gaps of a path that presses and pulls to random depths, at last beyond the end of every bond.

    It stops at every kink of the law, those of its history too, so that quadrature between the stops is exact.
    """
    ends = [0.01, -0.004]
    for i in range(turns):
        ends.append(rng.uniform(0.0, (0.4 + 0.9 * i / turns) * FINAL))
        ends.append(rng.uniform(-0.003, 0.5 * ends[-1]))
    ends += [1.5 * FINAL, -0.002, 0.0, 1.5 * FINAL]
    kinks = [0.0, *ends]
    if (a := bonds_of(law)) is not None:
        kinks += [float(k[0]) for k in (a.elastic, a.plateau, a.final, ELECTRIC_RELEASE * a.final)]
    kinks += [-0.5 * FADE, 0.5 * FADE, FADE]
    stops = ends[:1]
    for a, b in pairwise(ends):
        between = sorted({k for k in kinks if min(a, b) < k < max(a, b)}, reverse=b < a)
        stops += [*between, b]
    return stops


@each_law
@pytest.mark.parametrize("jump", [0.0, 2.0])
def test_energy_is_conserved_on_any_path(kind: str, always: bool, jump: float, rng: np.random.Generator) -> None:
    """The work of the traction is what is stored and dissipated, at every point of a path of many turns.

    Under a constant potential jump too, whose source takes up twice what the electric energy gives.
    """
    law = interface(kind, always, electric=True)
    gaps = path(law, rng)
    history = law.virgin(1)
    start = law.respond(np.array([[gaps[0], jump]]), history).enthalpy[0]
    work, dissipated = 0.0, 0.0
    for gap, end in pairwise(gaps):
        work += work_of(law, history, gap, end, jump)
        q = np.array([[end, jump]])
        r = law.respond(q, history)
        history = law.committed(q, history)
        committed = law.respond(q, history)
        assert abs(committed.charge - r.charge)[0] < 1e-15
        for name in ENERGIES:
            assert abs(committed.energy(name) - r.energy(name))[0] < 1e-15, name
        assert abs(work - r.enthalpy[0] + start) < 1e-13 * ENERGY * len(gaps)
        assert r.energy("dissipated")[0] >= dissipated - 1e-15
        dissipated = r.energy("dissipated")[0]
    assert dissipated == pytest.approx(0.0 if kind == "unilateral" else ENERGY, rel=1e-12)


def work_of(law: ContactLaw, history: Array, start: float, end: float, jump: float = 0.0) -> float:
    """Work of the traction between two gaps with no kink in between, under a constant jump."""
    points, weights = np.polynomial.legendre.leggauss(4)
    gaps = 0.5 * (start + end) + 0.5 * (end - start) * points
    rows = np.zeros(len(gaps), int)
    tractions = law[rows].respond(kinematics(gaps, np.full(len(gaps), jump)), history[rows]).traction
    return 0.5 * (end - start) * float(weights @ tractions)


@each_adhesion
def test_work_of_separation_is_the_energy(kind: str, always: bool) -> None:
    law = interface(kind, always)
    history, a = touched(law, 1), bonds_of(law)
    assert a.energy[0] == pytest.approx(ENERGY, rel=1e-13)
    kinks = [0.0, float(a.elastic[0]), float(a.plateau[0]), float(a.final[0]), 2.0 * float(a.final[0])]
    work = sum(work_of(law, history, low, high) for low, high in pairwise(kinks))
    assert work == pytest.approx(ENERGY, rel=1e-13)
    largest = law.respond(np.array([kinks[1:2]]), history).traction[0]
    assert largest == pytest.approx(STRENGTH, rel=1e-14)


def test_shapes_of_the_laws() -> None:
    gap = np.array([0.5 * ELASTIC, ELASTIC, 0.5 * (ELASTIC + FINAL), FINAL, 2.0 * FINAL])
    law = on_all(interface("bilinear"), 5)
    bilinear = law.respond(kinematics(gap), touched(law, 5)).traction
    np.testing.assert_allclose(bilinear, [0.5 * STRENGTH, STRENGTH, 0.5 * STRENGTH, 0.0, 0.0], atol=1e-12)
    cutoff = bonds_of(interface("cutoff"))
    cut = ENERGY / STRENGTH + 0.5 * ELASTIC
    assert 0.5 * (cutoff.plateau + cutoff.final)[0] == pytest.approx(cut, rel=1e-14)
    assert (cutoff.final - cutoff.plateau)[0] == pytest.approx(CUTOFF_DROP * (cut - ELASTIC), rel=1e-13)
    gap = np.array([0.5 * ELASTIC, ELASTIC, 0.99 * cutoff.plateau[0], cut, cutoff.final[0]])
    found = on_all(interface("cutoff"), 5).respond(kinematics(gap), touched(law, 5)).traction
    np.testing.assert_allclose(found, [0.5 * STRENGTH, STRENGTH, STRENGTH, 0.5 * STRENGTH, 0.0], atol=1e-12)


def test_cutoff_by_range() -> None:
    penalty = np.array([PENALTY, 2.0 * PENALTY])
    a = CohesiveLaw.cutoff_at(STRENGTH, 0.01, penalty)
    np.testing.assert_allclose(0.5 * (a.plateau + a.final), 0.01, rtol=1e-14)
    # A triangle up to the strength, then a plateau to the cut: the range is the same for all points, the energy not.
    np.testing.assert_allclose(a.energy, STRENGTH * (0.01 - 0.5 * STRENGTH / penalty), rtol=1e-13)


def test_pressure_is_the_penalty_times_the_penetration() -> None:
    gap = np.array([-0.01, -0.001, 0.0, 0.001])
    for kind, always in LAWS:
        law = on_all(interface(kind, always), 4)
        for history in (law.virgin(4), touched(law, 4)):
            r = law.respond(kinematics(gap), history)
            np.testing.assert_allclose(r.traction[:3], PENALTY * gap[:3], atol=1e-12)
            np.testing.assert_allclose(r.hessian[:3, 0, 0], PENALTY, rtol=1e-14)  # bodies that touch resist at once
            np.testing.assert_allclose(r.energy("contact"), 0.5 * PENALTY * np.minimum(gap, 0.0) ** 2, atol=1e-15)
            pulls = kind != "unilateral" and (history.any() or always)
            assert r.traction[3] == pytest.approx(PENALTY * gap[3] if pulls else 0.0, rel=1e-13)


@each_adhesion
def test_sticking_starts_at_touch_or_at_once(kind: str, always: bool) -> None:
    law = on_all(interface(kind, always), 3)
    gap = np.array([0.5 * ELASTIC, 2.0 * ELASTIC, 2.0 * FINAL])
    virgin = law.respond(kinematics(gap), law.virgin(3))
    assert (virgin.traction[:2] > 0.0).all() == always
    assert virgin.traction[2] == 0.0 and not virgin.energy("dissipated").any()
    # Without a touch attraction is reversible: its energy is zero far off, and opening leaves no trace.
    history = after(law, law.virgin(3), [ELASTIC * 1.01, 2.0 * ELASTIC, 2.0 * FINAL])
    assert not history.any()
    assert virgin.energy("adhesion")[2] == pytest.approx(0.0, abs=1e-15)
    pressed = after(law, law.virgin(3), -1e-3)
    assert pressed[:, 0].all()
    assert (law.respond(kinematics(gap), pressed).traction[:2] > 0.0).all()


@each_adhesion
def test_a_bond_unloads_to_the_origin_and_stays_damaged(kind: str, always: bool) -> None:
    """Secant unloading, reloading along the same line, on with the envelope beyond the largest opening."""
    law = on_all(interface(kind, always), 50)
    furthest = 0.6 * FINAL
    history = touched(law, 50, furthest)
    envelope, _, work = bonds_of(law).envelope(np.full(50, furthest))
    gap = np.linspace(0.0, furthest, 50)
    r = law.respond(kinematics(gap), history)
    np.testing.assert_allclose(r.traction, envelope * gap / furthest, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(r.energy("dissipated"), work - 0.5 * envelope * furthest, rtol=1e-13)
    gap = np.linspace(furthest, 1.2 * FINAL, 50)
    beyond = law.respond(kinematics(gap), history)
    np.testing.assert_allclose(beyond.traction, bonds_of(law).envelope(gap)[0], rtol=1e-13, atol=1e-13)
    # Elastic opening does no damage.
    elastic = touched(law, 50, 0.9 * ELASTIC)
    r = law.respond(kinematics(np.linspace(0.0, 0.9 * ELASTIC, 50)), elastic)
    assert np.abs(r.energy("dissipated")).max() < 1e-16
    np.testing.assert_allclose(r.traction, PENALTY * np.linspace(0.0, 0.9 * ELASTIC, 50), rtol=1e-13, atol=1e-13)


@each_adhesion
def test_what_is_broken_never_heals(kind: str, always: bool) -> None:
    law = interface(kind, always)
    history = after(law, law.virgin(1), -0.001, 1.5 * FINAL, -0.005, 0.0)
    assert history[0, 1] == 1.5 * FINAL
    assert not law.bonded(history)[0]
    gap = np.linspace(1e-6, 2.0 * FINAL, 40)
    r = on_all(law, 40).respond(kinematics(gap), history[np.zeros(40, int)])
    assert not r.gradient.any() and not r.hessian.any()
    np.testing.assert_allclose(r.energy("dissipated"), ENERGY, rtol=1e-13)
    # It can still be pressed.
    pressed = law.respond(np.array([[-0.001]]), history)
    assert pressed.traction[0] == pytest.approx(-0.001 * PENALTY)


@each_adhesion
def test_response_does_not_depend_on_the_steps_of_opening(kind: str, always: bool) -> None:
    """Opened at once or in parts, the traction at the end is the same and so is what has been dissipated."""
    law = interface(kind, always)
    for furthest in (0.5 * ELASTIC, 0.5 * FINAL, 0.97 * FINAL):
        ends = []
        for parts in (1, 7):
            history = after(law, law.virgin(1), -0.001)
            for gap in np.linspace(0.0, furthest, parts + 1)[1:]:
                r = law.respond(np.array([[gap]]), history)
                history = after(law, history, gap)
            ends.append((r.traction[0], r.hessian[0, 0, 0], r.energy("dissipated")[0], history[0, 1]))
        np.testing.assert_allclose(ends[0], ends[1], rtol=1e-13, atol=1e-16)


# --- Potential ------------------------------------------------------------------------------------


def switch(law: ContactLaw, gap: Array, history: Array) -> Array:
    """s(g), from the electric curvature -rho s."""
    return -on_all(law, len(gap)).respond(kinematics(gap, np.ones_like(gap)), history).hessian[:, 1, 1] / RHO


@each_law
def test_potentials_stay_equal_in_contact_and_while_bonded(kind: str, always: bool) -> None:
    law = interface(kind, always, electric=True)
    pressed = np.linspace(-0.01, -0.5 * FADE if kind == "unilateral" else 0.0, 20)
    np.testing.assert_allclose(switch(law, pressed, law.virgin(20)), 1.0, atol=1e-15)
    # What always attracts takes the potentials along wherever it attracts.
    far = np.linspace(1.0001 * (float(bonds_of(law).final[0]) if always else FADE), 2.0 * FINAL, 20)
    assert not switch(law, far, law.virgin(20)).any()
    if kind == "unilateral":
        return
    final = float(bonds_of(law).final[0])
    bonded = np.linspace(0.0, ELECTRIC_RELEASE * final, 20)
    np.testing.assert_allclose(switch(law, bonded, touched(law, 20)), 1.0, atol=1e-14)
    fading = switch(law, np.linspace(ELECTRIC_RELEASE * final, final, 20), touched(law, 20))
    assert (np.diff(fading) < 0.0).all() and abs(fading[-1]) < 1e-14
    # Once released it does not come back unless the gap is small.
    broken = touched(law, 20, 1.1 * final)
    assert not switch(law, far, broken).any()
    np.testing.assert_allclose(switch(law, pressed, broken), 1.0, atol=1e-15)
    # A bond that has nearly broken and goes back is still one.
    nearly = touched(law, 20, 0.99 * final)
    np.testing.assert_allclose(switch(law, bonded, nearly), 1.0, atol=1e-14)


@each_law
def test_electric_switch_is_once_smooth(kind: str, always: bool) -> None:
    """Value and slope of s(g) have no jumps: neighbours a little apart differ by a little, whatever the history."""
    law = interface(kind, always, electric=True)
    gap = np.linspace(-0.5 * FADE, 1.2 * FINAL, 20001)
    step = gap[1] - gap[0]
    bonds = bonds_of(law)
    width = FADE if bonds is None else min(FADE, (1.0 - ELECTRIC_RELEASE) * float(bonds.final[0]))
    for state in of_law(law, histories()):
        history = np.tile(state, (len(gap), 1))
        mechanical = on_all(interface(kind, always), len(gap)).respond(kinematics(gap), history).traction
        r = on_all(law, len(gap)).respond(kinematics(gap, np.ones_like(gap)), history)
        s, s1 = -r.hessian[:, 1, 1] / RHO, -2.0 * (r.traction - mechanical) / RHO
        assert s.min() > -1e-14 and s.max() < 1.0 + 1e-14
        # |s'| <= 3/2 and |s''| <= 6 over the width of one fade; where both fade their slopes add up.
        assert np.abs(np.diff(s)).max() <= 2.0 * 1.5 * step / width
        assert np.abs(np.diff(s1)).max() <= 2.0 * 6.0 * step / width**2 + 1e-9 / width
        assert s[0] == 1.0 and s[-1] == 0.0


def test_traction_is_continuous_at_touch() -> None:
    """Pressure and adhesion meet at a gap of zero with one slope, so Newton's method sees no kink."""
    for kind, always in LAWS[1:]:
        law = on_all(interface(kind, always), 2)
        r = law.respond(np.array([[-1e-12], [1e-12]]), touched(law, 2))
        np.testing.assert_allclose(r.traction, 0.0, atol=1e-8)
        np.testing.assert_allclose(r.hessian[:, 0, 0], PENALTY, rtol=1e-14)


# --- What is said of points -----------------------------------------------------------------------


@each_law
def test_status_and_bonds(kind: str, always: bool) -> None:
    law = on_all(interface(kind, always), 4)
    history = of_law(law, np.column_stack([[0, 1, 1, 1], np.array([0.0, 0.0, 0.5, 2.0]) * FINAL]))
    sticks = kind != "unilateral"
    np.testing.assert_array_equal(law.bonded(history), [False, sticks, sticks, False])
    open_status = [0, 2, 2, 3] if sticks else [0, 0, 0, 0]
    np.testing.assert_array_equal(law.status(np.full(4, 1e-3), history), open_status)
    np.testing.assert_array_equal(law.status(np.full(4, -1e-3), history), 1)
    np.testing.assert_array_equal(law.status(np.zeros(4), history), 1)


@each_law
def test_nothing_answers_beyond_the_reach(kind: str, always: bool) -> None:
    for electric in (False, True):
        law = interface(kind, always, electric=electric)
        far = np.array([[law.interaction_range + 1e-14, 1.0]])
        if kind == "unilateral":
            assert law.interaction_range == (0.5 * FADE if electric else 0.0)
        for history in (law.virgin(1), touched(law, 1)):
            r = law.respond(far, history)
            assert not r.gradient.any() and not r.hessian[:, 0, 0].any()


def test_points_of_different_penalties_are_independent(rng: np.random.Generator) -> None:
    """The response of a law over many points is that of the law of each point, for any selection of rows."""
    penalty = rng.uniform(1000.0, 4000.0, 30)
    electric = EqualPotential(rng.uniform(0.1, 1.0, 30), rng.uniform(1.0, 2.0, 30) * FADE)
    law = NormalPenalty(penalty) + ConductingBonds((CohesiveLaw.bilinear(STRENGTH, ENERGY, penalty), electric))
    q = kinematics(rng.uniform(-0.01, FINAL, 30), rng.standard_normal(30))
    history = law.virgin(30)
    history[:, 0] = rng.uniform(size=30) < 0.7
    history[:, 1] = history[:, 0] * rng.uniform(0.0, FINAL, 30)
    whole = law.respond(q, history)
    rows = rng.permutation(30)[:20]
    for some in (rows, *np.split(rows[:5], 5)):
        alone, part = law[some].respond(q[some], history[some]), whole[some]
        np.testing.assert_array_equal(alone.gradient, part.gradient)
        np.testing.assert_array_equal(alone.hessian, part.hessian)
        for name in ENERGIES:
            np.testing.assert_array_equal(alone.energy(name), part.energy(name))


def test_no_points_are_no_trouble() -> None:
    """Ranks without contact points evaluate the law too."""
    none = np.zeros((0, 2))
    for kind, always in LAWS:
        law = interface(kind, always, points=0, electric=True)
        assert law.respond(none, law.virgin(0)).gradient.shape == (0, 2)
        assert law.interaction_range == 0.0


@pytest.mark.parametrize("make", [CohesiveLaw.bilinear, CohesiveLaw.cutoff])
def test_too_soft_a_penalty_is_an_error(make: Callable[..., CohesiveLaw]) -> None:
    soft = STRENGTH**2 / (2.0 * ENERGY)
    make(STRENGTH, ENERGY, np.array([1.01 * soft]))
    with pytest.raises(ValueError, match="raise normal_penalty or the energy"):
        make(STRENGTH, ENERGY, np.array([1.01 * soft, soft]))


def test_history_remembers_the_largest_opening_since_touch() -> None:
    law = interface("bilinear", points=2)
    history = after(law, law.virgin(2), *([0.1, -0.01], [0.2, 0.3], [0.1, 0.1], [-0.1, 0.2], [0.05, 0.0]))
    np.testing.assert_allclose(history, [[1.0, 0.05], [1.0, 0.3]])


def test_what_attracts_from_the_start_touches_within_its_elastic_opening() -> None:
    gap = np.array([-1e-3, 0.0, 0.99 * ELASTIC, 1.01 * ELASTIC])
    for kind, always in LAWS[1:]:
        law = on_all(interface(kind, always), 4)
        history = law.committed(kinematics(gap), law.virgin(4))
        np.testing.assert_array_equal(history[:, 0], [True, True, always, False])


@each_law
def test_bonds_of_points_that_meet_nothing_any_more_are_torn(kind: str, always: bool) -> None:
    law = on_all(interface(kind, always), 3)
    history = of_law(law, np.column_stack([[0, 1, 1], [0.0, 0.3 * FINAL, 3.0 * FINAL]]))
    torn = law.on_loss_of_contact(history)
    assert not law.bonded(torn).any() and (torn >= history).all()
    np.testing.assert_array_equal(torn[:, :1], history[:, :1])
    if kind != "unilateral":
        assert torn[0, 1] == 0.0
        far = law.respond(np.full((3, 1), 1e30), torn)
        np.testing.assert_allclose(far.energy("dissipated"), [0.0, ENERGY, ENERGY], rtol=1e-13)
