"""Bodies that only contact can hold: which of them touch something, and which never did."""

from __future__ import annotations

import numpy as np

from piezomat.contact.interfaces import Interfaces
from piezomat.contact.rigid_plane import RigidPlane
from piezomat.discretization.model import Model


def touching_bodies(model: Model, contact: Interfaces) -> set[int]:
    """Numbers of the bodies in contact with others or with planes at the last evaluation. Collective."""
    found: set[int] = set()
    for p in contact.point_sets:
        closed = p.gap <= p.law.equilibrium_gap
        plane = isinstance(p, RigidPlane)
        if not plane:
            closed &= ~p.is_self_contact()  # what touches itself alone is alone
        facets = p.points.facet[p.near_points[p.projected[closed]]]
        found |= set(np.unique(p.slave.body[facets]).tolist())
        if plane:
            continue
        if contact.pairs.given is None:
            found |= set(p.rule.body(p.partner_component()[closed]).tolist())
        elif closed.any():
            found |= p.master_bodies
    return set().union(*model.comm.allgather(found))


def left_alone(model: Model, touched: set[int]) -> list[str]:
    """Names of the bodies that no boundary holds and that are not among those that touched something."""
    names = model.bodies.bodies
    floating = [part for part, free in enumerate(model.unconstrained[:, 0]) if free]
    members = [model.bodies.part_bodies[part] for part in floating]
    return [names[body] for bodies in members if not touched & set(bodies) for body in bodies]
