"""Snap-through of bonds: how a load level without an equilibrium near the last one is reached, and the work of it.

Bonds that break at once have no equilibrium on their way. They are taken there by viscous regularization: each part of
the step is one of dashpots that resist their opening, weaker from part to part, until the bonds are at rest without.
The energy that is set free on the way is the work of the forces out of balance.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.assembly.terms import Terms
from piezomat.contact.interfaces import Interfaces
from piezomat.discretization.evaluation_mode import EvaluationMode
from piezomat.forms.arrays import Array
from piezomat.meshes import parallel
from piezomat.solver.outcome import SolveError

MAX_PARTS = 1000  # in which bonds must come to rest; the most that any took is 107
VISCOSITY = 1.0  # to begin with, over the steepest fall of the bonds' traction
LEVELS, REDUCTION = 5, 0.25  # times that the viscosity is reduced before none is tried, and the factor each time
WAIT = 3  # parts at the same viscosity after a lower one has failed
ACCURACY, MAX_HALVINGS = 1e-3, 7  # of the work along a snap-through: relative, and divisions of its path
ROUNDING = 2.0 * np.finfo(float).eps  # share of the largest forces that is not a force
SNAPPED = 0.25  # share of a part's change of force times motion: energy set free beyond it means a snap-through


def snap_through(contact: Interfaces, part: Callable[[float], None]) -> None:
    """Reach a load level where bonds snap, against a viscosity that falls to zero. Collective.

    part(viscosity): solves a part of the step at that load level; SolveError if it fails. 0: without viscosity.
    SolveError if the bonds do not come to rest.
    """
    level, wait = 0, 0
    try:
        for _ in range(MAX_PARTS):
            is_last = level == LEVELS
            try:
                part(0.0 if is_last else VISCOSITY * REDUCTION**level)
            except SolveError as error:
                level, wait = level - 1, WAIT
                if level < -LEVELS:
                    raise SolveError(f"bonds snap, and do not come to rest: {error}") from error
                continue
            if is_last:
                return
            level, wait = level + (wait == 0), max(wait - 1, 0)
    finally:
        contact.end_viscous_regularization()
    raise SolveError(f"bonds snap, and do not come to rest in {MAX_PARTS} parts")


def snap_through_work(problem: Problem, terms: Terms) -> Array | None:
    """External work and energy set free, (2,) pJ, in a part with a snap-through; None without one. Collective.

    Along the straight line from the last converged state these are the work of reactions and loads, and minus that of
    the forces out of balance, viscosity left out; their difference is what is stored and dissipated. A step may snap
    without viscosity, where Newton's method finds the other side by itself: more energy is then set free than the
    external work is uncertain by. Work that is rounding is none: bodies that are apart, all of whose energies are
    rounding, were halved to the end in each step, which then took ten times as long as one in contact.
    """
    contact = terms.contact
    if contact is None or not contact.adhesive:
        return None
    end = problem.state.copy()
    unknowns = problem.model.unknowns
    displacements = unknowns.all_displacements
    change = displacements(end) - displacements(problem.converged_state)
    reduced, d = end.duplicate(), problem.model.dim
    fixed = problem.model.constraints.is_fixed[:, :d]
    without_viscosity = EvaluationMode(viscous=False)

    def power(share: float) -> Array:
        x = (1.0 - share) * problem.converged_state + share * end
        problem.residual(x, reduced, without_viscosity)
        held = unknowns.displacements(problem.residual_with_reactions) * change[: len(fixed)] * fixed
        applied = displacements(terms.loads.vector) * change
        outside, free = held.sum() - applied.sum(), -(displacements(reduced) * change).sum()
        return parallel.total(problem.comm, np.array([outside, free]))

    values = [power(0.0)]
    energy, forces = _energy(problem, problem.converged_state), unknowns.by_node(problem.residual_with_reactions).copy()
    values += [power(0.5), power(1.0)]
    forces = unknowns.by_node(problem.residual_with_reactions) - forces
    gained = _energy(problem, end) - energy - _electric_work(problem, end, forces)
    found = _simpson(values)
    largest = max(x.norm(PETSc.NormType.NORM_INFINITY) for x in (problem.converged_state, end))
    rounding = ROUNDING * problem.largest_force * largest
    uncertain = max(SNAPPED * abs(values[-1][0] - values[0][0]), rounding)
    snaps = contact.viscous_regularization or found[0] - gained > uncertain
    for _ in range(MAX_HALVINGS if snaps else 0):
        count = 2 * (len(values) - 1)
        between = [power((2 * k + 1) / count) for k in range(count // 2)]
        values = [*itertools.chain(*zip(values, between, strict=False)), values[-1]]
        before, found = found, _simpson(values)
        if np.abs(found - before).max() <= max(ACCURACY * np.abs(found).max(), rounding):
            break
    problem.residual(end, end.duplicate())
    return found if snaps else None


def _energy(problem: Problem, x: PETSc.Vec) -> float:
    """Energy stored and dissipated at the state of the last evaluation of contact, pJ."""
    return sum(problem.energies(x).values())


def _electric_work(problem: Problem, end: PETSc.Vec, change: Array) -> float:
    """Work of the charges that flow to prescribed potentials up to the state `end`, pJ.

    change (owned nodes, block): of the forces and charges.
    """
    if not problem.model.electric:
        return 0.0
    potentials = problem.model.unknowns.potentials
    twice = potentials(end) + potentials(problem.converged_state)
    return problem.comm.allreduce(float(-0.5 * twice @ change[:, -1]), op=MPI.SUM)


def _simpson(values: list[Array]) -> Array:
    """Integral from 0 to 1 of a function with these values at equal distances."""
    inner = 4.0 * sum(values[1:-1:2]) + 2.0 * sum(values[2:-1:2], np.zeros_like(values[0]))
    return (values[0] + inner + values[-1]) / (3.0 * (len(values) - 1))
