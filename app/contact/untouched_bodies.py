"""Bodies that only contact can hold: those that never touched anything, and the forces of contact on each body."""

from __future__ import annotations

import numpy as np

from piezomat.contact.interfaces import Interfaces
from piezomat.discretization.model import Model
from piezomat.forms.arrays import Array
from piezomat.meshes import parallel


def untouched_bodies(model: Model, touched: set[int]) -> list[str]:
    """Names of the bodies that no boundary constrains and whose connected part is not among those `touched`."""
    names = model.bodies.bodies
    return [names[body] for bodies in unconstrained_parts(model) if not touched & set(bodies) for body in bodies]


def unconstrained_parts(model: Model) -> list[list[int]]:
    """The bodies of each connected part that no boundary constrains."""
    return [list(model.bodies.part_bodies[part]) for part, free in enumerate(model.unconstrained[:, 0]) if free]


def contact_forces(model: Model, contact: Interfaces) -> tuple[Array, Array]:
    """Sum of the contact forces on each body (bodies, d), and of their magnitudes (bodies,), uN. Collective.

    At the last evaluation. Between surfaces that a scene's pair names, where these are of several bodies, the forces on
    the master's are left out.
    """
    bodies = len(model.bodies.bodies)
    sums = np.zeros((bodies, model.dim + 1))
    surface_pairs = {id(p) for p in contact.surface_pairs}
    for p in contact.point_sets:
        slave = p.slave.body[p.points.facet[p.projected_points]]
        if id(p) not in surface_pairs:
            pull = p.points.weight[p.projected_points] * p.response.traction
            np.add.at(sums, slave, np.column_stack([pull[:, None] * p.normal, np.abs(pull)]))
            continue
        force = np.column_stack([-p.force, np.linalg.norm(p.force, axis=1)])
        np.add.at(sums, slave, force)
        if contact.pairs.named is None:
            first, second = np.divmod(p.pair_numbers(contact.pairs)[0], bodies)
            master = first + second - slave
        elif len(p.master_bodies) == 1:
            master = np.full(len(slave), next(iter(p.master_bodies)))
        else:
            continue
        np.add.at(sums, master, force * [*[-1.0] * model.dim, 1.0])
    sums = parallel.total(model.comm, sums.ravel()).reshape(sums.shape)
    return sums[:, :-1], sums[:, -1]
