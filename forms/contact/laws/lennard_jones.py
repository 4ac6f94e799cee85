"""Attraction and repulsion of two surfaces whose molecules attract each other by Lennard-Jones forces.

Half spaces at a distance g attract each other with T(g) = A/(2 pi r0^3) [(r0/g)^3/3 - (r0/g)^9/45] per area (Yu and
Polycarpou, J. Colloid Interface Sci. 278 (2004) 428-435). The law is exact between two gaps. Below `near`, where it is
as stiff as the normal penalty, that penalty replaces it, so that the traction is defined at every gap. From
`CUTOFF_START` r0 on a cubic takes it to zero at twice that gap, so that the interaction range is finite.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from piezomat.forms.arrays import Array
from piezomat.forms.contact.laws.law import COMPLETE_LAW, ContactLaw, LawMode
from piezomat.forms.contact.laws.response import Response

CUTOFF_START = 5.0  # gap, in r0, from which the traction (0.5 % of the peak) goes to zero
EQUILIBRIUM = 15.0 ** (-1 / 6)  # gap without traction, in r0
PEAK = 5.0 ** (-1 / 6)  # gap of the largest traction, in r0
NEWTON_ITERATIONS = 60  # from above, on a convex function


@dataclass(frozen=True)
class LennardJones(ContactLaw):
    """Reversible law between surfaces of given strength and energy: without history and without dissipation.

    scale MPa, A/(2 pi r0^3); distance um, r0; penalty (m,) MPa/um, in effect below the gap `near` (m,), um.
    """

    scale: float
    distance: float
    penalty: Array
    near: Array

    softens = True

    @classmethod
    def of(cls, strength: float, energy: float, penalty: Array) -> LennardJones:
        """Law with this largest traction (MPa) and this work from the equilibrium gap to infinity (pJ/um2).

        Raises ValueError if the penalty is softer than the law at the equilibrium gap.
        """
        scale = strength / _unit(np.array([PEAK]))[0][0]
        distance = energy / (scale * _unit(np.array([EQUILIBRIUM]))[2][0])
        penalty = np.asarray(penalty, float)
        stiffest = penalty * distance / scale
        least = _unit(np.array([EQUILIBRIUM]))[1][0]
        if stiffest.min(initial=np.inf) < least:
            raise ValueError(
                f"the normal penalty {penalty.min():g} MPa/um is softer than the law at rest "
                f"({least * scale / distance:g} MPa/um): raise normal_penalty or the energy, or lower the strength"
            )
        return cls(scale, distance, penalty, distance * _as_stiff_as(stiffest))

    @property
    def hamaker(self) -> float:
        """Hamaker constant A, pJ."""
        return 2.0 * np.pi * self.distance**3 * self.scale

    @property
    def equilibrium_gap(self) -> float:
        """Gap without traction, um."""
        return EQUILIBRIUM * self.distance

    @property
    def interaction_range(self) -> float:
        """Gap from which the traction is zero, um."""
        return 2.0 * CUTOFF_START * self.distance

    @property
    def penalties(self) -> tuple[Array, float]:
        """See `ContactLaw`."""
        return self.penalty, 0.0

    def softening(self, history: Array) -> Array:
        """Largest rate (m,) at which the traction falls with the gap, MPa/um: that at (r0/g)^6 = 2."""
        steepest = -_unit(np.array([2.0 ** (-1 / 6)]))[1][0]
        return np.full(len(history), steepest * self.scale / self.distance)

    def respond(self, q: Array, history: Array, mode: LawMode = COMPLETE_LAW) -> Response:
        """See `ContactLaw.respond`.

        Energies are zero at infinite distance. Below the equilibrium gap the energy at that gap is adhesion and the
        rest is contact; above it all is adhesion.
        """
        gap = q[:, 0]
        traction, slope, energy = self._at(np.maximum(gap, self.near))
        deeper = np.minimum(gap - self.near, 0.0)
        energy = energy + deeper * (traction + 0.5 * self.penalty * deeper)
        lowest = self._at(np.array([self.equilibrium_gap]))[2]
        energies = {
            "contact": np.where(gap < self.equilibrium_gap, energy - lowest, 0.0),
            "adhesion": np.where(gap < self.equilibrium_gap, lowest, energy),
        }
        stiffness = np.where(gap < self.near, self.penalty, slope)
        return Response.of_gap(q, energies, traction + self.penalty * deeper, stiffness)

    def _at(self, gap: Array) -> tuple[Array, Array, Array]:
        """Traction, slope and energy at gaps where the law itself holds."""
        traction, slope, work = _unit(gap / self.distance)
        return self.scale * traction, self.scale / self.distance * slope, -self.scale * self.distance * work


def _unit(gap: Array) -> tuple[Array, Array, Array]:
    """Traction, slope and work from here to infinity of the law with r0 and A/(2 pi r0^3) equal to one."""
    traction, slope, work = _power_law(np.minimum(gap, CUTOFF_START))
    x = np.clip(gap / CUTOFF_START - 1.0, 0.0, 1.0)
    t, s = _edge()[0], CUTOFF_START * _edge()[1]
    tail = t * (1.0 - 3.0 * x**2 + 2.0 * x**3) + s * (x - 2.0 * x**2 + x**3)
    tail_slope = (t * 6.0 * (x**2 - x) + s * (1.0 - 4.0 * x + 3.0 * x**2)) / CUTOFF_START
    tail_work = t * (0.5 - x + x**3 - 0.5 * x**4) + s * (1.0 / 12.0 - 0.5 * x**2 + 2.0 / 3.0 * x**3 - 0.25 * x**4)
    near = gap <= CUTOFF_START
    whole = CUTOFF_START * (t / 2.0 + s / 12.0)
    return (
        np.where(near, traction, tail),
        np.where(near, slope, tail_slope),
        np.where(near, work - _edge()[2] + whole, CUTOFF_START * tail_work),
    )


def _power_law(gap: Array) -> tuple[Array, Array, Array]:
    """Traction, slope and work to infinity of (1/g)^3/3 - (1/g)^9/45."""
    s = 1.0 / gap
    return s**3 / 3.0 - s**9 / 45.0, s**10 / 5.0 - s**4, s**2 / 6.0 - s**8 / 360.0


@cache
def _edge() -> tuple[float, float, float]:
    """The power law where the tail begins."""
    return tuple(float(value[0]) for value in _power_law(np.array([CUTOFF_START])))


def _as_stiff_as(slope: Array) -> Array:
    """The gap (m,) <= EQUILIBRIUM at which the power law has this slope (m,): s^10/5 - s^4 = slope for s = 1/g."""
    s = 1.5 * np.maximum(1.0 / EQUILIBRIUM, (5.0 * slope) ** 0.1)
    for _ in range(NEWTON_ITERATIONS):
        s = s - (s**10 / 5.0 - s**4 - slope) / (2.0 * s**9 - 4.0 * s**3)
    return 1.0 / s
