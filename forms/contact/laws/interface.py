"""Law of an interface: enthalpy per area of a contact point as a function of its gap g and its potential jump j.

The enthalpy is psi(g) - 1/2 rho s(g) j^2. psi is a penalty against penetration and, in tension, adhesion. rho is the
penalty for equal potentials; it has the sign of the dielectric term (the interface is a thin dielectric layer). s fades
from 1 to 0 as the gap opens. The traction is the derivative by g: negative in compression, positive in adhesion.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from piezomat.forms.arrays import Array, Booleans
from piezomat.forms.contact.laws.response import AdhesionLaw, History, Response, smooth_step

# In voltage sqrt(permittivity/stiffness), the gap over which that voltage pulls with half the stiffness.
# Measured on half discs of PZT-5H under a traction, facets of 0.005 to 0.02 um: 2 fails at 50 V, 4 does no better.
PULL_IN_FACTOR = 3.0


@dataclass(frozen=True)
class InterfaceLaw:
    """Penalty (m,) MPa/um, optional adhesion, electric penalty (m,) pC/(V um2) that fades out over `fade` (m,) um."""

    penalty: Array
    adhesion: AdhesionLaw | None = None
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
        """Largest gap of any point with a traction or a charge, um."""
        fading = 0.0 if self.fade is None else self.equilibrium_gap + float(self.fade.max(initial=0.0))
        return max(fading, self.adhesion.interaction_range if self.adhesion else 0.0)

    @property
    def equilibrium_gap(self) -> float:
        """Gap without traction, um: at and below it surfaces are in contact."""
        return 0.0 if self.adhesion is None else self.adhesion.equilibrium_gap

    def bonded(self, history: History) -> Booleans:
        """Whether points (m,) are bonded."""
        return np.zeros(len(self.penalty), bool) if self.adhesion is None else self.adhesion.bonded(history)

    def touching(self, gap: Array) -> Booleans:
        """Whether points touch at these gaps (m,), which the history then records."""
        return gap <= 0.0 if self.adhesion is None else self.adhesion.touching(gap)

    def on_loss_of_contact(self, history: History) -> History:
        """History of points whose closest point on the other surface no longer exists."""
        return history if self.adhesion is None else self.adhesion.on_loss_of_contact(history)

    def status(self, gap: Array, history: History) -> NDArray[np.int8]:
        """State (m,) of points: 0 apart, 1 touching, 2 bonded in tension, 3 broken."""
        bonded = self.bonded(history)
        apart = np.where(bonded, 2, 0)
        if self.adhesion is not None:
            apart = np.where(history.touched & ~bonded, 3, apart)
        return np.where(gap <= self.equilibrium_gap, 1, apart).astype(np.int8)

    def respond(
        self, gap: Array, jump: Array | None, history: History, *, attraction: bool = True, consistent: bool = True
    ) -> Response:
        """Response at gaps (m,) in um and, with an electric penalty, potential jumps (m,) in V.

        attraction: whether the electric contact pulls on the surfaces; without it s is a given function of the state.
        consistent: whether the curvature has the negative stiffness of the attraction.
        """
        # At gap 0 the curvature is that of compression: bodies that start in touch are most often pressed together.
        pressed = gap <= 0.0
        slope = np.where(pressed, self.penalty * gap, 0.0)
        curvature = np.where(pressed, self.penalty, 0.0)
        contact = 0.5 * slope * np.minimum(gap, 0.0)
        zero = np.zeros_like(gap)
        response = Response(slope, curvature, zero, zero, zero, contact, zero, zero, zero)
        if self.adhesion is not None:
            self.adhesion.contribute(gap, history, response)
        if self.electric_penalty is not None and jump is not None:
            self._contribute_electric(gap, jump, history, response, attraction, consistent)
        return response

    def _contribute_electric(
        self, gap: Array, jump: Array, history: History, response: Response, attraction: bool, consistent: bool
    ) -> None:
        s, s1, s2 = smooth_step((gap - self.equilibrium_gap) / self.fade)
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
    """Least gap (m,), um, over which electric contact may fade out at this voltage (V) without pull-in.

    Over less, the attraction grows faster with approach than the bodies' resistance. permittivity (m,) pC/(V um),
    stiffness (m,) MPa. Facets four times finer needed no less.
    """
    return PULL_IN_FACTOR * voltage * np.sqrt(permittivity / stiffness)
