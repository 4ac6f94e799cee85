"""Time and memory of a run, and imports without garbage collection."""

from __future__ import annotations

import ctypes
import gc
import resource
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from time import perf_counter

from mpi4py import MPI

BUCKETS = ("setup", "mesh", "assembly", "contact", "linear_solve", "output")


class Timer:
    """Wall-clock time of this rank in named buckets; a bucket opened inside another interrupts the outer one.

    No second is counted twice: the buckets add up to at most the total since the timer was made.

    seconds (s, by bucket): time so far.
    """

    def __init__(self, buckets: Sequence[str] = BUCKETS) -> None:
        self.seconds = dict.fromkeys(buckets, 0.0)
        self._open: list[str] = []
        self._start = self._last = perf_counter()

    @contextmanager
    def __call__(self, bucket: str) -> Iterator[None]:
        """Count the time of the `with` block to `bucket`; KeyError where there is no such bucket."""
        if bucket not in self.seconds:
            raise KeyError(f"no timing bucket '{bucket}'; there are {', '.join(self.seconds)}")
        self._count()
        self._open.append(bucket)
        try:
            yield
        finally:
            self._count()
            self._open.pop()

    def _count(self) -> None:
        """Add the time since the last change to the open bucket."""
        now = perf_counter()
        if self._open:
            self.seconds[self._open[-1]] += now - self._last
        self._last = now

    def timings(self, comm: MPI.Comm) -> dict[str, float]:
        """Seconds of each bucket and of the `total`, mean over the ranks. Collective.

        The mean, so that the buckets add up to at most the total; waiting for another rank counts.
        """
        self._count()
        here = self.seconds | {"total": perf_counter() - self._start}
        everywhere = comm.allgather(here)
        return {name: sum(rank[name] for rank in everywhere) / comm.size for name in here}


def peak_memory_mb(comm: MPI.Comm) -> float:
    """Largest resident memory since the start, MB, summed over the ranks. Collective."""
    return comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def give_back_memory() -> None:
    """Return freed memory to the system: the C library keeps it between pieces in use. Not collective."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:  # of the GNU C library alone
        trim(0)


@contextmanager
def importing() -> Iterator[None]:
    """Context for imports without garbage collection; later collections skip the objects that they made.

    Saves a quarter of the processor time of a small run, most of it at its end.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.collect()
        gc.freeze()
        gc.enable()
