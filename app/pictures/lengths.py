"""The unit of lengths in a picture, one throughout: um, or mm of large bodies."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

LABEL = {"fontsize": 11}
LARGE = 5000.0  # um


class Lengths(NamedTuple):
    """A unit of lengths, and how many of it are a micrometre."""

    factor: float
    unit: str

    @classmethod
    def of(cls, size: float) -> Lengths:
        """The unit for bodies of this size, um."""
        return cls(1e-3, "mm") if size >= LARGE else cls(1.0, "µm")

    def text(self, length: float) -> str:
        """A length, um, in words."""
        return f"{self.factor * length:,.6g} {self.unit}"

    def label(self, axis: Any, name: str) -> None:
        """Label an axis of matplotlib, whose data are in um."""
        axis.set_label_text(f"{name} ({self.unit})", **LABEL)
        if self.factor != 1.0:
            axis.set_major_formatter(lambda value, position: f"{self.factor * value:g}".replace("-", "\N{MINUS SIGN}"))


def direction_name(direction: Any) -> str:
    """Name of a direction in space: the axis that it is nearest to."""
    return "xyz"[int(np.argmax(np.abs(direction)))]
