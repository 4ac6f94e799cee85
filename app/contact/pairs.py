"""Numbers and names of contact pairs, in memory and in the results."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.forms.arrays import Integers


@dataclass(frozen=True)
class Pairs:
    """The contact pairs of a run: those that the scene names, or any two bodies.

    A pair's number is its place among the named ones; pairs of bodies i <= j have the number i * bodies + j.
    Results number the listed pairs 0, 1, ... instead, if there are any. The planes come next.

    bodies: names of all bodies, empty without pairs of bodies
    named: names of the scene's pairs; None for pairs of bodies
    listed: names, by number and in order, of the pairs that have columns in the history
    planes: names of the rigid planes
    """

    bodies: tuple[str, ...]
    named: tuple[str, ...] | None
    listed: dict[int, str]
    planes: tuple[str, ...] = ()

    def name(self, number: int) -> str:
        """Name of the pair with a number."""
        if self.named is not None:
            return self.named[number]
        return "-".join(self.bodies[i] for i in divmod(number, len(self.bodies)))

    def described(self) -> str:
        """The pairs in words."""
        planes = f" and {len(self.planes)} planes" if self.planes else ""
        if self.listed or len(self.bodies) < 2:
            return f"{len(self.listed)} contact pairs{planes}"
        return f"contact between any of {len(self.bodies)} bodies{planes}"

    def of_bodies(self, first: Integers, second: Integers) -> Integers:
        """Numbers of pairs of bodies (m,)."""
        return np.minimum(first, second) * len(self.bodies) + np.maximum(first, second)

    @property
    def first_plane(self) -> int:
        """Number that the first plane has in the results."""
        return len(self.listed) or len(self.bodies) ** 2

    def in_results(self, number: Integers) -> Integers:
        """The numbers (m,) that pairs with these numbers have in the results."""
        return np.searchsorted(list(self.listed), number) if self.listed else number

    def result_name(self, number: int) -> str:
        """Name of the pair or plane with a number of the results; "pair 7" where there is no name for number 6."""
        if number < len(self.listed):
            return list(self.listed.values())[number]
        if number < self.first_plane:
            return self.name(number)
        plane = number - self.first_plane
        return self.planes[plane] if plane < len(self.planes) else f"pair {number + 1}"
