"""The nodes of the facets that a rank sees, and the exchange of their unknowns with the ranks that own them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.forms.arrays import Array, Integers
from piezomat.meshes.ghost_scatter import GhostScatter


class SeenNodes:
    """Nodes of this rank's own and ghost facets. Every method but `places` is collective.

    number (n,): global numbers, sorted, each once
    reference (n, d): undeformed positions, um
    block_size: number of unknowns of a node
    """

    def __init__(self, coordinates: PETSc.Vec, block_size: int, dim: int, facets: Iterable[Integers]) -> None:
        """coordinates: a vector like the state with the nodes' undeformed positions; facets: their global nodes."""
        self.block_size = block_size
        self.number = np.unique(np.concatenate([np.zeros(0, np.int64), *map(np.ravel, facets)]))
        wanted = PETSc.IS().createBlock(block_size, self.number.astype(PETSc.IntType), comm=MPI.COMM_SELF)
        self._scatter = GhostScatter(coordinates, wanted)
        self.reference = self.gather(coordinates)[:, :dim]

    def places(self, number: Integers) -> Integers:
        """Places of nodes among the seen ones, by their global numbers."""
        return np.searchsorted(self.number, number)

    def gather(self, vector: PETSc.Vec) -> Array:
        """Values (n, block_size) of a distributed vector."""
        return self._scatter.gather(vector).reshape(-1, self.block_size)

    def add(self, nodes: Integers, values: Array, result: PETSc.Vec) -> None:
        """Add values (..., block_size) at nodes (...), numbered as in `number`, to a distributed vector."""
        unknowns = nodes[..., None] * self.block_size + np.arange(self.block_size)
        size = len(self.number) * self.block_size
        self._scatter.add(np.bincount(unknowns.ravel(), values.ravel(), size), result)
