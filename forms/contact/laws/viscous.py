"""Viscous regularization of bonds: a resistance to opening within one part of a load step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezomat.forms.arrays import Array


@dataclass
class ViscousBonds:
    """Resistance of points to opening: traction stiffness (gap - start), start (m,) in um, stiffness (m,) in MPa/um.

    A bond that softens faster than the bodies around it unload snaps; with this resistance it opens in small parts
    (Gao and Bower 2004).
    """

    start: Array
    stiffness: Array

    def __getitem__(self, rows: NDArray) -> ViscousBonds:
        return ViscousBonds(self.start[rows], self.stiffness[rows])

    @classmethod
    def none(cls, points: int) -> ViscousBonds:
        """No resistance at any point."""
        return cls(np.zeros(points), np.zeros(points))

    def traction(self, gap: Array, rows: NDArray) -> Array:
        """Traction of the points `rows` at their gaps, MPa."""
        return self.stiffness[rows] * (gap - self.start[rows])
