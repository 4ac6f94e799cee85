"""Capacitance: charges of the electrodes over their voltages, small changes about an equilibrium.

Bodies and contact respond as they would: what boundaries hold stays held, and the rest is in equilibrium. With K the
tangent, p the unit potential of an electrode at a potential, and f the unit charge of an open one, the response is
x = p + y, K x = -f where nothing is prescribed. All charges and voltages follow from

    J_ij = x_i . K x_j + f_i . x_j + f_j . x_i,

which is stationary at the responses: an error of 1e-3 in these is one of some 1e-6 in J (2e-6 in 3D, 18,000 unknowns).
J is the matrix of voltages over charges of the open electrodes, and minus that of charges over voltages of the others.
"""

from __future__ import annotations

import logging

import numpy as np
from petsc4py import PETSc

from piezomat.assembly.circuits import Circuits
from piezomat.assembly.problem import Problem
from piezomat.forms.arrays import Array
from piezomat.solver.linear import LinearSolver
from piezomat.solver.linear_solve import solve
from piezomat.solver.outcome import SolveError

log = logging.getLogger("piezomat")

TOLERANCE = 1e-3  # of a Krylov solver, which begins at the solution of the last step


class Capacitance:
    """Computes the capacitance matrix of a problem's electrodes. Every method is collective."""

    def __init__(self, problem: Problem, circuits: Circuits, linear: LinearSolver, snes: PETSc.SNES) -> None:
        self.problem = problem
        self._circuits = circuits
        self.linear = linear
        self.snes = snes
        model, constraints = problem.model, problem.model.constraints
        self._given = np.array([e.electrode.potential is not None for e in constraints.electrodes], bool)
        every = np.arange(len(self._given))
        # Where nothing else has a potential, charges depend on differences alone: the response of one source is spared.
        others = [c.boundary.potential for c in constraints.conditions] + [p.potential for p in model.scene.planes]
        spare = self._given.any() and all(potential is None for potential in others)
        self._solved = np.delete(every, self._given.argmax()) if spare else every
        self._responses: list[PETSc.Vec] = []

    def matrix(self) -> Array | None:
        """dQ_i/dV_j at the problem's state, pC/V (2D: per um of depth), symmetric; None without electrodes.

        Circuits take part in the equilibrium, but their capacitances are left out. Contact is then evaluated, with its
        tangent, at this state. Not numbers, and a warning in the log, where a linear solve fails.
        """
        if not len(self._given):
            return None
        try:
            return self._matrix()
        except SolveError as error:
            log.warning("the capacitance of this step is not known: %s", error)
            return np.full((len(self._given),) * 2, np.nan)

    def _matrix(self) -> Array:
        problem, given = self.problem, self._given
        self.linear.linearize(problem.state)
        if not self._responses:
            self._responses = [problem.model.new_vector() for _ in self._solved]
        changes = [self._change(*pair) for pair in zip(self._solved, self._responses, strict=True)]
        stationary, open_ = self._stationary_values(changes), ~given[self._solved]
        differences = np.eye(len(given))[self._solved]
        if len(self._solved) < len(given):
            differences[:, np.delete(np.arange(len(given)), self._solved)] = -1.0
        matrix = differences.T @ _of_charges(stationary, open_) @ differences
        return 0.5 * (matrix + matrix.T) - self._circuits.matrix

    def _change(self, electrode: int, response: PETSc.Vec) -> PETSc.Vec:
        """The change of the state x for a unit potential or a unit charge of an electrode; a new vector.

        response: y of the last step, and then of this.
        """
        problem, constraints = self.problem, self.problem.model.constraints
        scale, unit = problem.model.potential_scale, np.zeros(len(self._given))
        right, change = problem.model.new_vector(), problem.model.new_vector()
        unit[electrode] = 1.0
        if self._given[electrode]:
            constraints.potentials.set_values(change, unit / scale)
            constraints.expand(change)
            problem.multiply(change, right)
            constraints.reduce(right)
        else:
            constraints.potentials.set_values(right, unit * scale)
        right.scale(-1.0)
        is_krylov = self.linear.close_tolerance is not None
        what = problem, self.linear, self.snes, right, response, TOLERANCE if is_krylov else None
        try:
            solve(*what, guess=is_krylov)
        except SolveError:
            if not is_krylov:
                raise
            # Where bodies have come apart the last response is further from this one than nothing.
            response.set(0.0)
            solve(*what)
        right.destroy()
        change.axpy(1.0, response)
        return change

    def _stationary_values(self, changes: list[PETSc.Vec]) -> Array:
        """J (solved, solved) of the responses; ends the vectors."""
        problem, potentials = self.problem, self.problem.model.constraints.potentials
        product = problem.model.new_vector()
        values = np.zeros((len(changes),) * 2)
        loads = problem.model.potential_scale * ~self._given[self._solved]
        for j, change in enumerate(changes):
            problem.multiply(change, product)
            by_load = loads * potentials.values(change)[self._solved]
            values[:, j] += by_load
            values[j] += by_load
            values[:, j] += [other.dot(product) for other in changes]
        for vector in (product, *changes):
            vector.destroy()
        return values


def between(matrix: Array) -> float:
    """Capacitance between two electrodes, pC/V, given their matrix (2, 2): what else has a potential is in series."""
    direct = -matrix[0, 1]
    to_others = matrix.sum(axis=1)
    total = to_others.sum()
    return float(direct + (to_others[0] * to_others[1] / total if total > 0.0 else 0.0))


def _of_charges(stationary: Array, open_: Array) -> Array:
    """Charges over voltages from J, where these electrodes (n,) are open."""
    f, o = np.flatnonzero(~open_), np.flatnonzero(open_)
    elastance = np.linalg.inv(stationary[np.ix_(o, o)])
    mixed = stationary[np.ix_(f, o)]  # voltages of the open over those of the others, transposed
    matrix = np.zeros_like(stationary)
    matrix[np.ix_(o, o)] = elastance
    matrix[np.ix_(f, o)] = -mixed @ elastance
    matrix[np.ix_(o, f)] = -elastance @ mixed.T
    matrix[np.ix_(f, f)] = -stationary[np.ix_(f, f)] + mixed @ elastance @ mixed.T
    return matrix
