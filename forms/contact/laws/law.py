"""What a law of contact is: one summand of the enthalpy per area of contact points. Laws add up to a law.

The kinematics of a point are q = (gap, potential jump), and later what else there is, such as slips. A law gives the
enthalpy as a function of q, with its gradient and its Hessian. What it remembers of earlier steps is its history: an
array with a row for each point, zero at first, whose columns the law alone understands.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import reduce
from operator import add
from typing import Self

import numpy as np
from numpy.typing import NDArray

from piezomat.forms.arrays import Array, Booleans
from piezomat.forms.contact.laws.response import Response


@dataclass(frozen=True)
class LawMode:
    """What of a law is taken into account: at an equilibrium all of it.

    attraction: whether charges pull on the surfaces; without it their capacitance is a given function of the state
    consistent: whether the Hessian has the negative stiffness of the attraction
    """

    attraction: bool = True
    consistent: bool = True


COMPLETE_LAW = LawMode()


class ContactLaw(ABC):
    """Law of m contact points; a dataclass, whose arrays have a row for each point.

    A subclass has `respond` at least: it is then a law without history, that acts in compression alone.

    history_size: number of columns of the history
    softens: whether the traction may fall with the gap, as that of adhesion does
    has_charges: whether it depends on the potential jump
    interaction_range: largest gap of any point with a traction or a charge, um
    equilibrium_gap: gap without traction, um: at and below it surfaces are in contact
    penalties: stiffness (m,) of the penalties for gap, MPa/um, and jump, pC/(V um2), that augmentation makes exact
    """

    history_size: int = 0
    softens: bool = False
    has_charges: bool = False
    interaction_range: float = 0.0
    equilibrium_gap: float = 0.0
    penalties: tuple[Array | float, Array | float] = (0.0, 0.0)

    @abstractmethod
    def respond(self, q: Array, history: Array, mode: LawMode = COMPLETE_LAW) -> Response:
        """Enthalpy with gradient and Hessian at kinematics q (m, k), with the history (m, history_size).

        k is 2 where there are potentials and 1 without.
        """

    def committed(self, q: Array, history: Array) -> Array:
        """History after a step that has converged at q (m, k)."""
        return history

    def on_loss_of_contact(self, history: Array) -> Array:
        """History of points whose closest point on the other surface no longer exists."""
        return history

    def bonded(self, history: Array) -> Booleans:
        """Whether points (m,) are bonded: none of a law without history, whose attraction is reversible."""
        return np.zeros(len(history), bool)

    def broken(self, history: Array) -> Booleans:
        """Whether points (m,) had a bond that has broken."""
        return np.zeros(len(history), bool)

    def softening(self, history: Array) -> Array:
        """Largest rate (m,) at which the traction of points may still fall with the gap, MPa/um."""
        return np.zeros(len(history))

    def status(self, gap: Array, history: Array) -> NDArray[np.int8]:
        """State (m,) of points: 0 apart, 1 touching, 2 bonded in tension, 3 broken."""
        apart = np.where(self.bonded(history), 2, np.where(self.broken(history), 3, 0))
        return np.where(gap <= self.equilibrium_gap, 1, apart).astype(np.int8)

    def virgin(self, points: int) -> Array:
        """History (points, history_size) at the beginning."""
        return np.zeros((points, self.history_size))

    def summands(self) -> Iterator[ContactLaw]:
        """The laws that this one is the sum of."""
        yield self

    def __add__(self, other: ContactLaw) -> Sum:
        return Sum((*_parts(self), *_parts(other)))

    def __getitem__(self, rows: NDArray) -> Self:
        """The law of some points."""
        values = ((f.name, getattr(self, f.name)) for f in fields(self))
        return replace(self, **{name: value[rows] for name, value in values if isinstance(value, np.ndarray)})


def _parts(law: ContactLaw) -> tuple[ContactLaw, ...]:
    return law.parts if type(law) is Sum else (law,)


@dataclass(frozen=True)
class Sum(ContactLaw):
    """Sum of laws; its history has the columns of each, one after the other."""

    parts: tuple[ContactLaw, ...]

    def __getitem__(self, rows: NDArray) -> Self:
        return replace(self, parts=tuple(part[rows] for part in self.parts))

    history_size = property(lambda self: sum(part.history_size for part in self.parts))
    softens = property(lambda self: any(part.softens for part in self.parts))
    has_charges = property(lambda self: any(part.has_charges for part in self.parts))
    interaction_range = property(lambda self: max(part.interaction_range for part in self.parts))
    equilibrium_gap = property(lambda self: max(part.equilibrium_gap for part in self.parts))
    penalties = property(lambda self: tuple(map(sum, zip(*(part.penalties for part in self.parts), strict=True))))

    def respond(self, q: Array, history: Array, mode: LawMode = COMPLETE_LAW) -> Response:
        """See `ContactLaw.respond`."""
        return reduce(add, (part.respond(q, own, mode) for part, own in self._each(history)))

    def committed(self, q: Array, history: Array) -> Array:
        """See `ContactLaw.committed`."""
        return np.concatenate([part.committed(q, own) for part, own in self._each(history)], axis=1)

    def on_loss_of_contact(self, history: Array) -> Array:
        """See `ContactLaw.on_loss_of_contact`."""
        return np.concatenate([part.on_loss_of_contact(own) for part, own in self._each(history)], axis=1)

    def bonded(self, history: Array) -> Booleans:
        """See `ContactLaw.bonded`."""
        return np.any([part.bonded(own) for part, own in self._each(history)], axis=0)

    def broken(self, history: Array) -> Booleans:
        """See `ContactLaw.broken`."""
        return np.any([part.broken(own) for part, own in self._each(history)], axis=0)

    def softening(self, history: Array) -> Array:
        """See `ContactLaw.softening`."""
        return np.sum([part.softening(own) for part, own in self._each(history)], axis=0)

    def summands(self) -> Iterator[ContactLaw]:
        """See `ContactLaw.summands`."""
        for part in self.parts:
            yield from part.summands()

    def _each(self, history: Array) -> Iterator[tuple[ContactLaw, Array]]:
        """Each part, with its own columns of the history."""
        first = 0
        for part in self.parts:
            yield part, history[:, first : first + part.history_size]
            first += part.history_size
