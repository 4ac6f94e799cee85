"""Laws of the interface: each slope is that of the energy, no energy is lost on any path, what breaks stays broken."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from piezomat.forms.arrays import Array
from piezomat.forms.contact.laws.cohesive import CUTOFF_DROP, ELECTRIC_RELEASE, CohesiveLaw
from piezomat.forms.contact.laws.equal_potential import EqualPotential
from piezomat.forms.contact.laws.interface import InterfaceLaw
from piezomat.forms.contact.laws.response import History, Response
from tests.derivative import slope

STRENGTH, ENERGY, PENALTY, RHO, FADE = 5.0, 0.05, 2000.0, 0.3, 0.004
ELASTIC = STRENGTH / PENALTY  # 0.0025 um
FINAL = 2.0 * ENERGY / STRENGTH  # 0.02 um, of the bilinear law


def interface(kind: str, always: bool = False, points: int = 1, electric: bool = False) -> InterfaceLaw:
    """A law of that kind with the same constants at every point."""
    penalty = np.full(points, PENALTY)
    adhesion = None
    if kind != "unilateral":
        adhesion = {"bilinear": CohesiveLaw.bilinear, "cutoff": CohesiveLaw.cutoff}[kind](
            STRENGTH, ENERGY, penalty, always
        )
    if not electric:
        return InterfaceLaw(penalty, adhesion)
    start = -0.5 if adhesion is None else 0.0
    return InterfaceLaw(penalty, adhesion, EqualPotential(np.full(points, RHO), np.full(points, FADE), start))


LAWS = [
    ("unilateral", False),
    ("bilinear", False),
    ("bilinear", True),
    ("cutoff", False),
    ("cutoff", True),
]
each_law = pytest.mark.parametrize(("kind", "always"), LAWS)
each_adhesion = pytest.mark.parametrize(("kind", "always"), LAWS[1:])


def enthalpy(r: Response) -> Array:
    """What slope and charge are the derivatives of: stored and dissipated, electric with the dielectric's sign."""
    return r.contact + r.adhesion + r.dissipated - r.electric


def histories() -> History:
    """Never touched, touched, opened to every branch of the laws, broken."""
    opening = np.array([0.0, 0.0, 0.3 * ELASTIC, 2.0 * ELASTIC, 0.5 * FINAL, 0.93 * FINAL, 1.5 * FINAL])
    return History(np.arange(len(opening)) > 0, opening)


def samples(law: InterfaceLaw, rng: np.random.Generator, count: int = 400) -> tuple[Array, History]:
    """Random gaps from pressed to broken, away from the kinks of the laws, each with every history."""
    states = histories()
    gap = np.repeat(rng.uniform(-0.01, 1.3 * FINAL, count), len(states.opening))
    rows = np.tile(np.arange(len(states.opening)), count)
    history = states[rows]
    kinks = [np.zeros_like(gap), history.opening]
    if law.adhesion is not None:
        a = law.adhesion
        kinks += [np.full_like(gap, float(k[0])) for k in (a.elastic, a.plateau, a.final, ELECTRIC_RELEASE * a.final)]
    kinks += [np.full_like(gap, end * FADE) for end in (-0.5, 0.5, 1.0)]
    far = np.min([np.abs(gap - k) for k in kinks], axis=0) > 5e-6
    return gap[far], history[far]


def on_all(law: InterfaceLaw, points: int) -> InterfaceLaw:
    """The law of one point at many."""
    return law[np.zeros(points, int)]


def after(law: InterfaceLaw, history: History, *gaps: float | Array) -> History:
    """The history after converged steps that ended at these gaps."""
    for gap in gaps:
        gap = np.broadcast_to(gap, history.opening.shape)
        history = history.advanced(gap, law.touching(gap))
    return history


def electrified(
    kind: str, always: bool, rng: np.random.Generator
) -> tuple[InterfaceLaw, Array, Array, History, Response]:
    """A law at many gaps with a history, with jumps, and its response without those."""
    law = interface(kind, always, electric=True)
    gap, history = samples(law, rng)
    law, jump = on_all(law, len(gap)), rng.uniform(-3.0, 3.0, len(gap))
    return law, gap, jump, history, law.respond(gap, None, history)


@each_law
def test_without_pulling_the_electric_contact_leaves_the_traction_alone(
    kind: str, always: bool, rng: np.random.Generator
) -> None:
    law, gap, jump, history, mechanical = electrified(kind, always, rng)
    pulling, idle = law.respond(gap, jump, history), law.respond(gap, jump, history, attraction=False)
    for name in ("charge", "electric_curvature", "electric"):
        np.testing.assert_array_equal(getattr(idle, name), getattr(pulling, name))
    for name in ("slope", "curvature", "mixed"):
        np.testing.assert_array_equal(getattr(idle, name), getattr(mechanical, name))
    assert (pulling.slope != idle.slope).any()


@each_law
def test_an_inexact_tangent_leaves_out_what_the_electric_contact_adds_below_zero(
    kind: str, always: bool, rng: np.random.Generator
) -> None:
    law, gap, jump, history, mechanical = electrified(kind, always, rng)
    exact, inexact = law.respond(gap, jump, history), law.respond(gap, jump, history, consistent=False)
    np.testing.assert_array_equal(inexact.curvature, np.maximum(exact.curvature, mechanical.curvature))
    assert (exact.curvature < inexact.curvature).any()
    for name in ("slope", "charge", "mixed", "electric_curvature", "contact", "electric"):
        np.testing.assert_array_equal(getattr(inexact, name), getattr(exact, name))


@each_law
@pytest.mark.parametrize("electric", [False, True])
def test_slopes_are_derivatives_of_the_energy(
    kind: str, always: bool, electric: bool, rng: np.random.Generator
) -> None:
    law = interface(kind, always, electric=electric)
    gap, history = samples(law, rng)
    assert len(gap) > 2000
    law = on_all(law, len(gap))
    jump = rng.uniform(-3.0, 3.0, len(gap)) if electric else None
    r = law.respond(gap, jump, history)

    def at(change: float) -> Response:
        return law.respond(gap + change, jump, history)

    np.testing.assert_allclose(r.slope, slope(lambda h: enthalpy(at(h)), 1e-6), atol=1e-7 * STRENGTH)
    np.testing.assert_allclose(r.curvature, slope(lambda h: at(h).slope, 1e-6), atol=1e-6 * PENALTY)
    if not electric:
        assert not r.charge.any() and not r.mixed.any() and not r.electric_curvature.any() and not r.electric.any()
        return

    def under(change: float) -> Response:
        return law.respond(gap, jump + change, history)

    np.testing.assert_allclose(r.charge, slope(lambda h: enthalpy(under(h)), 1e-2), atol=1e-12)
    np.testing.assert_allclose(r.electric_curvature, slope(lambda h: under(h).charge, 1e-2), atol=1e-12)
    np.testing.assert_allclose(r.mixed, slope(lambda h: under(h).slope, 1e-2), atol=1e-9)
    np.testing.assert_allclose(r.mixed, slope(lambda h: at(h).charge, 1e-6), atol=1e-6)
    # All branches of the electric switch are met.
    s = -r.electric_curvature / RHO
    assert (s == 0.0).any() and (s == 1.0).any() and ((s > 0.1) & (s < 0.9)).any()


def path(law: InterfaceLaw, rng: np.random.Generator, turns: int = 8) -> list[float]:
    """Gaps of a path that presses and pulls to random depths, at last beyond the end of every bond.

    It stops at every kink of the law, those of its history too, so that quadrature between the stops is exact.
    """
    ends = [0.01, -0.004]
    for i in range(turns):
        ends.append(rng.uniform(0.0, (0.4 + 0.9 * i / turns) * FINAL))
        ends.append(rng.uniform(-0.003, 0.5 * ends[-1]))
    ends += [1.5 * FINAL, -0.002, 0.0, 1.5 * FINAL]
    kinks = [0.0, *ends]
    if law.adhesion is not None:
        a = law.adhesion
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
    history = History.virgin(1)
    jumps = np.array([jump])
    start = enthalpy(law.respond(np.array(gaps[:1]), jumps, history))[0]
    work, dissipated = 0.0, 0.0
    for gap, end in pairwise(gaps):
        work += work_of(law, history, gap, end, jump)
        end = np.array([end])
        r = law.respond(end, jumps, history)
        history = after(law, history, end)
        committed = law.respond(end, jumps, history)
        for name in ("contact", "adhesion", "dissipated", "electric", "charge"):
            assert abs(getattr(committed, name) - getattr(r, name))[0] < 1e-15, name
        assert abs(work - enthalpy(r)[0] + start) < 1e-13 * ENERGY * len(gaps)
        assert r.dissipated[0] >= dissipated - 1e-15
        dissipated = r.dissipated[0]
    assert dissipated == pytest.approx(0.0 if kind == "unilateral" else ENERGY, rel=1e-12)


def work_of(law: InterfaceLaw, history: History, start: float, end: float, jump: float = 0.0) -> float:
    """Work of the traction between two gaps with no kink in between, under a constant jump."""
    points, weights = np.polynomial.legendre.leggauss(4)
    gaps = 0.5 * (start + end) + 0.5 * (end - start) * points
    rows = np.zeros(len(gaps), int)
    tractions = law[rows].respond(gaps, np.full(len(gaps), jump), history[rows]).slope
    return 0.5 * (end - start) * float(weights @ tractions)


@each_adhesion
def test_work_of_separation_is_the_energy(kind: str, always: bool) -> None:
    law = interface(kind, always)
    touched = History(np.array([True]), np.zeros(1))
    a = law.adhesion
    assert a.energy[0] == pytest.approx(ENERGY, rel=1e-13)
    kinks = [0.0, float(a.elastic[0]), float(a.plateau[0]), float(a.final[0]), 2.0 * float(a.final[0])]
    work = sum(work_of(law, touched, low, high) for low, high in pairwise(kinks))
    assert work == pytest.approx(ENERGY, rel=1e-13)
    largest = law.respond(np.array([kinks[1]]), None, touched).slope[0]
    assert largest == pytest.approx(STRENGTH, rel=1e-14)


def test_shapes_of_the_laws() -> None:
    gap = np.array([0.5 * ELASTIC, ELASTIC, 0.5 * (ELASTIC + FINAL), FINAL, 2.0 * FINAL])
    touched = History(np.ones(5, bool), np.zeros(5))
    bilinear = on_all(interface("bilinear"), 5).respond(gap, None, touched).slope
    np.testing.assert_allclose(bilinear, [0.5 * STRENGTH, STRENGTH, 0.5 * STRENGTH, 0.0, 0.0], atol=1e-12)
    cutoff = interface("cutoff").adhesion
    cut = ENERGY / STRENGTH + 0.5 * ELASTIC
    assert 0.5 * (cutoff.plateau + cutoff.final)[0] == pytest.approx(cut, rel=1e-14)
    assert (cutoff.final - cutoff.plateau)[0] == pytest.approx(CUTOFF_DROP * (cut - ELASTIC), rel=1e-13)
    gap = np.array([0.5 * ELASTIC, ELASTIC, 0.99 * cutoff.plateau[0], cut, cutoff.final[0]])
    found = on_all(interface("cutoff"), 5).respond(gap, None, touched).slope
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
        for touched in (False, True):
            r = law.respond(gap, None, History(np.full(4, touched), np.zeros(4)))
            np.testing.assert_allclose(r.slope[:3], PENALTY * gap[:3], atol=1e-12)
            np.testing.assert_allclose(r.curvature[:3], PENALTY, rtol=1e-14)  # bodies that touch resist at once
            np.testing.assert_allclose(r.contact, 0.5 * PENALTY * np.minimum(gap, 0.0) ** 2, atol=1e-15)
            pulls = kind != "unilateral" and (touched or always)
            assert r.slope[3] == pytest.approx(PENALTY * gap[3] if pulls else 0.0, rel=1e-13)


@each_adhesion
def test_sticking_starts_at_touch_or_at_once(kind: str, always: bool) -> None:
    law = on_all(interface(kind, always), 3)
    gap = np.array([0.5 * ELASTIC, 2.0 * ELASTIC, 2.0 * FINAL])
    virgin = law.respond(gap, None, History.virgin(3))
    assert (virgin.slope[:2] > 0.0).all() == always
    assert virgin.slope[2] == 0.0 and not virgin.dissipated.any()
    # Without a touch attraction is reversible: its energy is zero far off, and opening leaves no trace.
    history = after(law, History.virgin(3), [ELASTIC * 1.01, 2.0 * ELASTIC, 2.0 * FINAL])
    assert not history.touched.any() and not history.opening.any()
    assert virgin.adhesion[2] == pytest.approx(0.0, abs=1e-15)
    pressed = after(law, History.virgin(3), -1e-3)
    assert pressed.touched.all()
    assert (law.respond(gap, None, pressed).slope[:2] > 0.0).all()


@each_adhesion
def test_a_bond_unloads_to_the_origin_and_stays_damaged(kind: str, always: bool) -> None:
    """Secant unloading, reloading along the same line, on with the envelope beyond the largest opening."""
    law = on_all(interface(kind, always), 50)
    furthest = 0.6 * FINAL
    history = History(np.ones(50, bool), np.full(50, furthest))
    envelope, _, work = law.adhesion.envelope(np.full(50, furthest))
    gap = np.linspace(0.0, furthest, 50)
    r = law.respond(gap, None, history)
    np.testing.assert_allclose(r.slope, envelope * gap / furthest, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(r.dissipated, work - 0.5 * envelope * furthest, rtol=1e-13)
    gap = np.linspace(furthest, 1.2 * FINAL, 50)
    beyond = law.respond(gap, None, history)
    np.testing.assert_allclose(beyond.slope, law.adhesion.envelope(gap)[0], rtol=1e-13, atol=1e-13)
    # Elastic opening does no damage.
    elastic = History(np.ones(50, bool), np.full(50, 0.9 * ELASTIC))
    r = law.respond(np.linspace(0.0, 0.9 * ELASTIC, 50), None, elastic)
    assert np.abs(r.dissipated).max() < 1e-16
    np.testing.assert_allclose(r.slope, PENALTY * np.linspace(0.0, 0.9 * ELASTIC, 50), rtol=1e-13, atol=1e-13)


@each_adhesion
def test_what_is_broken_never_heals(kind: str, always: bool) -> None:
    law = interface(kind, always)
    history = after(law, History.virgin(1), -0.001, 1.5 * FINAL, -0.005, 0.0)
    assert history.opening[0] == 1.5 * FINAL
    assert not law.bonded(history)[0]
    gap = np.linspace(1e-6, 2.0 * FINAL, 40)
    r = on_all(law, 40).respond(gap, None, history[np.zeros(40, int)])
    assert not r.slope.any() and not r.curvature.any()
    np.testing.assert_allclose(r.dissipated, ENERGY, rtol=1e-13)
    # It can still be pressed.
    pressed = law.respond(np.array([-0.001]), None, history)
    assert pressed.slope[0] == pytest.approx(-0.001 * PENALTY)


@each_adhesion
def test_response_does_not_depend_on_the_steps_of_opening(kind: str, always: bool) -> None:
    """Opened at once or in parts, the traction at the end is the same and so is what has been dissipated."""
    law = interface(kind, always)
    for furthest in (0.5 * ELASTIC, 0.5 * FINAL, 0.97 * FINAL):
        ends = []
        for parts in (1, 7):
            history = after(law, History.virgin(1), -0.001)
            for gap in np.linspace(0.0, furthest, parts + 1)[1:]:
                r = law.respond(np.array([gap]), None, history)
                history = after(law, history, gap)
            ends.append((r.slope[0], r.curvature[0], r.dissipated[0], history.opening[0]))
        np.testing.assert_allclose(ends[0], ends[1], rtol=1e-13, atol=1e-16)


# --- Potential ------------------------------------------------------------------------------------


def switch(law: InterfaceLaw, gap: Array, history: History) -> Array:
    """s(g), from the electric curvature -rho s."""
    return -on_all(law, len(gap)).respond(gap, np.ones_like(gap), history).electric_curvature / RHO


@each_law
def test_potentials_stay_equal_in_contact_and_while_bonded(kind: str, always: bool) -> None:
    law = interface(kind, always, electric=True)
    pressed = np.linspace(-0.01, -0.5 * FADE if kind == "unilateral" else 0.0, 20)
    np.testing.assert_allclose(switch(law, pressed, History.virgin(20)), 1.0, atol=1e-15)
    # What always attracts takes the potentials along wherever it attracts.
    far = np.linspace(1.0001 * (float(law.adhesion.final[0]) if always else FADE), 2.0 * FINAL, 20)
    assert not switch(law, far, History.virgin(20)).any()
    if law.adhesion is None:
        return
    final = float(law.adhesion.final[0])
    bonded = np.linspace(0.0, ELECTRIC_RELEASE * final, 20)
    touched = History(np.ones(20, bool), np.zeros(20))
    np.testing.assert_allclose(switch(law, bonded, touched), 1.0, atol=1e-14)
    fading = switch(law, np.linspace(ELECTRIC_RELEASE * final, final, 20), touched)
    assert (np.diff(fading) < 0.0).all() and abs(fading[-1]) < 1e-14
    # Once released it does not come back unless the gap is small.
    broken = History(np.ones(20, bool), np.full(20, 1.1 * final))
    assert not switch(law, far, broken).any()
    np.testing.assert_allclose(switch(law, pressed, broken), 1.0, atol=1e-15)
    # A bond that has nearly broken and goes back is still one.
    nearly = History(np.ones(20, bool), np.full(20, 0.99 * final))
    np.testing.assert_allclose(switch(law, bonded, nearly), 1.0, atol=1e-14)


@each_law
def test_electric_switch_is_once_smooth(kind: str, always: bool) -> None:
    """Value and slope of s(g) have no jumps: neighbours a little apart differ by a little, whatever the history."""
    law = interface(kind, always, electric=True)
    gap = np.linspace(-0.5 * FADE, 1.2 * FINAL, 20001)
    step = gap[1] - gap[0]
    width = FADE if law.adhesion is None else min(FADE, (1.0 - ELECTRIC_RELEASE) * float(law.adhesion.final[0]))
    states = histories()
    for i in range(len(states.opening)):
        rows = np.full(len(gap), i)
        mechanical = on_all(interface(kind, always), len(gap)).respond(gap, None, states[rows]).slope
        r = on_all(law, len(gap)).respond(gap, np.ones_like(gap), states[rows])
        s, s1 = -r.electric_curvature / RHO, -2.0 * (r.slope - mechanical) / RHO
        assert s.min() > -1e-14 and s.max() < 1.0 + 1e-14
        # |s'| <= 3/2 and |s''| <= 6 over the width of one fade; where both fade their slopes add up.
        assert np.abs(np.diff(s)).max() <= 2.0 * 1.5 * step / width
        assert np.abs(np.diff(s1)).max() <= 2.0 * 6.0 * step / width**2 + 1e-9 / width
        assert s[0] == 1.0 and s[-1] == 0.0


def test_traction_is_continuous_at_touch() -> None:
    """Pressure and adhesion meet at a gap of zero with one slope, so Newton's method sees no kink."""
    for kind, always in LAWS[1:]:
        law = on_all(interface(kind, always), 2)
        r = law.respond(np.array([-1e-12, 1e-12]), None, History(np.ones(2, bool), np.zeros(2)))
        np.testing.assert_allclose(r.slope, 0.0, atol=1e-8)
        np.testing.assert_allclose(r.curvature, PENALTY, rtol=1e-14)


# --- What is said of points -----------------------------------------------------------------------


@each_law
def test_status_and_bonds(kind: str, always: bool) -> None:
    law = on_all(interface(kind, always), 4)
    history = History(np.array([False, True, True, True]), np.array([0.0, 0.0, 0.5, 2.0]) * FINAL)
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
        far = np.array([law.interaction_range + 1e-14])
        if kind == "unilateral":
            assert law.interaction_range == (0.5 * FADE if electric else 0.0)
        for touched in (False, True):
            r = law.respond(far, np.ones(1), History(np.array([touched]), np.zeros(1)))
            assert not r.slope.any() and not r.charge.any() and not r.curvature.any()


def test_points_of_different_penalties_are_independent(rng: np.random.Generator) -> None:
    """The response of a law over many points is that of the law of each point, for any selection of rows."""
    penalty = rng.uniform(1000.0, 4000.0, 30)
    adhesion = CohesiveLaw.bilinear(STRENGTH, ENERGY, penalty)
    electric = EqualPotential(rng.uniform(0.1, 1.0, 30), rng.uniform(1.0, 2.0, 30) * FADE)
    law = InterfaceLaw(penalty, adhesion, electric)
    gap, jump = rng.uniform(-0.01, FINAL, 30), rng.standard_normal(30)
    history = History(rng.uniform(size=30) < 0.7, rng.uniform(0.0, FINAL, 30))
    history.opening[~history.touched] = 0.0
    whole = law.respond(gap, jump, history)
    rows = rng.permutation(30)[:20]
    some = law[rows].respond(gap[rows], jump[rows], history[rows])
    for name, values in whole.__dict__.items():
        np.testing.assert_array_equal(getattr(some, name), values[rows])
    for i in range(5):
        alone = InterfaceLaw(
            penalty[i : i + 1],
            CohesiveLaw.bilinear(STRENGTH, ENERGY, penalty[i : i + 1]),
            electric[i : i + 1],
        ).respond(gap[i : i + 1], jump[i : i + 1], history[[i]])
        assert alone.slope[0] == whole.slope[i] and alone.charge[0] == whole.charge[i]


def test_no_points_are_no_trouble() -> None:
    """Ranks without contact points evaluate the law too."""
    none = np.zeros(0)
    for kind, always in LAWS:
        law = interface(kind, always, points=0, electric=True)
        assert law.respond(none, none, History.virgin(0)).slope.shape == (0,)
        assert law.interaction_range == 0.0


@pytest.mark.parametrize("make", [CohesiveLaw.bilinear, CohesiveLaw.cutoff])
def test_too_soft_a_penalty_is_an_error(make: Callable[..., CohesiveLaw]) -> None:
    soft = STRENGTH**2 / (2.0 * ENERGY)
    make(STRENGTH, ENERGY, np.array([1.01 * soft]))
    with pytest.raises(ValueError, match="raise normal_penalty or the energy"):
        make(STRENGTH, ENERGY, np.array([1.01 * soft, soft]))


def test_history_remembers_the_largest_opening_since_touch() -> None:
    law = interface("bilinear", points=2)
    history = after(law, History.virgin(2), *([0.1, -0.01], [0.2, 0.3], [0.1, 0.1], [-0.1, 0.2], [0.05, 0.0]))
    np.testing.assert_array_equal(history.touched, True)
    np.testing.assert_allclose(history.opening, [0.05, 0.3])


def test_what_attracts_from_the_start_touches_within_its_elastic_opening() -> None:
    gap = np.array([-1e-3, 0.0, 0.99 * ELASTIC, 1.01 * ELASTIC])
    for kind, always in LAWS:
        touching = on_all(interface(kind, always), 4).touching(gap)
        np.testing.assert_array_equal(touching, [True, True, always, False])


@each_law
def test_bonds_of_points_that_meet_nothing_any_more_are_torn(kind: str, always: bool) -> None:
    law = on_all(interface(kind, always), 3)
    history = History(np.array([False, True, True]), np.array([0.0, 0.3 * FINAL, 3.0 * FINAL]))
    torn = law.on_loss_of_contact(history)
    assert not law.bonded(torn).any()
    np.testing.assert_array_equal(torn.touched, history.touched)
    assert (torn.opening >= history.opening).all()
    assert torn.opening[0] == 0.0
    if law.adhesion is not None:
        far = law.respond(np.full(3, 1e30), None, torn)
        np.testing.assert_allclose(far.dissipated, [0.0, ENERGY, ENERGY], rtol=1e-13)
