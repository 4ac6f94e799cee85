"""Capacitance: charges of the electrodes over their voltages, small changes about an equilibrium.

Bodies and contact respond as they would: what boundaries hold stays held, and the rest is in equilibrium. Each column
takes one solve with the tangent. An electrode at a potential gives its charge and answers in volts where another one is
open: the hybrid matrix of both kinds is turned into that of charges over voltages.
"""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.forms.arrays import Array
from piezomat.solver.linear import LinearSolver
from piezomat.solver.linear_solve import solve

TOLERANCE = 1e-8  # of a Krylov solver


def capacitance_matrix(problem: Problem, linear: LinearSolver, snes: PETSc.SNES) -> Array:
    """Matrix dQ_i/dV_j of the electrodes at the problem's state, pC/V (2D: per um of depth), symmetric. Collective.

    Circuits take part in the equilibrium, but their capacitances are left out. Contact is then evaluated, with its
    tangent, at this state. SolveError where a linear solve fails.
    """
    model, ties = problem.model, problem.model.constraints.ties
    if problem.contact is not None:
        problem.contact.set_tolerance_and_tangent(0, 0.0, unconstrained=problem.has_weakly_held_bodies)
    linear.linearize(problem.state)
    given = np.array([e.electrode.potential is not None for e in model.constraints.electrodes])
    count, scale = len(given), model.potential_scale
    hybrid = np.zeros((count, count))
    right, change, forces = (model.new_vector() for _ in range(3))
    for column in range(count):
        unit = np.zeros(count)
        unit[column] = 1.0
        right.set(0.0)
        change.set(0.0)
        if given[column]:
            ties.set_values(change, unit / scale)
            model.constraints.expand(change)
            problem.multiply(change, right)
            model.constraints.reduce(right)
        else:
            ties.set_values(right, unit * scale)
        right.scale(-1.0)
        solve(problem, linear, snes, right, forces, TOLERANCE if linear.close_tolerance is not None else None)
        change.axpy(1.0, forces)
        problem.multiply(change, forces)
        charges, voltages = -ties.sums(forces) / scale, scale * ties.values(change)
        hybrid[:, column] = np.where(given, charges, voltages)
    for vector in (right, change, forces):
        vector.destroy()
    matrix = _of_charges(hybrid, given) - problem.circuits.matrix
    return 0.5 * (matrix + matrix.T)


def between(matrix: Array) -> float:
    """Capacitance between two electrodes, pC/V, given their matrix (2, 2): what else has a potential is in series."""
    direct = -matrix[0, 1]
    to_others = matrix.sum(axis=1)
    total = to_others.sum()
    return float(direct + (to_others[0] * to_others[1] / total if total > 0.0 else 0.0))


def _of_charges(hybrid: Array, given: Array) -> Array:
    """Charges over voltages, from charges of the given and voltages of the open over voltages and charges."""
    f, o = np.flatnonzero(given), np.flatnonzero(~given)
    matrix = np.zeros_like(hybrid)
    a, b, c = hybrid[np.ix_(f, f)], hybrid[np.ix_(f, o)], hybrid[np.ix_(o, f)]
    inverse = np.linalg.inv(hybrid[np.ix_(o, o)])
    matrix[np.ix_(o, o)] = inverse
    matrix[np.ix_(o, f)] = -inverse @ c
    matrix[np.ix_(f, o)] = b @ inverse
    matrix[np.ix_(f, f)] = a - b @ inverse @ c
    return matrix
