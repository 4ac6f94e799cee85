"""Memory of this process: the largest that it has had, and what is free given back to the system."""

from __future__ import annotations

import ctypes
import resource

from mpi4py import MPI


def peak_memory_mb(comm: MPI.Comm) -> float:
    """Largest resident memory since the start, MB, summed over the ranks. Collective."""
    return comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def give_back_memory() -> None:
    """Give back what has been freed: where small pieces lie in between, the C library would keep it. Not collective."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:  # of the GNU C library alone
        trim(0)
