"""Laws of the interface: what a contact point answers to its gap and its potential jump.

The enthalpy of a point is psi(g) - 1/2 rho s(g) j^2 per area: a penalty against penetration, adhesion in tension,
and the equal-potential penalty rho with the sign of the dielectric term (the interface is a thin dielectric layer).
Traction is the slope of psi: negative in compression, positive in adhesion.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from piezomat.forms.arrays import Array
from piezomat.forms.contact.laws.lennard_jones import LennardJones

CUTOFF_DROP = 0.1  # share of the cut-off's plateau over which the traction falls to zero, so that it has a slope
ELECTRIC_RELEASE = 0.9  # share of the final opening up to which a bond keeps the potentials equal
# In voltage sqrt(permittivity/stiffness), which is the gap over which that voltage pulls with half the stiffness.
# Measured on half discs of PZT-5H under a traction, facets of 0.005 to 0.02 um: 2 fails at 50 V, 4 does no better.
PULL_IN_FACTOR = 3.0
LOADING_TOLERANCE = (
    1e-10  # of the final opening: a point this near to its largest opening unloads, whatever the round-off says
)


@dataclass
class History:
    """What a contact point remembers of converged steps: touched (m,) and its largest opening since (m,), um."""

    touched: NDArray[np.bool_]
    opening: Array

    @classmethod
    def virgin(cls, points: int) -> History:
        """History of points that have never touched."""
        return cls(np.zeros(points, bool), np.zeros(points))

    def __getitem__(self, rows: NDArray) -> History:
        return History(self.touched[rows], self.opening[rows])

    def copy(self) -> History:
        """A history of its own."""
        return History(self.touched.copy(), self.opening.copy())

    def advanced(self, gap: Array, touching: Array) -> History:
        """The history after a converged step that ended at this gap, `touching` (m,) at its end or not."""
        touched = self.touched | touching
        return History(touched, np.where(touched, np.maximum(self.opening, gap), 0.0))


@dataclass(frozen=True)
class Adhesion:
    """Traction over opening: linear to the strength, constant to `plateau`, linear to zero at `final`; irreversible.

    strength MPa, plateau and final (m,) or scalar, um. `bilinear` has no plateau (Alfano and Crisfield 2001);
    `cutoff` is a plateau that ends in a short drop (Maugis 1992, Baney and Hui 1997).
    """

    strength: float
    penalty: Array
    plateau: Array
    final: Array
    always: bool

    equilibrium_gap = 0.0  # gap at which surfaces rest without a force, um

    @classmethod
    def bilinear(cls, strength: float, energy: float, penalty: Array, always: bool = False) -> Adhesion:
        """Bilinear law with the given strength (MPa) and energy (pJ/um2). ValueError if the penalty is too soft."""
        elastic = _elastic_opening(strength, energy, penalty)
        return cls(strength, penalty, elastic, np.full_like(elastic, 2.0 * energy / strength), always)

    @classmethod
    def cutoff(cls, strength: float, energy: float, penalty: Array, always: bool = False) -> Adhesion:
        """Constant strength up to a cut-off, with the given energy. ValueError if the penalty is too soft."""
        elastic = _elastic_opening(strength, energy, penalty)
        return cls.cutoff_at(strength, energy / strength + 0.5 * elastic, penalty, always)

    @classmethod
    def cutoff_at(cls, strength: float, cut: Array | float, penalty: Array, always: bool = False) -> Adhesion:
        """Constant strength up to the opening `cut` (um), which must exceed the elastic opening."""
        elastic = strength / penalty
        half_drop = 0.5 * CUTOFF_DROP * (cut - elastic)
        return cls(strength, penalty, cut - half_drop, cut + half_drop, always)

    @property
    def elastic(self) -> Array:
        """Opening up to which the bond is elastic, um."""
        return self.strength / self.penalty

    @property
    def steepness(self) -> Array:
        """How fast the traction falls at most, MPa/um."""
        return self.strength / np.maximum(self.final - self.plateau, np.finfo(float).tiny)

    def __getitem__(self, rows: NDArray) -> Adhesion:
        return Adhesion(self.strength, self.penalty[rows], self.plateau[rows], self.final[rows], self.always)

    def bonded(self, history: History) -> NDArray[np.bool_]:
        """Points that stick: touched, and never opened as far as the bond's end."""
        return history.touched & (history.opening < self.final)

    def touching(self, gap: Array) -> NDArray[np.bool_]:
        """Points that touch at this gap: closed or, where it always attracts, within the elastic opening."""
        return gap <= (self.elastic if self.always else 0.0)

    def on_loss_of_contact(self, history: History) -> History:
        """History of points that no longer meet the other surface: what was bonded is torn."""
        torn = np.maximum(history.opening, 2.0 * self.final)
        return History(history.touched, np.where(history.touched, torn, history.opening))

    def electric_share(self, gap: Array, history: History) -> tuple[Array, Array, Array]:
        """Share of the electric contact that bonds keep, with its slope and curvature."""
        # A function of the gap alone as long as the bond holds: its slope pulls, so it must not jump on a return.
        # What always attracts is bonded within its range from the start: touching must not switch anything on.
        bonded, width = self.bonded(history) | (self.always & ~history.touched), (1.0 - ELECTRIC_RELEASE) * self.final
        b, b1, b2 = (np.where(bonded, value, 0.0) for value in _fade((gap - ELECTRIC_RELEASE * self.final) / width))
        return b, b1 / width, b2 / width**2

    def contribute(self, gap: Array, history: History, response: Response) -> None:
        """Add the law's slope, curvature and energies to those of the penalty."""
        loading = (gap > history.opening + LOADING_TOLERANCE * self.final) | (self.always & ~history.touched)
        furthest = np.where(loading, np.maximum(gap, 0.0), history.opening)
        traction, tangent, work = self.envelope(furthest)
        secant = np.where(furthest > self.elastic, traction / np.maximum(furthest, self.elastic), self.penalty)
        active = history.touched | self.always
        pulled = (gap > 0.0) & active
        response.slope = response.slope + np.where(pulled, np.where(loading, traction, secant * gap), 0.0)
        response.curvature = response.curvature + np.where(pulled, np.where(loading, tangent, secant), 0.0)
        stored = np.where(history.touched, 0.5 * secant * np.maximum(gap, 0.0) ** 2, work)
        damaged = np.where(history.touched, work - 0.5 * secant * furthest**2, 0.0)
        response.adhesion = np.where(active, stored, 0.0) - (self.energy if self.always else 0.0)
        response.dissipated = np.where(active, damaged, 0.0)

    def envelope(self, opening: Array) -> tuple[Array, Array, Array]:
        """Traction, slope and work up to an opening that has never been exceeded."""
        g0, g1, g2, s = self.elastic, self.plateau, self.final, self.strength
        fall = np.maximum(g2 - g1, np.finfo(float).tiny)
        branch = [opening <= g0, opening <= g1, opening <= g2]
        traction = np.select(branch, [self.penalty * opening, s, s * (g2 - opening) / fall], 0.0)
        slope = np.select(branch, [self.penalty, 0.0, -s / fall], 0.0)
        to_g1 = 0.5 * s * g0 + s * (g1 - g0)
        work = np.select(
            branch,
            [
                0.5 * self.penalty * opening**2,
                0.5 * s * g0 + s * (opening - g0),
                to_g1 + 0.5 * (s + traction) * (opening - g1),
            ],
            to_g1 + 0.5 * s * (g2 - g1),
        )
        return traction, slope, work

    @property
    def energy(self) -> Array:
        """Work of separation, pJ/um2."""
        return self.envelope(self.final)[2]


def _elastic_opening(strength: float, energy: float, penalty: Array) -> Array:
    elastic = strength / np.asarray(penalty, float)
    least = 0.5 * strength * elastic.max(initial=0.0)
    if energy <= least:
        raise ValueError(
            f"the adhesion energy {energy:g} pJ/um2 is used up before the strength {strength:g} MPa is reached "
            f"(strength^2 / (2 normal_penalty) = {least:g}): raise normal_penalty or the energy"
        )
    return elastic


@dataclass
class ViscousBonds:
    """Viscous resistance of bonds to opening within one part of a step: stiffness (gap - start), (m,) each.

    start um, stiffness MPa/um. Bonds that soften faster than the bodies around them snap; this lets them do so in small
    parts (Gao and Bower 2004).
    """

    start: Array
    stiffness: Array

    def __getitem__(self, rows: NDArray) -> ViscousBonds:
        return ViscousBonds(self.start[rows], self.stiffness[rows])

    @classmethod
    def none(cls, points: int) -> ViscousBonds:
        """Drag of points that nothing drags."""
        return cls(np.zeros(points), np.zeros(points))

    def traction(self, gap: Array, rows: NDArray) -> Array:
        """Traction of some of the points, MPa."""
        return self.stiffness[rows] * (gap - self.start[rows])


@dataclass
class Response:
    """Derivatives of a point's enthalpy per area, and its energies (pJ/um2).

    slope = d/dg, curvature = d2/dg2; charge = d/dj, electric_curvature = d2/dj2, mixed = d2/(dg dj).
    contact, adhesion, electric: stored; dissipated: by irreversible opening.
    """

    slope: Array
    curvature: Array
    charge: Array
    electric_curvature: Array
    mixed: Array
    contact: Array
    adhesion: Array
    electric: Array
    dissipated: Array

    def linearized(self, change: Array) -> tuple[Array, Array]:
        """Slope and charge after changes (2, m) of gap and jump, were they linear in both."""
        gap, jump = change
        slope = self.slope + self.curvature * gap + self.mixed * jump
        return slope, self.charge + self.mixed * gap + self.electric_curvature * jump


@dataclass(frozen=True)
class InterfaceLaw:
    """Penalty (m,) MPa/um, optional adhesion, electric penalty (m,) pC/(V um2) that fades out over `fade` (m,) um."""

    penalty: Array
    adhesion: Adhesion | LennardJones | None = None
    electric_penalty: Array | None = None
    fade: Array | None = field(default=None)

    def __getitem__(self, rows: NDArray) -> InterfaceLaw:
        return InterfaceLaw(
            self.penalty[rows],
            self.adhesion[rows] if self.adhesion else None,
            self.electric_penalty[rows] if self.electric_penalty is not None else None,
            self.fade[rows] if self.fade is not None else None,
        )

    @property
    def interaction_range(self) -> float:
        """Largest gap at which a point can still answer, um."""
        fading = 0.0 if self.fade is None else self.equilibrium_gap + float(self.fade.max(initial=0.0))
        return max(fading, float(self.adhesion.final.max(initial=0.0)) if self.adhesion else 0.0)

    @property
    def equilibrium_gap(self) -> float:
        """Gap at and below which surfaces are in contact, um: that at which they rest without a force."""
        return 0.0 if self.adhesion is None else self.adhesion.equilibrium_gap

    def bonded(self, history: History) -> NDArray[np.bool_]:
        """Points that stick: touched, and never opened as far as the bond's end."""
        return np.zeros(len(self.penalty), bool) if self.adhesion is None else self.adhesion.bonded(history)

    def touching(self, gap: Array) -> NDArray[np.bool_]:
        """Points that touch at this gap, which the history remembers."""
        return gap <= 0.0 if self.adhesion is None else self.adhesion.touching(gap)

    def on_loss_of_contact(self, history: History) -> History:
        """History of points that no longer meet the other surface."""
        return history if self.adhesion is None else self.adhesion.on_loss_of_contact(history)

    def status(self, gap: Array, history: History) -> NDArray[np.int8]:
        """0 apart, 1 touching, 2 bonded in tension, 3 broken."""
        bonded = self.bonded(history)
        apart = np.where(bonded, 2, 0)
        if self.adhesion is not None:
            apart = np.where(history.touched & ~bonded, 3, apart)
        return np.where(gap <= self.equilibrium_gap, 1, apart).astype(np.int8)

    def respond(
        self, gap: Array, jump: Array | None, history: History, *, attraction: bool = True, consistent: bool = True
    ) -> Response:
        """Response at gaps (m,) and, with an electric penalty, potential jumps (m,) in V.

        Without `attraction` the electric contact follows the gap and does not pull on the surfaces. A tangent that is
        not `consistent` leaves out the negative stiffness of the attraction.
        """
        # At gap 0 the curvature is that of pressing: bodies that start in touch are most often pressed together.
        pressed = gap <= 0.0
        slope = np.where(pressed, self.penalty * gap, 0.0)
        curvature = np.where(pressed, self.penalty, 0.0)
        contact = 0.5 * slope * np.minimum(gap, 0.0)
        zero = np.zeros_like(gap)
        response = Response(slope, curvature, zero, zero, zero, contact, zero, zero, zero)
        if self.adhesion is not None:
            self.adhesion.contribute(gap, history, response)
        if self.electric_penalty is not None and jump is not None:
            self._electrify(gap, jump, history, response, attraction, consistent)
        return response

    def _electrify(
        self, gap: Array, jump: Array, history: History, response: Response, attraction: bool, consistent: bool
    ) -> None:
        s, s1, s2 = _fade((gap - self.equilibrium_gap) / self.fade)
        s1, s2 = s1 / self.fade, s2 / self.fade**2
        if self.adhesion is not None:
            b, b1, b2 = self.adhesion.electric_share(gap, history)
            s2 = (1.0 - b) * s2 - 2.0 * s1 * b1 + (1.0 - s) * b2
            s1 = (1.0 - b) * s1 + (1.0 - s) * b1
            s = 1.0 - (1.0 - s) * (1.0 - b)
        rho = self.electric_penalty
        response.charge = -rho * s * jump
        response.electric_curvature = -rho * s
        response.electric = 0.5 * rho * s * jump**2
        if attraction:
            response.mixed = -rho * s1 * jump
            response.slope = response.slope - 0.5 * rho * s1 * jump**2
            stiffness = -0.5 * rho * s2 * jump**2
            response.curvature = response.curvature + (stiffness if consistent else np.maximum(stiffness, 0.0))


def stable_electric_range(voltage: float, permittivity: Array, stiffness: Array) -> Array:
    """Gap (m,) um: where contact fades out over less, surfaces so many V apart pull harder than bodies resist.

    permittivity (m,) pC/(V um), stiffness (m,) MPa. Facets four times finer asked for no less.
    """
    return PULL_IN_FACTOR * voltage * np.sqrt(permittivity / stiffness)


def _fade(x: Array) -> tuple[Array, Array, Array]:
    """1 below 0, 0 above 1, once smooth in between; value, slope and curvature."""
    y = np.clip(x, 0.0, 1.0)
    inside = (x > 0.0) & (x < 1.0)
    return 1.0 - y * y * (3.0 - 2.0 * y), -6.0 * y * (1.0 - y), np.where(inside, -6.0 + 12.0 * y, 0.0)
