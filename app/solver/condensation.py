"""Tangents with a constant bulk: all but the nodes that may come into contact is eliminated once.

With K the constant part of the tangent and C the contact's part, which lives on the candidate nodes c alone,

    (K + C) x = r   is   (S + C) x_c = r_c - K_ci K_ii^-1 r_i,   S = K_cc - K_ci K_ii^-1 K_ic,

and then x_i follows from x_c. Bodies do not share nodes: each is factorized by itself, on one rank.

Where the inside is in equilibrium, Newton's method needs x_c alone: the residual at the candidates changes by S times
their change, and the inside follows once, when the iterations have ended.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.forms.arrays import Array, Integers
from piezomat.meshes import parallel
from piezomat.meshes.ghost_scatter import GhostScatter
from piezomat.solver.mumps_schur import SchurFactors
from piezomat.usage import give_back_memory

# How far apart surfaces are that may come to touch, over the largest motion that is prescribed: half of it for equal
# bodies (Hertz), and more where they give.
AHEAD = 0.75
SAME = 1e-9  # of all forces: those inside that differ by less from earlier ones, or a multiple, ask nothing new
INTERIOR = 1e-10  # a residual inside, this small against all of it, is rounding


class Condensation:
    """Solves with the tangent of a `Problem` whose bulk is constant and symmetric. Every method is collective."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.comm: MPI.Comm = problem.comm
        self.block = problem.model.unknowns.block
        self.candidates = np.zeros(0, np.int64)
        motion = problem.model.prescription.largest_motion() or problem.contact.least_search_radius()
        self._ahead = AHEAD * motion
        problem.contact.set_candidate_distance(self._ahead)
        self.outgrown = False  # whether contact has spread beyond the candidates since the inside is held
        self._of = -1
        self._factors = SchurFactors()
        self._parts = self._divide()
        self._nodes = np.concatenate([np.zeros(0, np.int64), *self._parts])
        unknowns = _unknowns(self._nodes, self.block)
        self._fixed = np.isin(unknowns, np.concatenate(self.comm.allgather(problem.model.constraints.fixed_global)))
        self._exchange = GhostScatter(problem.state, PETSc.IS().createGeneral(unknowns, comm=MPI.COMM_SELF))

    def update(self, limit: float) -> bool:
        """Take over the problem's last linearization; False if it has more than `limit` candidate unknowns.

        While the inside is held, contact beyond the candidates is left out, and `outgrown` says so.
        """
        nodes, matrices = self.problem.contact_terms()
        inside = np.isin(nodes, self.candidates).all(axis=1)
        outgrown = self.comm.allreduce(not inside.all(), op=MPI.LOR)
        if self.holds:
            self.outgrown = self.outgrown or outgrown
            nodes, matrices = nodes[inside], matrices[inside]
        elif outgrown or self._of != self.problem.stiffness_version:
            wanted = np.union1d(nodes, self.problem.contact.candidate_nodes(self._ahead))
            candidates = np.unique(np.concatenate([self.candidates, *self.comm.allgather(wanted)]))
            if len(candidates) * self.block > limit:
                return False
            self._condense(candidates)
            self._ahead *= 2.0
        self._add(nodes, matrices)
        return True

    def _condense(self, candidates: Integers) -> None:
        """Factorize the bulk and condense it to these global nodes, sorted and the same on all ranks."""
        self._of = self.problem.stiffness_version
        self._factors.destroy()
        problem, b = self.problem, self.block
        self.candidates = candidates
        sets = [PETSc.IS().createGeneral(_unknowns(part, b), comm=MPI.COMM_SELF) for part in self._parts]
        bulk = problem.bulk_stiffness()
        matrices = bulk.createSubMatrices(sets, sets)
        bulk.destroy()
        give_back_memory()
        shifts, places, first = [np.zeros(0)], [np.zeros(0, np.int64)], 0
        self._factors = SchurFactors()
        for part, matrix in zip(self._parts, matrices, strict=True):
            outer = _unknowns(np.flatnonzero(np.isin(part, candidates)), b)
            # Parts that only contact holds leave K singular: springs of the bulk's own stiffness are added at the
            # candidates, and taken away from S. The potential's block is negative.
            diagonal = matrix.getDiagonal()
            places.append(first + outer.astype(np.int64))
            first += len(part) * b
            shifts.append(diagonal.array_r[outer].copy())
            diagonal.array[outer] += shifts[-1]
            matrix.setDiagonal(diagonal)
            self._factors.add(matrix, outer)
        give_back_memory()
        self._shift, self._places = np.concatenate(shifts), np.concatenate(places)
        reduced = self._factors.complement() - np.diag(self._shift)
        unknowns = _unknowns(candidates, b)
        self._own = np.searchsorted(unknowns, _unknowns(self._nodes, b)[self._places])
        gathered = self.comm.gather((self._own, reduced, ~self._fixed[self._places]))
        self._asked = np.zeros(first), np.zeros(len(self._places))  # forces inside, and what they did
        self._reduced: Array | None = None
        if gathered is not None:
            self._reduced = np.zeros((len(unknowns), len(unknowns)))
            self._free = np.zeros(len(unknowns), bool)
            for at, part, free in gathered:
                self._reduced[np.ix_(at, at)] = part
                self._free[at] = free

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
        # Symmetric as it is, its transpose lies in memory as LAPACK wants it.
        self._lu = scipy.linalg.lu_factor(tangent.T, overwrite_a=True, check_finite=False)

    def hold(self, x: PETSc.Vec) -> None:
        """If the inside is in equilibrium at x, leave it there: from here on states are told by the candidates."""
        if self.holds:
            return
        residual = self.problem.bulk_residual(x)
        r = self._exchange.gather(residual)
        scale = np.abs(r).max(initial=0.0)
        r[self._fixed] = 0.0
        if self._balanced(r, scale):
            self._base, self._base_residual = self._exchange.gather(x), residual
            self.problem.condensed, self.outgrown = self, False

    @property
    def holds(self) -> bool:
        """Whether the inside is left behind: since `hold`, until `complete` or until the surfaces are paired anew."""
        return self.problem.condensed is self

    def residual(self, x: PETSc.Vec, result: PETSc.Vec) -> None:
        """Residual of the bulk at x, were its inside in equilibrium; at fixed unknowns still that of `hold`."""
        self._base_residual.copy(result)
        change = (self._exchange.gather(x) - self._base)[self._places]
        added = np.zeros_like(self._base)
        added[self._places] = self._factors.reduced(change) - self._shift * change
        self._exchange.add(added, result)

    def complete(self, x: PETSc.Vec) -> bool:
        """Let the inside of x, left behind by `hold`, follow; whether contact has spread beyond the candidates."""
        if not self.holds:
            return False
        change = self._exchange.gather(x) - self._base
        change[self._places] = self._factors.reduced(change[self._places])
        change = self._factors.solve(change)
        change[self._places] = 0.0
        self._exchange.add(change, x)
        spread = self.outgrown
        self.let_go()
        return spread

    def let_go(self) -> None:
        """End `hold`: the inside, where it is, takes part in every solve again."""
        self.problem.condensed, self.outgrown = None, False

    def _balanced(self, r: Array, scale: float) -> bool:
        """Whether no more of r is inside than what is rounding against `scale`."""
        inner = r.copy()
        inner[self._places] = 0.0
        norms = parallel.largest(self.comm, np.array([np.abs(inner).max(initial=0.0), scale]))
        return bool(norms[0] <= INTERIOR * norms[1])

    def solve(self, right: PETSc.Vec, result: PETSc.Vec) -> None:
        """result = (K + C)^-1 right, at the candidates alone while the inside is held; not numbers where singular."""
        r = self._exchange.gather(right)
        outer = r[self._places]
        condensed = outer
        if not self.holds:
            scale = float(parallel.largest(self.comm, np.array([np.abs(r).max(initial=0.0)]))[0])
            if not self._balanced(r, scale):
                condensed = outer + self._from_inside(r, scale)
        gathered = self.comm.gather((self._own, condensed))
        whole = None
        if gathered is not None:
            whole = np.zeros(len(self._reduced))
            for at, part in gathered:
                whole[at] = part
            if self._lu is not None:
                whole = scipy.linalg.lu_solve(self._lu, whole, check_finite=False)
        change = self.comm.bcast(whole)[self._own]
        if self.holds:
            r[:] = 0.0
            r[self._places] = change
        else:
            r[self._places] = self._factors.reduced(change) + outer - condensed
            r = self._factors.solve(r)
        result.set(0.0)
        self._exchange.add(r, result)

    def _from_inside(self, r: Array, scale: float) -> Array:
        """What forces r inside do to the candidates, -K_ci K_ii^-1 r_i; equal steps of a load ask for it once."""
        inner = r.copy()
        inner[self._places] = 0.0
        before, answer = self._asked
        share = (inner @ before) / (before @ before) if before.any() else 0.0
        if np.abs(inner - share * before).max(initial=0.0) > SAME * scale:
            share, answer = 1.0, self._factors.reduced(self._factors.solve(inner)[self._places])
            self._asked = inner, answer
        return share * answer

    def _divide(self) -> list[Integers]:
        """Whole parts for each rank, the largest first to the one with the least; the nodes of each, sorted."""
        model = self.problem.model
        start = model.unknowns.space.dofmap.index_map.local_range[0]
        owned = model.parts.node_part[: model.unknowns.owned]
        count = self.comm.allreduce(np.bincount(owned, minlength=len(model.parts.size)), op=MPI.SUM)
        load = np.zeros(self.comm.size)
        rank_of = np.zeros(len(count), int)
        for part in np.argsort(-count, kind="stable"):
            rank_of[part] = load.argmin()
            load[rank_of[part]] += count[part]
        here = [np.flatnonzero(rank_of[owned] == rank) for rank in range(self.comm.size)]
        nodes, parts = np.concatenate(self.comm.alltoall([np.stack([start + n, owned[n]]) for n in here]), axis=1)
        return [np.sort(nodes[parts == part]) for part in np.unique(parts)]


def _unknowns(nodes: Integers, block: int) -> NDArray[np.int32]:
    return (nodes[:, None] * block + np.arange(block)).ravel().astype(PETSc.IntType)
