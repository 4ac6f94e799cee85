"""Operations of all ranks: reductions, redistribution, and work of one rank whose exception every rank raises."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from piezomat.forms.arrays import Array

T = TypeVar("T")


def on_root(comm: MPI.Comm, action: Callable[[], T]) -> T:
    """What `action()` returns on rank 0, on every rank. Collective.

    An exception of `action` is raised on every rank, so that no rank waits for one that has failed.
    """
    return comm.bcast(only_on_root(comm, action))


def only_on_root(comm: MPI.Comm, action: Callable[[], T]) -> T | None:
    """What `action()` returns on rank 0, None elsewhere: for results too large to send. Collective.

    An exception of `action` is raised on every rank.
    """
    result: T | None = None
    failure: Exception | None = None
    if comm.rank == 0:
        try:
            result = action()
        except Exception as error:
            failure = error
    received = comm.bcast(None if failure is None else _portable(failure))
    if received is not None:
        raise received if failure is None else failure
    return result


def on_all(comm: MPI.Comm, action: Callable[[], T]) -> T:
    """What `action()` returns on each rank; its exception on any rank is raised on every rank. Collective."""
    result: T | None = None
    failure: Exception | None = None
    try:
        result = action()
    except Exception as error:
        failure = _portable(error)
    failures = [f for f in comm.allgather(failure) if f is not None]
    if failures:
        raise failures[0]
    return result  # type: ignore[return-value]


def _portable(error: Exception) -> Exception:
    """The exception, or one with its message if it cannot be sent to other ranks."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def total(comm: MPI.Comm, values: Array) -> Array:
    """Sum of the ranks' arrays of one shape. Collective."""
    return _reduce(comm, values, MPI.SUM)


def largest(comm: MPI.Comm, values: Array) -> Array:
    """Largest of the ranks' values for each entry. Collective."""
    return _reduce(comm, values, MPI.MAX)


def least(comm: MPI.Comm, values: Array) -> Array:
    """Least of the ranks' values for each entry. Collective."""
    return _reduce(comm, values, MPI.MIN)


def _reduce(comm: MPI.Comm, values: Array, operation: MPI.Op) -> Array:
    sent = np.ascontiguousarray(values, np.float64)
    result = np.empty_like(sent)
    comm.Allreduce(sent, result, op=operation)
    return result


def redistributed(comm: MPI.Comm, rows: NDArray, rank: NDArray[np.int32]) -> NDArray:
    """Rows that this rank receives when every row (n, ...) goes to its `rank` (n,). Collective."""
    return np.concatenate(comm.alltoall([rows[rank == there] for there in range(comm.size)]))
