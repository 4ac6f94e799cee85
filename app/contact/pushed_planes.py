"""Planes by force: how far they are from the bodies, and how hard they press on them. Both are collective."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from piezomat.contact.interfaces import Interfaces
from piezomat.contact.rigid_plane import RigidPlane
from piezomat.discretization.evaluation_mode import EvaluationMode
from piezomat.forms.arrays import Array
from piezomat.meshes import parallel


def _pushed(contact: Interfaces) -> list[RigidPlane]:
    """The planes by force, in the order of the scene."""
    return [p for p in contact.planes if p.travel_node is not None]


def free_travels(contact: Interfaces) -> Array:
    """How far (k,) planes by force can move before they touch a body, at the state of the last detection, um."""
    pushed, position = _pushed(contact), contact.detected_positions
    gap = -parallel.largest(contact.comm, np.array([-p.least_gap(position) for p in pushed]))
    return np.maximum(gap, 0.0) / np.array([p.normal @ p.direction for p in pushed])


def push(contact: Interfaces, state: PETSc.Vec, mode: EvaluationMode) -> tuple[Array, Array]:
    """Forces (k,) of planes by force on the bodies at a state, along their travels, uN; derivatives by these."""
    at, pushed = contact.nodal_state(contact.nodes.gather(state), mode), _pushed(contact)
    values = np.zeros((2, len(pushed)))
    for column, p in enumerate(pushed):
        p.evaluate(at, tangent=False)
        weight = p.points.weight[p.projected_points]
        stiffness = (p.normal @ p.direction) ** 2 * float(weight @ p.response.hessian[:, 0, 0])
        values[:, column] = p.force @ p.direction, stiffness
    force, derivative = parallel.total(contact.comm, values)
    return force, derivative
