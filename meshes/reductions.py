"""Sums and extremes of arrays over ranks, entry by entry. Every function is collective."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

Array = NDArray[np.float64]


def total(comm: MPI.Comm, values: Array) -> Array:
    """Sum of the ranks' arrays of one shape."""
    return _reduce(comm, values, MPI.SUM)


def largest(comm: MPI.Comm, values: Array) -> Array:
    """Largest of the ranks' entries."""
    return _reduce(comm, values, MPI.MAX)


def least(comm: MPI.Comm, values: Array) -> Array:
    """Least of the ranks' entries."""
    return _reduce(comm, values, MPI.MIN)


def _reduce(comm: MPI.Comm, values: Array, operation: MPI.Op) -> Array:
    sent = np.ascontiguousarray(values, np.float64)
    result = np.empty_like(sent)
    comm.Allreduce(sent, result, op=operation)
    return result
