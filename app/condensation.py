"""Tangents with a constant bulk: all but the nodes that may come into contact is eliminated once.

With K the constant part of the tangent and C the contact's part, which lives on the candidate nodes c alone,

    (K + C) x = r   is   (S + C) x_c = r_c - K_ci K_ii^-1 r_i,   S = K_cc - K_ci K_ii^-1 K_ic,

and then x_i follows from x_c. Bodies do not share nodes: each is factorized by itself, on one rank.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from app import reductions
from app.problem import Problem
from app.schur import SchurFactor

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

INTERIOR = 1e-10  # a residual inside, this small against all of it, is rounding


class Condensation:
    """Solves with the tangent of a `Problem` whose bulk is constant and symmetric. Every method is collective."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.comm: MPI.Comm = problem.comm
        self.block = problem.model.block
        self.candidates = np.zeros(0, np.int64)
        # Surfaces of equal bodies that come nearer by d touch where they were less than d/2 apart (Hertz).
        self._ahead = problem.contact.ahead = 0.5 * (problem.model.largest_motion() or problem.contact.least_margin())
        self._of = -1
        self._factor: SchurFactor | None = None
        self._parts()
        self._here = PETSc.IS().createGeneral(_unknowns(self._nodes, self.block), comm=MPI.COMM_SELF)
        self._local = PETSc.Vec().createSeq(self._here.getSize(), comm=MPI.COMM_SELF)
        self._exchange = PETSc.Scatter().create(problem.state, self._here, self._local, None)

    def update(self, limit: float) -> bool:
        """Take over the problem's last linearization; False if it has more than `limit` candidate unknowns."""
        nodes, matrices = self.problem.contact_terms()
        outgrown = self.comm.allreduce(not np.isin(nodes, self.candidates).all(), op=MPI.LOR)
        if outgrown or self._of != self.problem.renewals:
            wanted = np.union1d(nodes, self.problem.contact.reserve(self._ahead))
            candidates = np.unique(np.concatenate([self.candidates, *self.comm.allgather(wanted)]))
            if len(candidates) * self.block > limit:
                return False
            self._condense(candidates)
            self._ahead *= 2.0
        self._add(nodes, matrices)
        return True

    def _condense(self, candidates: Integers) -> None:
        """Factorize the bulk and condense it to these global nodes, sorted and the same on all ranks."""
        self._of = self.problem.renewals
        if self._factor is not None:
            self._factor.destroy()
        problem, b = self.problem, self.block
        self.candidates = candidates
        bulk = problem.without_contact()
        bulk.zeroRowsColumns(problem.model.fixed_global, diag=1.0)
        (matrix,) = bulk.createSubMatrices([self._here], [self._here])
        self._places, self._factor, reduced = np.zeros(0, np.int64), None, np.zeros((0, 0))
        if len(self._nodes):
            self._places = _unknowns(np.flatnonzero(np.isin(self._nodes, candidates)), b).astype(np.int64)
            # Parts that only contact holds leave K singular: springs of the bulk's own stiffness are added at the
            # candidates, and taken away from S. The potential's block is negative.
            diagonal = matrix.getDiagonal()
            shift = diagonal.array_r[self._places].copy()
            diagonal.array[self._places] += shift
            matrix.setDiagonal(diagonal)
            self._factor = SchurFactor(matrix, self._places.astype(np.int32))
            reduced = self._factor.complement - np.diag(shift)
        unknowns = _unknowns(candidates, b)
        self._own = np.searchsorted(unknowns, _unknowns(self._nodes, b)[self._places])
        self._free = ~np.isin(unknowns, np.concatenate(self.comm.allgather(problem.model.fixed_global)))
        gathered = self.comm.gather((self._own, reduced))
        self._reduced: Array | None = None
        if gathered is not None:
            self._reduced = np.zeros((len(unknowns), len(unknowns)))
            for at, part in gathered:
                self._reduced[np.ix_(at, at)] = part

    def _add(self, nodes: Integers, matrices: Array) -> None:
        """Factorize the condensed bulk with the contact's matrices of these nodes added."""
        b, n = self.block, len(self.candidates) * self.block
        rows = (np.searchsorted(self.candidates, nodes)[:, :, None] * b + np.arange(b)).reshape(
            len(nodes), nodes.shape[1] * b
        )
        places = (rows[:, :, None] * n + rows[:, None, :]).ravel()
        places, first = np.unique(places, return_inverse=True)
        values = np.bincount(first, matrices.ravel(), minlength=len(places))
        gathered = self.comm.gather((places, values))
        self._lu = None
        if gathered is None or n == 0:
            return
        tangent = self._reduced.copy()
        for where, what in gathered:
            free = self._free[where // n] & self._free[where % n]
            tangent.reshape(-1)[where[free]] += what[free]
        self._lu = scipy.linalg.lu_factor(tangent, overwrite_a=True, check_finite=False)

    def solve(self, right: PETSc.Vec, result: PETSc.Vec) -> None:
        """result = (K + C)^-1 right; not numbers where the tangent is singular."""
        self._exchange.scatter(right, self._local, PETSc.InsertMode.INSERT_VALUES, PETSc.ScatterMode.FORWARD)
        r = self._local.array.copy()
        outer = r[self._places]
        condensed = outer
        inner = r.copy()
        inner[self._places] = 0.0
        here = np.array([np.abs(inner).max(initial=0.0), np.abs(r).max(initial=0.0)])
        norms = reductions.largest(self.comm, here)
        if norms[0] > INTERIOR * norms[1] and self._factor is not None:
            condensed = self._factor.complement @ self._factor.solve(r)[self._places]
        gathered = self.comm.gather((self._own, condensed))
        whole = None
        if gathered is not None:
            whole = np.zeros(len(self._reduced))
            for at, part in gathered:
                whole[at] = part
            if self._lu is not None:
                whole = scipy.linalg.lu_solve(self._lu, whole, check_finite=False)
        change = self.comm.bcast(whole)[self._own]
        if self._factor is not None:
            r[self._places] = self._factor.complement @ change + outer - condensed
            self._local.array[:] = self._factor.solve(r)
        result.set(0.0)
        self._exchange.scatter(self._local, result, PETSc.InsertMode.INSERT_VALUES, PETSc.ScatterMode.REVERSE)

    def _parts(self) -> None:
        """Give whole parts to ranks, the largest first to the one with the least; their nodes, sorted."""
        model = self.problem.model
        start = model.space.dofmap.index_map.local_range[0]
        owned = model.node_part[: model.owned]
        count = self.comm.allreduce(np.bincount(owned, minlength=len(model.part_size)), op=MPI.SUM)
        load = np.zeros(self.comm.size)
        rank_of = np.zeros(len(count), int)
        for part in np.argsort(-count, kind="stable"):
            rank_of[part] = load.argmin()
            load[rank_of[part]] += count[part]
        parcels = [start + np.flatnonzero(rank_of[owned] == rank) for rank in range(self.comm.size)]
        self._nodes: Integers = np.sort(np.concatenate(self.comm.alltoall(parcels)))


def _unknowns(nodes: Integers, block: int) -> NDArray[np.int32]:
    return (nodes[:, None] * block + np.arange(block)).ravel().astype(PETSc.IntType)
