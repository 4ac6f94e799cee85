"""Equal potentials where surfaces touch, by a penalty: the law of Maruccio et al., in which no charge passes a gap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.forms.arrays import Array
from piezomat.forms.contact.laws.cohesive import CohesiveLaw
from piezomat.forms.contact.laws.electric import CapacitiveLaw, WithDerivatives, smooth_step
from piezomat.forms.contact.laws.law import COMPLETE_LAW, LawMode, Sum
from piezomat.forms.contact.laws.response import Response

# In voltage sqrt(permittivity/stiffness), the gap over which that voltage pulls with half the stiffness.
# Measured on half discs of PZT-5H under a traction, facets of 0.005 to 0.02 um: 2 fails at 50 V, 4 does no better.
PULL_IN_FACTOR = 3.0


@dataclass(frozen=True)
class EqualPotential(CapacitiveLaw):
    """Electric penalty (m,), pC/(V um2), that is switched off over `fade` (m,), um.

    start: gap from which it is switched off, in `fade`. Without bonds half of it lies on each side of touch, which is
    nearest to its limit. Bonds form at touch and maintain their share of it: there all of it must lie beyond, or a
    charge would jump.
    """

    penalty: Array
    fade: Array
    start: float = -0.5
    rest_gap: float = 0.0

    @property
    def interaction_range(self) -> float:
        """Largest gap of any point with a charge, um."""
        return self.rest_gap + (1.0 + self.start) * float(self.fade.max(initial=0.0))

    @property
    def penalties(self) -> tuple[float, Array]:
        """See `ContactLaw`."""
        return 0.0, self.penalty

    def capacitance(self, gap: Array) -> WithDerivatives:
        """Capacitance (m,) with derivatives, see `CapacitiveLaw`."""
        s, s1, s2 = self.share(gap)
        return self.penalty * s, self.penalty * s1, self.penalty * s2

    def share(self, gap: Array) -> WithDerivatives:
        """Share (m,) of the penalty at gaps (m,) beyond that of surfaces at rest, with derivatives."""
        s, s1, s2 = smooth_step(gap / self.fade - self.start)
        return s, s1 / self.fade, s2 / self.fade**2


class ConductingBonds(Sum):
    """Bonds that also keep the potentials equal, while they hold: the history is that of the bonds."""

    parts: tuple[CohesiveLaw, EqualPotential]

    def respond(self, q: Array, history: Array, mode: LawMode = COMPLETE_LAW) -> Response:
        """See `ContactLaw.respond`."""
        bonds, electric = self.parts
        s, s1, s2 = electric.share(q[:, 0] - electric.rest_gap)
        b, b1, b2 = bonds.electric_share(q[:, 0], history)
        s2 = (1.0 - b) * s2 - 2.0 * s1 * b1 + (1.0 - s) * b2
        s1 = (1.0 - b) * s1 + (1.0 - s) * b1
        s = 1.0 - (1.0 - s) * (1.0 - b)
        capacitance = electric.penalty * s, electric.penalty * s1, electric.penalty * s2
        return bonds.respond(q, history, mode) + electric.respond_with(capacitance, q, mode)


def stable_electric_range(voltage: float, permittivity: Array, stiffness: Array) -> Array:
    """Least gap (m,), um, over which electric contact may fade out at this voltage (V) without pull-in.

    Over less, the attraction grows faster with approach than the bodies' resistance. permittivity (m,) pC/(V um),
    stiffness (m,) MPa. Facets four times finer needed no less.
    """
    return PULL_IN_FACTOR * voltage * np.sqrt(permittivity / stiffness)
