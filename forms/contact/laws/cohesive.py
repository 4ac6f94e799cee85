"""Cohesive laws: bonds with a strength, a work of separation and irreversible damage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.forms.arrays import Array, Booleans
from piezomat.forms.contact.laws.electric import WithDerivatives, smooth_step
from piezomat.forms.contact.laws.law import COMPLETE_LAW, ContactLaw, LawMode
from piezomat.forms.contact.laws.response import Response

CUTOFF_DROP = 0.1  # share of the cut-off's plateau over which the traction falls to zero, so that its slope is finite
ELECTRIC_RELEASE = 0.9  # share of the final opening up to which a bond keeps the potentials equal
LOADING_TOLERANCE = 1e-10  # of the final opening: a point this near to its largest opening unloads, despite round-off


@dataclass(frozen=True)
class CohesiveLaw(ContactLaw):
    """Traction over opening: linear to the strength, constant to `plateau`, linear to zero at `final`; irreversible.

    strength MPa; penalty (m,) MPa/um, the elastic stiffness; plateau, final (m,) um; always: bonded from the start.
    `bilinear` has no plateau (Alfano and Crisfield 2001); `cutoff` has one that ends in a short drop (Maugis 1992,
    Baney and Hui 1997). In compression it does nothing.

    history (m, 2): whether a point has touched, 0 or 1, and its largest opening since then, um.
    """

    strength: float
    penalty: Array
    plateau: Array
    final: Array
    always: bool = False

    history_size = 2
    softens = True

    @classmethod
    def bilinear(cls, strength: float, energy: float, penalty: Array, always: bool = False) -> CohesiveLaw:
        """Bilinear law of a strength (MPa) and an energy (pJ/um2). Raises ValueError if the penalty is too soft."""
        elastic = _elastic_opening(strength, energy, penalty)
        return cls(strength, penalty, elastic, np.full_like(elastic, 2.0 * energy / strength), always)

    @classmethod
    def cutoff(cls, strength: float, energy: float, penalty: Array, always: bool = False) -> CohesiveLaw:
        """Constant strength up to a cut-off, with this energy. Raises ValueError if the penalty is too soft."""
        elastic = _elastic_opening(strength, energy, penalty)
        return cls.cutoff_at(strength, energy / strength + 0.5 * elastic, penalty, always)

    @classmethod
    def cutoff_at(cls, strength: float, opening: Array | float, penalty: Array, always: bool = False) -> CohesiveLaw:
        """Constant strength up to a cut-off at `opening` (um), which must exceed the elastic opening."""
        elastic = strength / penalty
        half_drop = 0.5 * CUTOFF_DROP * (opening - elastic)
        return cls(strength, penalty, opening - half_drop, opening + half_drop, always)

    @property
    def elastic(self) -> Array:
        """Opening (m,) up to which the bond is elastic, um."""
        return self.strength / self.penalty

    @property
    def interaction_range(self) -> float:
        """Largest final opening, um."""
        return float(self.final.max(initial=0.0))

    @property
    def energy(self) -> Array:
        """Work of separation (m,), pJ/um2."""
        return self.envelope(self.final)[2]

    def committed(self, q: Array, history: Array) -> Array:
        """History after a step: points that are closed or, where surfaces always attract, elastic have touched."""
        gap = q[:, 0]
        touched = _touched(history) | (gap <= (self.elastic if self.always else 0.0))
        return np.column_stack([touched, np.where(touched, np.maximum(history[:, 1], gap), 0.0)])

    def on_loss_of_contact(self, history: Array) -> Array:
        """History after the closest point was lost: all bonds are broken."""
        broken = np.maximum(history[:, 1], 2.0 * self.final)
        return np.column_stack([history[:, 0], np.where(_touched(history), broken, history[:, 1])])

    def bonded(self, history: Array) -> Booleans:
        """Points (m,) that have touched and never opened as far as the final opening."""
        return _touched(history) & (history[:, 1] < self.final)

    def broken(self, history: Array) -> Booleans:
        """Points (m,) that have touched and opened as far as the final opening."""
        return _touched(history) & (history[:, 1] >= self.final)

    def softening(self, history: Array) -> Array:
        """Rate (m,) at which the traction falls beyond the plateau, MPa/um, of points that are or may be bonded."""
        steepness = self.strength / np.maximum(self.final - self.plateau, np.finfo(float).tiny)
        return steepness * self._attracts(history)

    def _attracts(self, history: Array) -> Booleans:
        return self.bonded(history) | (self.always & ~_touched(history))

    def electric_share(self, gap: Array, history: Array) -> WithDerivatives:
        """Share (m,) of the electric contact that bonds maintain, with its first and second derivative by the gap."""
        # A function of the gap alone while the bond holds: its slope is a traction, so it must not jump on a return.
        # Surfaces that always attract are bonded within the range from the start: touching must not switch it on.
        bonded, width = self._attracts(history), (1.0 - ELECTRIC_RELEASE) * self.final
        faded = smooth_step((gap - ELECTRIC_RELEASE * self.final) / width)
        b, b1, b2 = (np.where(bonded, value, 0.0) for value in faded)
        return b, b1 / width, b2 / width**2

    def respond(self, q: Array, history: Array, mode: LawMode = COMPLETE_LAW) -> Response:
        """See `ContactLaw.respond`."""
        gap, touched, opening = q[:, 0], _touched(history), history[:, 1]
        loading = (gap > opening + LOADING_TOLERANCE * self.final) | (self.always & ~touched)
        furthest = np.where(loading, np.maximum(gap, 0.0), opening)
        traction, tangent, work = self.envelope(furthest)
        secant = np.where(furthest > self.elastic, traction / np.maximum(furthest, self.elastic), self.penalty)
        active = touched | self.always
        opened = (gap > 0.0) & active
        stored = np.where(touched, 0.5 * secant * np.maximum(gap, 0.0) ** 2, work)
        damaged = np.where(touched, work - 0.5 * secant * furthest**2, 0.0)
        energies = {
            "adhesion": np.where(active, stored, 0.0) - (self.energy if self.always else 0.0),
            "dissipated": np.where(active, damaged, 0.0),
        }
        traction = np.where(opened, np.where(loading, traction, secant * gap), 0.0)
        return Response.of_gap(q, energies, traction, np.where(opened, np.where(loading, tangent, secant), 0.0))

    def envelope(self, opening: Array) -> tuple[Array, Array, Array]:
        """Traction, slope and work (m,) at a monotonically reached opening (m,)."""
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


def _touched(history: Array) -> Booleans:
    return history[:, 0] > 0.0


def _elastic_opening(strength: float, energy: float, penalty: Array) -> Array:
    elastic = strength / np.asarray(penalty, float)
    least = 0.5 * strength * elastic.max(initial=0.0)
    if energy <= least:
        raise ValueError(
            f"the adhesion energy {energy:g} pJ/um2 is used up before the strength {strength:g} MPa is reached "
            f"(strength^2 / (2 normal_penalty) = {least:g}): raise normal_penalty or the energy"
        )
    return elastic
