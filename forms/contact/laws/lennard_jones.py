"""Attraction and repulsion of two surfaces whose molecules attract each other by Lennard-Jones forces.

Half spaces at a distance g pull each other with T(g) = A/(2 pi r0^3) [(r0/g)^3/3 - (r0/g)^9/45] per area (Yu and
Polycarpou, J. Colloid Interface Sci. 278 (2004) 428-435). It is followed exactly between two gaps: below `near`,
where it has become as stiff as the normal penalty, that penalty takes over, so that no gap is forbidden; from
`CUTOFF_START` r0 on a cubic takes it to zero at twice that gap, so that the search ends there and changes no result.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from piezomat.forms.arrays import Array

if TYPE_CHECKING:
    from piezomat.forms.contact.laws.interface import History, Response


CUTOFF_START = 5.0  # gap, in r0, from which the traction (0.5 % of the strongest) goes to zero
EQUILIBRIUM = 15.0 ** (-1 / 6)  # gap without traction, in r0
PEAK = 5.0 ** (-1 / 6)  # gap of the strongest pull, in r0
NEWTON_ITERATIONS = 60  # of Newton's method from above, on a convex function


@dataclass(frozen=True)
class LennardJones:
    """The law between surfaces of given strength and energy; nothing is remembered, nothing dissipated.

    scale A/(2 pi r0^3) MPa, distance r0 um. penalty (m,) MPa/um takes over below the gap `near` (m,), um.
    """

    scale: float
    distance: float
    penalty: Array
    near: Array

    always = True  # attracts whatever comes near

    @classmethod
    def of(cls, strength: float, energy: float, penalty: Array) -> LennardJones:
        """The law whose strongest pull is `strength` (MPa) and whose work from rest to infinity is `energy` (pJ/um2).

        ValueError if the penalty is softer than the law is at rest.
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

    def __getitem__(self, rows: NDArray) -> LennardJones:
        return LennardJones(self.scale, self.distance, self.penalty[rows], self.near[rows])

    @property
    def hamaker(self) -> float:
        """The constant A, pJ."""
        return 2.0 * np.pi * self.distance**3 * self.scale

    @property
    def equilibrium_gap(self) -> float:
        """Gap at which surfaces rest without a force, um."""
        return EQUILIBRIUM * self.distance

    @property
    def final(self) -> Array:
        """Gap beyond which nothing pulls, (m,) um."""
        return np.full_like(self.penalty, 2.0 * CUTOFF_START * self.distance)

    @property
    def steepness(self) -> Array:
        """How fast the traction falls at most, (m,) MPa/um: where (r0/g)^6 = 2."""
        steepest = -_unit(np.array([2.0 ** (-1 / 6)]))[1][0]
        return np.full_like(self.penalty, steepest * self.scale / self.distance)

    def bonded(self, history: History) -> NDArray[np.bool_]:
        """No point: what attracts again whenever it comes near is no bond."""
        return np.zeros(len(history.touched), bool)

    def touching(self, gap: Array) -> NDArray[np.bool_]:
        """No point: there is nothing to remember."""
        return np.zeros(len(gap), bool)

    def on_loss_of_contact(self, history: History) -> History:
        """History of points that no longer meet the other surface: as it was."""
        return history

    def electric_share(self, gap: Array, history: History) -> tuple[Array, Array, Array]:
        """Share of the electric contact that bonds keep, with slope and curvature: none."""
        return (np.zeros_like(gap),) * 3

    def contribute(self, gap: Array, history: History, response: Response) -> None:
        """Put the law's own slope, curvature and energies, pJ/um2, in the place of the penalty's.

        Stored energy is zero at infinite distance: what is below that of rest counts as contact, else as adhesion.
        """
        traction, slope, energy = self._at(np.maximum(gap, self.near))
        deeper = np.minimum(gap - self.near, 0.0)
        response.slope = traction + self.penalty * deeper
        response.curvature = np.where(gap < self.near, self.penalty, slope)
        energy = energy + deeper * (traction + 0.5 * self.penalty * deeper)
        lowest = self._at(np.array([self.equilibrium_gap]))[2]
        response.contact = np.where(gap < self.equilibrium_gap, energy - lowest, 0.0)
        response.adhesion = np.where(gap < self.equilibrium_gap, lowest, energy)

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
