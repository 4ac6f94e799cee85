"""Ties: groups of unknowns that equal one unknown each, the homogeneous part of the constraints x = T y + g.

An electrode ties the potentials of its nodes to that of its reference node, a rigid boundary their displacements. The
tied unknowns leave the problem: with the residual R and the tangent K of all unknowns, those of the rest are T^T R and
T^T K T, in which a tied unknown has the row and the column of the unit matrix.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from petsc4py import PETSc

from piezomat.discretization.unknowns import Unknowns
from piezomat.forms.arrays import Array, Integers
from piezomat.meshes import parallel


class References:
    """Some unknowns of reference nodes: their values in the vectors of a model.

    numbers (g,): global
    local (g,): local, on the rank that owns them; (0,) on the others
    """

    def __init__(self, unknowns: Unknowns, numbers: Sequence[int]) -> None:
        self._comm = unknowns.comm
        self._owner = self._comm.size - 1  # of all reference nodes
        self.numbers = np.array(numbers, np.int64)
        local = self.numbers - unknowns.total + unknowns.owned * unknowns.block
        # All ranks write to a vector, if only nothing: on one that has not, PETSc would take the norm that it has kept,
        # and leave the others waiting for it.
        self.local = local[: len(local) if self._comm.rank == self._owner else 0]

    def __len__(self) -> int:
        return len(self.numbers)

    def values(self, vector: PETSc.Vec) -> Array:
        """Values (g,), on all ranks. Collective."""
        return self._comm.bcast(vector.array_r[self.local], self._owner)

    def set_values(self, vector: PETSc.Vec, values: Sequence[float]) -> None:
        """Give them these values (g,), the same on all ranks. Not collective, but for all ranks."""
        vector.array[self.local] = values[: len(self.local)]

    def add_values(self, vector: PETSc.Vec, values: Array) -> None:
        """Add values (g,), the same on all ranks, to theirs. Not collective, but for all ranks."""
        vector.array[self.local] += values[: len(self.local)]


class Ties:
    """The tied unknowns of a model and what each group of them equals.

    tied (k,): local numbers of this rank's tied unknowns, sorted
    group (k,): number of the group of each
    references (g,): the unknown that each group equals
    """

    def __init__(self, unknowns: Unknowns, groups: Sequence[Integers], references: References) -> None:
        """groups: local numbers of this rank's tied unknowns, each in one group; references: see above. Collective."""
        self._comm = unknowns.comm
        self.references = references
        tied = np.concatenate([np.zeros(0, np.int64), *groups])
        group = np.repeat(np.arange(len(groups)), [len(g) for g in groups])
        order = np.argsort(tied)
        self.tied, self.group = tied[order], group[order]
        here = self.tied + unknowns.first_node * unknowns.block
        # Ranks own ascending numbers.
        self._tied_global = np.concatenate(self._comm.allgather(here))
        self._image = references.numbers[np.concatenate(self._comm.allgather(self.group))]

    def __bool__(self) -> bool:
        """Whether there are groups."""
        return len(self.references) > 0

    def image(self, numbers: Integers) -> Integers:
        """Global numbers of the unknowns that those of these global numbers equal: their own unless they are tied."""
        if not len(self._tied_global):
            return numbers
        place = np.minimum(np.searchsorted(self._tied_global, numbers), len(self._tied_global) - 1)
        return np.where(self._tied_global[place] == numbers, self._image[place], numbers)

    def sums(self, vector: PETSc.Vec) -> Array:
        """Sums (g,) over the unknowns of each group, its reference included: the groups' part of T^T. Collective."""
        here = np.bincount(self.group, vector.array_r[self.tied], len(self.references)).astype(float)
        local = self.references.local
        here[: len(local)] += vector.array_r[local]
        return parallel.total(self._comm, here)

    def reduce(self, vector: PETSc.Vec) -> None:
        """Replace a vector of forces by T^T times it. Collective."""
        if not self:
            return
        sums = self.sums(vector)
        vector.array[self.tied] = 0.0
        self.references.set_values(vector, sums)

    def expand(self, vector: PETSc.Vec) -> None:
        """Replace a vector of unknowns by T times it. Collective."""
        if self:
            vector.array[self.tied] = self.references.values(vector)[self.group]
