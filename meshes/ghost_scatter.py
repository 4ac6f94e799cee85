"""Entries of distributed vectors that a rank needs, whoever holds them."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

from piezomat.forms.arrays import Array


class GhostScatter:
    """Takes some entries of distributed vectors to this rank and gives them back. Every method is collective."""

    def __init__(self, vector: PETSc.Vec, entries: PETSc.IS) -> None:
        """`vector` is laid out like those to come; `entries` are this rank's choice, global numbers."""
        self._local = PETSc.Vec().createSeq(entries.getSize(), comm=MPI.COMM_SELF)
        self._scatter = PETSc.Scatter().create(vector, entries, self._local, None)

    def gather(self, vector: PETSc.Vec) -> Array:
        """The entries of a vector."""
        self._scatter.scatter(vector, self._local, PETSc.InsertMode.INSERT_VALUES, PETSc.ScatterMode.FORWARD)
        return self._local.array.copy()

    def add(self, values: Array, result: PETSc.Vec) -> None:
        """Add values to the entries of a vector; what several ranks give to one is summed."""
        self._give(values, result, PETSc.InsertMode.ADD_VALUES)

    def maximum(self, values: Array, result: PETSc.Vec) -> None:
        """Raise the entries of a vector to values, the largest of what several ranks give to one."""
        self._give(values, result, PETSc.InsertMode.MAX_VALUES)

    def _give(self, values: Array, result: PETSc.Vec, mode: PETSc.InsertMode) -> None:
        self._local.array[:] = values
        self._scatter.scatter(self._local, result, mode, PETSc.ScatterMode.REVERSE)
