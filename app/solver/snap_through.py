"""Snaps: what is done from outside and what is set free in a part of a step that has no equilibrium on its way."""

from __future__ import annotations

import itertools

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.forms.arrays import Array
from piezomat.meshes import parallel

ACCURACY, HALVINGS = 1e-3, 7  # of the work on the way of a snap, and how often that is divided at most
SNAPPED = 0.25  # share of a part's change of force times motion: what is set free beyond it, a snap sets free


def snap_through_work(problem: Problem) -> Array | None:
    """Work from outside and what is set free, (2,) pJ, in a part of a step that snaps; None if none does. Collective.

    Along the straight line from `start` to the state these are the work of reactions and loads, and minus that of the
    forces out of balance, a drag on them left out; the first less the second is what is stored and dissipated. A step
    may snap without a drag, where Newton's method finds the other side by itself: more is then set free than the work
    from outside is uncertain by.
    """
    contact = problem.contact
    if contact is None or not contact.adhesive:
        return None
    end = problem.state.copy()
    change = problem.model.unknowns.displacements(end - problem.converged_state)
    fixed = np.zeros(len(problem.residual_with_reactions.array_r), bool)
    fixed[problem.model.constraints.fixed] = True
    fixed = fixed.reshape(-1, problem.model.unknowns.block)[:, : problem.model.dim]
    dragged, contact.viscous_regularization = contact.viscous_regularization, False

    def power(share: float) -> Array:
        x = (1.0 - share) * problem.converged_state + share * end
        problem.residual(x, x.duplicate())
        work = problem.model.unknowns.displacements(problem.residual_with_reactions) * change
        applied = problem.model.unknowns.displacements(problem.loads.vector) * change
        outside, free = (work * fixed).sum() - applied.sum(), -(work * ~fixed).sum()
        return parallel.total(problem.comm, np.array([outside, free]))

    values = [power(0.0)]
    energy, forces = _energy(problem, problem.converged_state), problem.residual_with_reactions.array_r.copy()
    values += [power(0.5), power(1.0)]
    gained = (
        _energy(problem, end) - energy - _electric_work(problem, end, problem.residual_with_reactions.array_r - forces)
    )
    found = _simpson(values)
    uncertain = SNAPPED * abs(values[-1][0] - values[0][0])
    snaps = dragged or found[0] - gained > uncertain
    for _ in range(HALVINGS if snaps else 0):
        count = 2 * (len(values) - 1)
        between = [power((2 * k + 1) / count) for k in range(count // 2)]
        values = [*itertools.chain(*zip(values, between, strict=False)), values[-1]]
        before, found = found, _simpson(values)
        if np.abs(found - before).max() <= ACCURACY * np.abs(found).max():
            break
    contact.viscous_regularization = dragged
    problem.residual(end, end.duplicate())
    return found if snaps else None


def _energy(problem: Problem, x: PETSc.Vec) -> float:
    """Energy stored and dissipated at a state where contact was evaluated last, pJ."""
    return sum(problem.bulk.energies(x).values()) + sum(problem.contact.energies().values())


def _electric_work(problem: Problem, end: PETSc.Vec, change: Array) -> float:
    """Work of the charges that flow to prescribed potentials while the forces change, from `start` to `end`, pJ."""
    model = problem.model
    if not model.electric:
        return 0.0
    twice, charge = (
        v.reshape(-1, model.unknowns.block)[:, -1] for v in (end.array_r + problem.converged_state.array_r, change)
    )
    return problem.comm.allreduce(float(-0.5 * twice @ charge), op=MPI.SUM)


def _simpson(values: list[Array]) -> Array:
    """Integral from 0 to 1 of what has these values at equal distances."""
    inner = 4.0 * sum(values[1:-1:2]) + 2.0 * sum(values[2:-1:2], np.zeros_like(values[0]))
    return (values[0] + inner + values[-1]) / (3.0 * (len(values) - 1))
