"""Gather and scatter of entries of distributed vectors, on whichever rank they are."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

from piezomat.forms.arrays import Array


class GhostScatter:
    """Chosen entries of distributed vectors: gathered to this rank, added back. Every method is collective."""

    def __init__(self, vector: PETSc.Vec, entries: PETSc.IS) -> None:
        """vector: gives the layout; entries: global numbers of the entries that this rank needs."""
        self._local = PETSc.Vec().createSeq(entries.getSize(), comm=MPI.COMM_SELF)
        self._scatter = PETSc.Scatter().create(vector, entries, self._local, None)

    def gather(self, vector: PETSc.Vec) -> Array:
        """Values (n,) of the entries of a vector."""
        self._scatter.scatter(vector, self._local, PETSc.InsertMode.INSERT_VALUES, PETSc.ScatterMode.FORWARD)
        return self._local.array.copy()

    def add(self, values: Array, result: PETSc.Vec) -> None:
        """Add values (n,) to the entries of a vector; those of several ranks are summed."""
        self._scatter_back(values, result, PETSc.InsertMode.ADD_VALUES)

    def maximum(self, values: Array, result: PETSc.Vec) -> None:
        """Raise the entries of a vector to the largest of the values (n,) of any rank."""
        self._scatter_back(values, result, PETSc.InsertMode.MAX_VALUES)

    def _scatter_back(self, values: Array, result: PETSc.Vec, mode: PETSc.InsertMode) -> None:
        self._local.array[:] = values
        self._scatter.scatter(self._local, result, mode, PETSc.ScatterMode.REVERSE)
