"""Prescription: how far boundaries and rigid planes are moved, and how far apart their potentials are.

The contact search looks as far as surfaces may move in a step. A body that moves much further than what moves it has
lost its contact. Ranks share the work on the surfaces that may come to touch in a run.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI

from piezomat.discretization.constraints import Constraints
from piezomat.scene.sections import Load, Plane

Factors = dict[str, float]


class Prescription:
    """The motion and the voltage that boundaries and planes prescribe over the load stages of a scene."""

    def __init__(self, comm: MPI.Comm, constraints: Constraints, planes: Sequence[Plane], load: Load) -> None:
        self._comm = comm
        self._constraints = constraints
        self._planes = planes
        stages = range(len(load.steps))
        self._start: Factors = dict.fromkeys(load.factors, 0.0)
        self._ends: list[Factors] = [{name: values[k] for name, values in load.factors.items()} for k in stages]

    def motion(self, after: Factors, before: Factors | None = None) -> float:
        """Largest component of the motion of boundaries and planes between two load levels, um. Collective.

        before: the first of the two; None for the undeformed bodies, with every plane where it was before it was moved.
        """
        constraints = self._constraints
        change = constraints.values(after) - (0.0 if before is None else constraints.values(before))
        largest = float(np.abs(change[constraints.fixed_displacements()]).max(initial=0.0))
        for plane in self._planes:
            share = plane.motion_share(after) - (0.0 if before is None else plane.motion_share(before))
            largest = max([largest, *(abs(share * component) for component in plane.motion or [])])
        return self._comm.allreduce(largest, op=MPI.MAX)

    def largest_motion(self) -> float:
        """Largest component of the motion from the undeformed bodies to the end of a stage, um. Collective."""
        return max((self.motion(end) for end in self._ends), default=0.0)

    def largest_voltage(self) -> float:
        """Largest difference of the potentials that boundaries, planes and electrodes prescribe at once, V."""
        given = [(c.boundary.potential, c.boundary.follows) for c in self._constraints.conditions]
        given += [(p.potential, p.potential_follows) for p in self._planes]
        given += [(e.electrode.potential, e.electrode.follows) for e in self._constraints.electrodes]
        largest = 0.0
        for factors in (self._start, *self._ends):
            values = [v * (factors[name] if name is not None else 1.0) for v, name in given if v is not None]
            largest = max(largest, max(values, default=0.0) - min(values, default=0.0))
        return largest
