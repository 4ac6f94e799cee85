"""Prescribed motion: how far boundaries and rigid planes are moved, from one load level to another and in a whole run.

The contact search looks as far as surfaces may move in a step, a body that has moved much further than what moves it
has flown, and the work on contact is shared out among ranks by what may come to touch at all.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from piezomat.discretization.model import Model

Factors = dict[str, float]


def prescribed_motion(model: Model, after: Factors, before: Factors | None = None) -> float:
    """Largest component of the motion of boundaries and planes between two load levels, um. Collective.

    before: the first of the two; None for the undeformed bodies, with every plane where it was before it was moved.
    """
    constraints = model.constraints
    change = constraints.values(after) - (0.0 if before is None else constraints.values(before))
    largest = float(np.abs(change[constraints.fixed_displacements()]).max(initial=0.0))
    for plane in model.scene.planes:
        share = plane.motion_share(after) - (0.0 if before is None else plane.motion_share(before))
        largest = max([largest, *(abs(share * component) for component in plane.motion or [])])
    return model.comm.allreduce(largest, op=MPI.MAX)


def largest_prescribed_motion(model: Model) -> float:
    """Largest component of the motion of boundaries and planes from the start to the end of a stage, um. Collective."""
    load = model.scene.load
    ends = [{name: values[stage] for name, values in load.factors.items()} for stage in range(len(load.steps))]
    return max((prescribed_motion(model, end) for end in ends), default=0.0)
