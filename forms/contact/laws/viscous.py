"""Viscous regularization of bonds: a resistance to opening within one part of a load step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.forms.arrays import Array
from piezomat.forms.contact.laws.law import COMPLETE_LAW, ContactLaw, LawMode
from piezomat.forms.contact.laws.response import Response


@dataclass(frozen=True)
class ViscousBonds(ContactLaw):
    """Resistance of points to opening: traction stiffness (gap - start), start (m,) in um, stiffness (m,) in MPa/um.

    A bond that softens faster than the bodies around it unload snaps; with this resistance it opens in small parts
    (Gao and Bower 2004). Its work is not stored: see `piezomat.solver.snap_through`.
    """

    start: Array
    stiffness: Array

    @classmethod
    def none(cls, points: int) -> ViscousBonds:
        """No resistance at any point."""
        return cls(np.zeros(points), np.zeros(points))

    def respond(self, q: Array, history: Array, mode: LawMode = COMPLETE_LAW) -> Response:
        """See `ContactLaw.respond`."""
        return Response.of_gap(q, {}, self.stiffness * (q[:, 0] - self.start), self.stiffness)
