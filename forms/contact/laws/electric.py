"""Laws of the potential jump: a gap is a capacitor, whose capacitance per area depends on the gap."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from piezomat.forms.arrays import Array
from piezomat.forms.contact.laws.law import COMPLETE_LAW, ContactLaw, LawMode
from piezomat.forms.contact.laws.response import Response

# A function of the gap with its first and second derivative, (m,) each.
WithDerivatives = tuple[Array, Array, Array]


class CapacitiveLaw(ContactLaw):
    """Enthalpy -1/2 c(g) j^2 per area at a potential jump j, with the capacitance c of the gap: the charge is -c j.

    Its sign is that of the dielectric term: the interface is a thin dielectric layer.

    rest_gap: gap of surfaces at rest, um, from which that of the capacitance counts
    pulls: whether charges pull on the surfaces; without, c is a given function of the state
    """

    rest_gap: float
    pulls: bool = True
    has_charges = True

    @abstractmethod
    def capacitance(self, gap: Array) -> WithDerivatives:
        """Capacitance (m,), pC/(V um2), with derivatives, at gaps (m,) beyond that of surfaces at rest, um."""

    def respond(self, q: Array, history: Array, mode: LawMode = COMPLETE_LAW) -> Response:
        """See `ContactLaw.respond`."""
        return self.respond_with(self.capacitance(q[:, 0] - self.rest_gap), q, mode)

    def respond_with(self, capacitance: WithDerivatives, q: Array, mode: LawMode) -> Response:
        """Response of this capacitance at q (m, 2)."""
        (c, c1, c2), jump = capacitance, q[:, 1]
        energy = 0.5 * c * jump**2
        gradient, hessian = np.zeros_like(q), np.zeros((*q.shape, 2))
        gradient[:, 1], hessian[:, 1, 1] = -c * jump, -c
        if mode.attraction and self.pulls:
            gradient[:, 0] = -0.5 * c1 * jump**2
            stiffness = -0.5 * c2 * jump**2
            hessian[:, 0, 0] = stiffness if mode.consistent else np.maximum(stiffness, 0.0)
            hessian[:, 0, 1] = hessian[:, 1, 0] = -c1 * jump
        return Response({"electric": energy}, gradient, hessian)


def smooth_step(x: Array) -> WithDerivatives:
    """Cubic from 1 at x <= 0 to 0 at x >= 1, with first and second derivative (m,)."""
    y = np.clip(x, 0.0, 1.0)
    inside = (x > 0.0) & (x < 1.0)
    return 1.0 - y * y * (3.0 - 2.0 * y), -6.0 * y * (1.0 - y), np.where(inside, -6.0 + 12.0 * y, 0.0)
