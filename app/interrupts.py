"""SIGINT and SIGTERM during a run: it ends at the next Newton iteration, with the steps that have converged."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from mpi4py import MPI


class StopRequest:
    """Whether a signal has come, on any rank.

    `signal` (int): number of the signal that this rank has had, 0 for none.
    """

    def __init__(self, comm: MPI.Comm) -> None:
        self.comm = comm
        self.signal = 0

    def requested(self) -> bool:
        """True on all ranks once a signal has reached one of them. Collective."""
        return bool(self.comm.allreduce(self.signal, op=MPI.MAX))


@contextmanager
def stop_on_signal(comm: MPI.Comm) -> Iterator[StopRequest]:
    """Context in which the first SIGINT or SIGTERM is noted and the second one ends the process."""
    stop = StopRequest(comm)

    def note(number: int, frame: Any) -> None:
        stop.signal = number
        for name in (signal.SIGINT, signal.SIGTERM):
            signal.signal(name, signal.SIG_DFL)

    try:
        before = {name: signal.signal(name, note) for name in (signal.SIGINT, signal.SIGTERM)}
    except ValueError:  # not in the main thread: the caller handles signals
        before = {}
    try:
        yield stop
    finally:
        for name, handler in before.items():
            signal.signal(name, handler)
