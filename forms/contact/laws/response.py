"""What a contact law gives for a point, the history that it remembers, and what an adhesion law must provide."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from piezomat.forms.arrays import Array, Booleans


@dataclass
class History:
    """State of contact points at the end of the last converged step.

    touched (m,): whether they have touched; opening (m,), um: the largest opening since then.
    """

    touched: Booleans
    opening: Array

    @classmethod
    def virgin(cls, points: int) -> History:
        """History of points that have never touched."""
        return cls(np.zeros(points, bool), np.zeros(points))

    def __getitem__(self, rows: NDArray) -> History:
        return History(self.touched[rows], self.opening[rows])

    def copy(self) -> History:
        """Copy that shares no array."""
        return History(self.touched.copy(), self.opening.copy())

    def advanced(self, gap: Array, touching: Booleans) -> History:
        """History after a converged step that ended at `gap` (m,), um, with the points `touching` (m,) in contact."""
        touched = self.touched | touching
        return History(touched, np.where(touched, np.maximum(self.opening, gap), 0.0))


@dataclass
class Response:
    """Derivatives of the enthalpy per area of points by gap g and potential jump j, and energies per area; all (m,).

    slope (MPa): d/dg, the traction, negative in compression; curvature (MPa/um): d2/dg2; charge (pC/um2): d/dj;
    electric_curvature (pC/(V um2)): d2/dj2; mixed (pC/um3): d2/(dg dj).
    contact, adhesion, electric (pJ/um2): stored; dissipated (pJ/um2): by irreversible opening.
    """

    slope: Array
    curvature: Array
    charge: Array
    electric_curvature: Array
    mixed: Array
    contact: Array
    adhesion: Array
    electric: Array
    dissipated: Array

    def linearized(self, change: Array) -> tuple[Array, Array]:
        """Slope and charge extrapolated linearly by changes (2, m) of gap and jump."""
        gap, jump = change
        slope = self.slope + self.curvature * gap + self.mixed * jump
        return slope, self.charge + self.mixed * gap + self.electric_curvature * jump


class AdhesionLaw(Protocol):
    """Adhesion as `InterfaceLaw` uses it: a traction over the gap, added to the penalty against penetration.

    A subclass has `interaction_range`, `steepness`, rows and `contribute` at least: it is then a law without history.

    always: whether surfaces attract each other before they have touched
    equilibrium_gap: gap without traction, um
    """

    always: bool = True
    equilibrium_gap: float = 0.0

    @property
    @abstractmethod
    def interaction_range(self) -> float:
        """Largest gap of any point with a traction, um."""

    @property
    @abstractmethod
    def steepness(self) -> Array:
        """Largest rate (m,) at which the traction falls with the gap, MPa/um."""

    @abstractmethod
    def __getitem__(self, rows: NDArray) -> AdhesionLaw:
        """The law of some points."""

    @abstractmethod
    def contribute(self, gap: Array, history: History, response: Response) -> None:
        """Change slope, curvature and energies of a response that holds the penalty's."""

    def bonded(self, history: History) -> Booleans:
        """Whether points (m,) are bonded: none of a law without history, whose attraction is reversible."""
        return np.zeros(len(history.touched), bool)

    def touching(self, gap: Array) -> Booleans:
        """Whether points touch at these gaps (m,), which the history then records: none without history."""
        return np.zeros(len(gap), bool)

    def on_loss_of_contact(self, history: History) -> History:
        """History of points whose closest point on the other surface no longer exists."""
        return history

    def electric_share(self, gap: Array, history: History) -> tuple[Array, Array, Array]:
        """Share (m,) of the electric contact that bonds maintain, with its first and second derivative by the gap."""
        return (np.zeros_like(gap),) * 3


def smooth_step(x: Array) -> tuple[Array, Array, Array]:
    """Cubic from 1 at x <= 0 to 0 at x >= 1, with first and second derivative (m,)."""
    y = np.clip(x, 0.0, 1.0)
    inside = (x > 0.0) & (x < 1.0)
    return 1.0 - y * y * (3.0 - 2.0 * y), -6.0 * y * (1.0 - y), np.where(inside, -6.0 + 12.0 * y, 0.0)
