"""Foresight: what contact answers to a step before it is made, so that one step settles which points it closes.

Contact laws bend sharply, gaps do not: a Newton step that lets the law go on along its tangent closes points that it
should have opened, and the next one puts that right for a few of them. Here the gaps and jumps alone go along their
tangent. The law answers at those that a step foresees, and the step is found anew from that answer until both agree:
Newton's method within a step, on the nodes that may touch (a semismooth one; with a penalty that of the primal-dual
active set, Hintermueller, Ito and Kunisch, SIAM J. Optim. 13 (2003) 865-888).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from petsc4py import PETSc

from piezomat.contact.nodal_state import NodalState
from piezomat.forms.arrays import Array
from piezomat.forms.contact.augmentation import augmented_response
from piezomat.forms.contact.laws.response import Response
from piezomat.meshes import parallel

if TYPE_CHECKING:
    from piezomat.contact.interfaces import Interfaces
    from piezomat.contact.rigid_plane import RigidPlane
    from piezomat.contact.surface_pair import SurfacePair


def response(p: SurfacePair | RigidPlane, at: NodalState, shift: tuple[Array, Array]) -> Response:
    """The law's response at the present gaps and jumps of the points, or at the predicted ones, multipliers added."""
    rows, gap, jump = p.projected_points, p.projection.gap, p.jump
    if p.predicted is not None:
        gap, jump = gap + p.predicted[0], None if jump is None else jump + p.predicted[1]
    return augmented_response(
        p.law[rows], gap, jump, p.history[rows], shift, attraction=at.attraction, consistent=at.consistent_tangent
    )


def linearized_response(p: SurfacePair | RigidPlane) -> tuple[Array, Array]:
    """Slope and charge of a pass's points from which a linear law leads to its last response, now or as foreseen."""
    return (p.response.slope, p.response.charge) if p.predicted is None else p.response.linearized(-p.predicted)


def predict(contact: Interfaces, change: PETSc.Vec) -> Array:
    """Let contact answer from now on as after this change of the state of its last evaluation. Collective.

    Norms (2,) of forces and charges that the last answer did not lead to expect; not numbers where facets have
    collapsed, infinite where a change is wild.
    """
    nodal, sums = contact.gather(change), np.zeros(2)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            for p in contact.point_sets:
                sums += _predict(p, contact.at, nodal)
    except np.linalg.LinAlgError:
        sums[:] = np.nan
    return np.sqrt(parallel.total(contact.comm, sums))


def end_prediction(contact: Interfaces) -> None:
    """Let contact answer at the states that are evaluated again."""
    for p in contact.point_sets:
        p.predicted = None


def _predict(p: SurfacePair | RigidPlane, at: NodalState, change: Array) -> Array:
    last, before = p.response, p.predicted
    p.predicted = p.first_changes(at, change)
    slope, charge = last.linearized(p.predicted if before is None else p.predicted - before)
    rows = p.projected_points
    r = response(p, at, p.multipliers.at(p.slave.kind, p.points.facet[rows], p.points.xi[rows]))
    weight = p.share * p.points.weight[rows]
    scale = 1.0 if at.scale is None else at.scale
    return np.array([((weight * (r.slope - slope)) ** 2).sum(), ((scale * weight * (r.charge - charge)) ** 2).sum()])
