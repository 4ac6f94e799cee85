"""Planes by force that touch nothing: where they meet the bodies, as these are, with the force on them.

A plane is moved up to the bodies when a step begins. There contact has no stiffness, and the
force on the plane would throw it through the bodies. So Newton's method starts where the contact with the bodies at
rest bears the force: one equation for each plane, whose contact stiffens the deeper it presses. What is left out of
balance is the force on the bodies.
"""

from __future__ import annotations

import numpy as np

from piezomat.assembly.problem import Problem
from piezomat.contact.interfaces import Interfaces
from piezomat.contact.pushed_planes import free_travels, push
from piezomat.discretization.evaluation_mode import EvaluationMode

MAX_ITERATIONS = 60  # halvings of a start that is too deep by far
TOLERANCE = 1e-3  # of the force
FIRST = 1e-3  # of a facet: first depth


def approach(problem: Problem, contact: Interfaces | None) -> bool:
    """Move planes by force that touch nothing up to the bodies, at the state of the last detection; whether any has.

    That takes no force. Collective.
    """
    travels = problem.model.constraints.travels
    if contact is None or not len(travels):
        return False
    free = free_travels(contact) * (problem.model.loads.forces[-len(travels) :] > 0.0)
    if free.any():
        travels.add_values(problem.state, free)
    return bool(free.any())


def settle(problem: Problem, contact: Interfaces | None, mode: EvaluationMode) -> None:
    """Press planes by force that touch nothing, at the problem's state, into bodies at rest. Collective."""
    travels = problem.model.constraints.travels
    if contact is None or not len(travels):
        return
    wanted = problem.model.loads.forces[-len(travels) :]
    force, _ = push(contact, problem.state, mode)
    apart = (wanted > 0.0) & (force <= 0.0)  # a medium in the gap may pull
    if not apart.any():
        return
    depth = np.where(apart, FIRST * contact.mean_facet_size, 0.0)
    travels.add_values(problem.state, depth)
    for _ in range(MAX_ITERATIONS):
        force, stiffness = push(contact, problem.state, mode)
        missing = np.where(apart, wanted - force, 0.0)
        if (np.abs(missing) <= TOLERANCE * wanted).all():
            return
        # The force is a convex function of the depth: Newton's method goes too deep once, and then back. Where a plane
        # presses on no point as yet, its depth is doubled.
        change = np.where(stiffness > 0.0, missing / np.where(stiffness > 0.0, stiffness, 1.0), depth * (missing > 0.0))
        travels.add_values(problem.state, change)
        depth = depth + change
