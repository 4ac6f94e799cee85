"""The normal penalty: a pressure that grows linearly with the penetration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.forms.arrays import Array
from piezomat.forms.contact.laws.law import COMPLETE_LAW, ContactLaw, LawMode
from piezomat.forms.contact.laws.response import Response


@dataclass(frozen=True)
class NormalPenalty(ContactLaw):
    """Energy 1/2 k g^2 at gaps g < 0; stiffness k (m,), MPa/um."""

    stiffness: Array

    @property
    def penalties(self) -> tuple[Array, float]:
        """See `ContactLaw`."""
        return self.stiffness, 0.0

    def respond(self, q: Array, history: Array, mode: LawMode = COMPLETE_LAW) -> Response:
        """See `ContactLaw.respond`."""
        # At gap 0 the stiffness is that of compression: bodies that start in touch are most often pressed together.
        gap = q[:, 0]
        pressed = gap <= 0.0
        traction = np.where(pressed, self.stiffness * gap, 0.0)
        energies = {"contact": 0.5 * traction * np.minimum(gap, 0.0)}
        return Response.of_gap(q, energies, traction, np.where(pressed, self.stiffness, 0.0))
