"""Law of an interface: enthalpy per area of a contact point as a function of its gap g and its potential jump j.

The enthalpy is psi(g) - 1/2 c(g) j^2. psi is a penalty against penetration and, in tension, adhesion. c is the
capacitance per area of the gap; its term has the sign of the dielectric term (the interface is a thin dielectric
layer). The traction is the derivative by g: negative in compression, positive in adhesion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezomat.forms.arrays import Array, Booleans
from piezomat.forms.contact.laws.electric import ElectricLaw
from piezomat.forms.contact.laws.response import AdhesionLaw, History, Response


@dataclass(frozen=True)
class InterfaceLaw:
    """Penalty (m,) MPa/um against penetration, optional adhesion, optional exchange of charges."""

    penalty: Array
    adhesion: AdhesionLaw | None = None
    electric: ElectricLaw | None = None

    def __getitem__(self, rows: NDArray) -> InterfaceLaw:
        return InterfaceLaw(
            self.penalty[rows],
            self.adhesion[rows] if self.adhesion else None,
            self.electric[rows] if self.electric else None,
        )

    @property
    def interaction_range(self) -> float:
        """Largest gap of any point with a traction or a charge, um."""
        charged = 0.0 if self.electric is None else self.equilibrium_gap + self.electric.interaction_range
        return max(charged, self.adhesion.interaction_range if self.adhesion else 0.0)

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
        """Response at gaps (m,) in um and, with an electric law, potential jumps (m,) in V.

        attraction: whether charges pull on the surfaces; without it c is a given function of the state.
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
        if self.electric is not None and jump is not None:
            self._contribute_electric(gap, jump, history, response, attraction, consistent)
        return response

    def _contribute_electric(
        self, gap: Array, jump: Array, history: History, response: Response, attraction: bool, consistent: bool
    ) -> None:
        bonds = self.adhesion.electric_share(gap, history) if self.adhesion is not None else None
        c, c1, c2 = self.electric.capacitance(gap - self.equilibrium_gap, bonds)
        response.charge = -c * jump
        response.electric_curvature = -c
        response.electric = 0.5 * c * jump**2
        if attraction and self.electric.pulls:
            response.mixed = -c1 * jump
            response.slope = response.slope - 0.5 * c1 * jump**2
            stiffness = -0.5 * c2 * jump**2
            response.curvature = response.curvature + (stiffness if consistent else np.maximum(stiffness, 0.0))
