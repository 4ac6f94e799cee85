"""Bodies that only contact can hold and that never touched anything."""

from __future__ import annotations

from piezomat.discretization.model import Model


def untouched_bodies(model: Model, touched: set[int]) -> list[str]:
    """Names of the bodies that no boundary constrains and whose connected part is not among those `touched`."""
    names = model.bodies.bodies
    unconstrained = [part for part, free in enumerate(model.unconstrained[:, 0]) if free]
    members = [model.bodies.part_bodies[part] for part in unconstrained]
    return [names[body] for bodies in members if not touched & set(bodies) for body in bodies]
