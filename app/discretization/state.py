"""The state of a problem: its unknowns, its load level and the histories of its terms, in one value.

A state is copied before a part of a step, restored where the part fails, kept at the end of a step, and saved in a
checkpoint. What does not follow from it is of the solver: the size of the next part, the stiffness of springs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from piezomat.forms.arrays import Array, Booleans, Integers

# Values (n, width) at numbered points (n, 4) of this rank, by name.
Points = dict[str, tuple[Integers, Array]]
# Values (n, width) of a name at numbered points (n, 4), and at which of them there are any (n,). Collective.
ReadPoints = Callable[[str, Integers, int], tuple[Array, Booleans]]


@dataclass(frozen=True)
class State:
    """An equilibrium. What it holds is not changed any more.

    unknowns (local,): of this rank
    factors: load factors
    histories: of the terms, in their order; each knows its own
    """

    unknowns: Array
    factors: Mapping[str, float]
    histories: tuple[Any, ...]


@dataclass(frozen=True)
class SavedHistory:
    """The history of a term as a checkpoint holds it, whatever ranks its points are on.

    points: see `Points`
    scalars: numbers by name, the same on all ranks
    """

    points: Points = field(default_factory=dict)
    scalars: dict[str, float] = field(default_factory=dict)
