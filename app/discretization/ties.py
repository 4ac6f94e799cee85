"""Ties: groups of unknowns that equal one unknown each, the homogeneous part of the constraints x = T y + g.

An electrode ties the potentials of its nodes to that of its reference node. The tied unknowns leave the problem: with
the residual R and the tangent K of all unknowns, those of the rest are T^T R and T^T K T, in which a tied unknown has
the row and the column of the unit matrix.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from petsc4py import PETSc

from piezomat.discretization.unknowns import Unknowns
from piezomat.forms.arrays import Array, Integers
from piezomat.meshes import parallel


class Ties:
    """The tied unknowns of a model and what each group of them equals.

    tied (k,): local numbers of this rank's tied unknowns, sorted
    group (k,): number of the group of each
    references (g,): global number of the unknown that each group equals, of a reference node
    """

    def __init__(self, unknowns: Unknowns, groups: Sequence[Integers], references: Sequence[int]) -> None:
        """groups: local numbers of this rank's tied unknowns, each in one group; references: see above. Collective."""
        self._comm = unknowns.comm
        self.references = np.array(references, np.int64)
        tied = np.concatenate([np.zeros(0, np.int64), *groups])
        group = np.repeat(np.arange(len(groups)), [len(g) for g in groups])
        order = np.argsort(tied)
        self.tied, self.group = tied[order], group[order]
        self._owner = self._comm.size - 1  # of all reference nodes
        # Local numbers of the references, none on the other ranks. All ranks write to a vector, if only nothing: on one
        # that has not, PETSc would take the norm that it has kept, and leave the others waiting for it.
        local = self.references - unknowns.total + unknowns.owned * unknowns.block
        self._local = local[: len(local) if self._comm.rank == self._owner else 0]
        here = self.tied + unknowns.first_node * unknowns.block
        # Ranks own ascending numbers.
        self._tied_global = np.concatenate(self._comm.allgather(here))
        self._image = self.references[np.concatenate(self._comm.allgather(self.group))]

    def __bool__(self) -> bool:
        """Whether there are groups."""
        return len(self.references) > 0

    def image(self, numbers: Integers) -> Integers:
        """Global numbers of the unknowns that those of these global numbers equal: their own unless they are tied."""
        if not len(self._tied_global):
            return numbers
        place = np.minimum(np.searchsorted(self._tied_global, numbers), len(self._tied_global) - 1)
        return np.where(self._tied_global[place] == numbers, self._image[place], numbers)

    def values(self, vector: PETSc.Vec) -> Array:
        """Values (g,) of the references, on all ranks. Collective."""
        return self._comm.bcast(vector.array_r[self._local], self._owner)

    def set_values(self, vector: PETSc.Vec, values: Sequence[float]) -> None:
        """Give the references these values (g,), the same on all ranks. Not collective, but for all ranks."""
        vector.array[self._local] = values[: len(self._local)]

    def add_values(self, vector: PETSc.Vec, values: Array) -> None:
        """Add values (g,), the same on all ranks, to those of the references. Not collective, but for all ranks."""
        vector.array[self._local] += values[: len(self._local)]

    def sums(self, vector: PETSc.Vec) -> Array:
        """Sums (g,) over the unknowns of each group, its reference included: the groups' part of T^T. Collective."""
        here = np.bincount(self.group, vector.array_r[self.tied], len(self.references)).astype(float)
        here[: len(self._local)] += vector.array_r[self._local]
        return parallel.total(self._comm, here)

    def reduce(self, vector: PETSc.Vec) -> None:
        """Replace a vector of forces by T^T times it. Collective."""
        if not self:
            return
        sums = self.sums(vector)
        vector.array[self.tied] = 0.0
        vector.array[self._local] = sums[: len(self._local)]

    def expand(self, vector: PETSc.Vec) -> None:
        """Replace a vector of unknowns by T times it. Collective."""
        if self:
            vector.array[self.tied] = self.values(vector)[self.group]
