"""Prescribed motion and voltage: how far boundaries and rigid planes are moved, and how far apart potentials are.

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


def largest_prescribed_voltage(model: Model) -> float:
    """Largest difference of the potentials that boundaries and planes prescribe at once, V. Not collective."""
    scene, largest = model.scene, 0.0
    for stage in range(-1, len(scene.load.steps)):
        factors = {name: values[stage] if stage >= 0 else 0.0 for name, values in scene.load.factors.items()}
        given = [(b.potential, b.follows) for b in scene.boundaries]
        given += [(p.potential, p.potential_follows) for p in scene.planes]
        values = [v * (factors[name] if name is not None else 1.0) for v, name in given if v is not None]
        largest = max(largest, max(values, default=0.0) - min(values, default=0.0))
    return largest
