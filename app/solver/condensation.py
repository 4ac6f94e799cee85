"""Static condensation: a constant bulk is eliminated once, down to the nodes that may come into contact.

With K the constant part of the tangent and C the contact's part, which lives on the candidate nodes c alone,

    (K + C) x = r   is   (S + C) x_c = r_c - K_ci K_ii^-1 r_i,   S = K_cc - K_ci K_ii^-1 K_ic,

and then the interior x_i follows from x_c. Bodies do not share nodes: each is factorized by itself, on one rank.
Reference nodes are candidates, and each body has a copy of them: what couples it to them is in its own factors.

Where the interior is in balance, Newton's method needs x_c alone (the reduced problem): the residual at the candidates
changes by S times their change, and the interior is recovered once, when the iterations have ended. That saves 13 to
30 % of the time of half discs in 2D.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.contact.interfaces import Interfaces
from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.meshes import parallel
from piezomat.meshes.ghost_scatter import GhostScatter
from piezomat.solver.mumps_schur import SchurFactors
from piezomat.solver.outcome import SINGULAR, SolveError
from piezomat.usage import give_back_memory

# Distance of the surfaces whose nodes are candidates at first, over the largest prescribed motion: half of it would do
# for equal bodies (Hertz), and more where they give.
CANDIDATE_DISTANCE = 0.75
BALANCED = 1e-10  # interior residual, share of the whole, that is rounding


class Condensation:
    """Solves with the tangent of a `Problem` whose bulk is constant and symmetric. Every method is collective.

    candidates (n,): global nodes that the bulk is condensed to, sorted, the same on all ranks.
    candidates_exceeded: whether contact has spread beyond them since `start`.
    is_reduced: whether the interior is left behind: since `start`, until `recover` or `discard`.
    factor_solves: solves with the factors of the bulk so far.
    """

    def __init__(self, problem: Problem, contact: Interfaces) -> None:
        self.problem = problem
        self._contact = contact
        self.comm: MPI.Comm = problem.comm
        self.block = problem.model.unknowns.block
        self._unknowns = problem.model.unknowns.numbers
        unknowns = problem.model.unknowns
        self._references = unknowns.reference_node(0) + np.arange(unknowns.references)
        self.candidates = self._references
        motion = problem.model.prescription.largest_motion() or contact.least_search_radius()
        self._distance = CANDIDATE_DISTANCE * motion
        contact.set_candidate_distance(self._distance)
        self.candidates_exceeded = False
        self.is_reduced = False
        self.factor_solves = 0
        self._stiffness_version = -1  # of the bulk that is condensed
        self._factors = SchurFactors()
        self._parts, holds_references = self._divide()
        self._nodes = np.concatenate([np.zeros(0, np.int64), *self._parts])
        numbers = self._unknowns(self._nodes)
        eliminated = np.concatenate(self.comm.allgather(problem.model.constraints.eliminated_global))
        self._eliminated = np.isin(numbers, eliminated)
        self._scatter = GhostScatter(problem.state, PETSc.IS().createGeneral(numbers, comm=MPI.COMM_SELF))
        # The reference nodes' unknowns in the bodies that have copies of them: all but one, which holds their forces.
        counts = [len(part) * self.block for part in self._parts]
        self._is_copy = np.repeat(~np.array(holds_references, bool), counts) & (numbers >= unknowns.total)

    def close(self) -> None:
        """Free the factors: 100 MB of 65,000 unknowns in 2D, which would stay until garbage is collected. Ends its use.

        Not collective.
        """
        self._factors.destroy()
        if self.is_reduced:
            self.discard()

    def update(self, limit: float) -> bool:
        """Take the contact's part of the problem's last tangent; False if it has more than `limit` candidate unknowns.

        While the problem is reduced, contact beyond the candidates is left out, and noted in `candidates_exceeded`.
        """
        nodes, matrices = self.problem.blocks()
        inside = np.isin(nodes, self.candidates).all(axis=1)
        exceeded = self.comm.allreduce(not inside.all(), op=MPI.LOR)
        if self.is_reduced:
            self.candidates_exceeded = self.candidates_exceeded or exceeded
            nodes, matrices = nodes[inside], matrices[inside]
        elif exceeded or self._stiffness_version != self.problem.stiffness_version:
            wanted = np.union1d(nodes, self._contact.candidate_nodes(self._distance))
            candidates = np.unique(np.concatenate([self.candidates, *self.comm.allgather(wanted)]))
            if len(candidates) * self.block > limit:
                return False
            self._condense(candidates)
            self._distance *= 2.0
        self._add(nodes, matrices)
        return True

    def _condense(self, candidates: Integers) -> None:
        """Factorize the bulk and condense it to these global nodes, sorted and the same on all ranks."""
        self._stiffness_version = self.problem.stiffness_version
        self._factors.destroy()
        problem, b = self.problem, self.block
        self.candidates = candidates
        sets = [PETSc.IS().createGeneral(self._unknowns(part), comm=MPI.COMM_SELF) for part in self._parts]
        bulk = problem.bulk_stiffness()
        matrices = bulk.createSubMatrices(sets, sets)
        bulk.destroy()
        give_back_memory()
        shifts, places, complements, first = [np.zeros(0)], [np.zeros(0, np.int64)], [], 0
        self._factors = SchurFactors()
        singular = False
        for part, matrix in zip(self._parts, matrices, strict=True):
            outer = self._unknowns(np.flatnonzero(np.isin(part, candidates)))
            places.append(first + outer.astype(np.int64))
            shifts.append(self._shifted(matrix, outer, self._is_copy[places[-1]]))
            first += len(part) * b
            try:
                self._factors.add(matrix, outer)
            except PETSc.Error:  # a zero pivot
                singular = True
        if self.comm.allreduce(singular, op=MPI.LOR):
            self._stiffness_version = -1
            raise SolveError(SINGULAR)
        give_back_memory()
        self._shift, self._kept = np.concatenate(shifts), np.concatenate(places)
        complements = [s - np.diag(shift) for s, shift in zip(self._factors.complements, shifts[1:], strict=True)]
        unknowns = self._unknowns(candidates)
        numbers = self._unknowns(self._nodes)
        rows = [np.searchsorted(unknowns, numbers[at]) for at in places[1:]]
        self._reduced_rows = np.concatenate([np.zeros(0, np.int64), *rows])
        gathered = self.comm.gather((rows, complements, ~self._eliminated[self._kept], self._reduced_rows))
        self._reduced: Array | None = None
        if gathered is not None:
            self._reduced = np.zeros((len(unknowns), len(unknowns)))
            self._free = np.zeros(len(unknowns), bool)
            for rows, complements, free, every in gathered:
                for at, complement in zip(rows, complements, strict=True):
                    self._reduced[np.ix_(at, at)] += complement
                self._free[every] = free

    def _shifted(self, matrix: PETSc.Mat, outer: NDArray[np.int32], is_copy: Booleans) -> Array:
        """Add springs to a body's matrix at its candidates, and return them, to be subtracted from the complement.

        Unconstrained bodies leave K singular: the springs are as stiff as the bulk there. The potential's block is
        negative. A reference node without stiffness, as every copy is, has springs like the stiffest node.
        """
        matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_LOCATIONS, False)  # which are zero without being written
        copies = outer[is_copy]
        matrix.setValues(copies, copies, np.zeros(len(copies) ** 2))
        matrix.assemble()
        diagonal = matrix.getDiagonal()
        shift = diagonal.array_r[outer].copy()
        signs = np.where(outer % self.block == self.problem.model.dim, -1.0, 1.0)
        shift = np.where(shift == 0.0, signs * np.abs(diagonal.array_r).max(initial=0.0), shift)
        diagonal.array[outer] += shift
        matrix.setDiagonal(diagonal)
        return shift

    def _add(self, nodes: Integers, matrices: Array) -> None:
        """Factorize the condensed bulk with the contact's matrices of these nodes added."""
        b, n = self.block, len(self.candidates) * self.block
        image = self.problem.model.constraints.ties.image
        numbers = image((nodes[:, :, None] * b + np.arange(b)).reshape(len(nodes), nodes.shape[1] * b))
        rows = np.searchsorted(self.candidates, numbers // b) * b + numbers % b
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

    def start(self, x: PETSc.Vec) -> None:
        """If the interior is in balance at x, leave it there: the problem's states are reduced to the candidates."""
        if self.is_reduced:
            return
        residual = self.problem.bulk_residual(x)
        r = self._scatter.gather(residual)
        scale = np.abs(r).max(initial=0.0)
        r[self._eliminated] = 0.0
        if self._is_balanced(r, scale):
            self._base, self._base_residual = self._scatter.gather(x), residual
            self.is_reduced, self.candidates_exceeded = True, False

    def residual(self, x: PETSc.Vec, result: PETSc.Vec) -> None:
        """Residual of the bulk at x, its interior in balance; at prescribed unknowns still that of `start`."""
        self._base_residual.copy(result)
        change = self._change(x)[self._kept]
        added = np.zeros_like(self._base)
        added[self._kept] = self._factors.reduced(change) - self._shift * change
        self._scatter.add(added, result)

    def recover(self, x: PETSc.Vec) -> bool:
        """Bring the interior of x into balance and end the reduction; whether contact has exceeded the candidates."""
        if not self.is_reduced:
            return False
        change = self._change(x)
        change[self._kept] = self._factors.reduced(change[self._kept])
        change = self._solve(change)
        change[self._kept] = 0.0
        self._scatter.add(change, x)
        exceeded = self.candidates_exceeded
        self.discard()
        return exceeded

    def _change(self, x: PETSc.Vec) -> Array:
        """Change of the candidates since `start`, zero elsewhere and at the eliminated unknowns."""
        change = np.zeros_like(self._base)
        change[self._kept] = (self._scatter.gather(x) - self._base)[self._kept]
        change[self._eliminated] = 0.0
        return change

    def discard(self) -> None:
        """End the reduction; the interior stays where it is, and is solved for again."""
        self.is_reduced, self.candidates_exceeded = False, False

    def _is_balanced(self, r: Array, scale: float) -> bool:
        """Whether the interior part of r is rounding, compared to `scale`."""
        inner = r.copy()
        inner[self._kept] = 0.0
        norms = parallel.largest(self.comm, np.array([np.abs(inner).max(initial=0.0), scale]))
        return bool(norms[0] <= BALANCED * norms[1])

    def solve(self, right: PETSc.Vec, result: PETSc.Vec) -> None:
        """result = (K + C)^-1 right; of a reduced problem at the candidates alone. Not numbers where it is singular."""
        r = self._scatter.gather(right)
        r[self._is_copy] = 0.0
        outer = r[self._kept]
        condensed = outer
        if not self.is_reduced:
            scale = float(parallel.largest(self.comm, np.array([np.abs(r).max(initial=0.0)]))[0])
            if not self._is_balanced(r, scale):
                condensed = outer + self._interior_effect(r)
        gathered = self.comm.gather((self._reduced_rows, condensed))
        whole = None
        if gathered is not None:
            whole = np.zeros(len(self._reduced))
            for at, part in gathered:
                np.add.at(whole, at, part)
            if self._lu is not None:
                whole = scipy.linalg.lu_solve(self._lu, whole, check_finite=False)
        change = self.comm.bcast(whole)[self._reduced_rows]
        if self.is_reduced:
            r[:] = 0.0
            r[self._kept] = change
        else:
            r[self._kept] = self._factors.reduced(change) + outer - condensed
            r = self._solve(r)
        r[self._is_copy] = 0.0
        result.set(0.0)
        self._scatter.add(r, result)

    def _interior_effect(self, r: Array) -> Array:
        """Effect of interior forces r on the candidates, -K_ci K_ii^-1 r_i."""
        inner = r.copy()
        inner[self._kept] = 0.0
        return self._factors.reduced(self._solve(inner)[self._kept])

    def _solve(self, right: Array) -> Array:
        self.factor_solves += 1
        return self._factors.solve(right)

    def _divide(self) -> tuple[list[Integers], list[bool]]:
        """Nodes of each part of this rank, sorted, and whether it holds the forces of the reference nodes at their end.

        Parts are whole; the largest comes first, to the rank with the least.
        """
        model = self.problem.model
        start = model.unknowns.first_node
        owned = model.parts.node_part[: model.unknowns.owned]
        count = self.comm.allreduce(np.bincount(owned, minlength=len(model.parts.size)), op=MPI.SUM)
        load = np.zeros(self.comm.size)
        rank_of = np.zeros(len(count), int)
        for part in np.argsort(-count, kind="stable"):
            rank_of[part] = load.argmin()
            load[rank_of[part]] += count[part]
        here = [np.flatnonzero(rank_of[owned] == rank) for rank in range(self.comm.size)]
        nodes, parts = np.concatenate(self.comm.alltoall([np.stack([start + n, owned[n]]) for n in here]), axis=1)
        numbers = np.unique(parts)
        divided = [np.concatenate([np.sort(nodes[parts == part]), self._references]) for part in numbers]
        return divided, [bool(part == 0) for part in numbers]
