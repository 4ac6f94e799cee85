"""Time and memory of a run."""

from __future__ import annotations

import resource
import sys
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.usage import Timer, give_back_memory, peak_memory_mb


@pytest.mark.mpi
def test_peak_memory_is_that_of_all_ranks(comm: MPI.Comm) -> None:
    total = peak_memory_mb(comm)
    ballast = np.ones(int((total / comm.size + 50) * 1e6 / 8))  # more than was ever in use
    assert peak_memory_mb(comm) > total + 20 * comm.size
    del ballast


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="of the GNU C library alone")
def test_memory_that_is_free_is_given_back() -> None:
    """Small pieces between which some stay in use: freed, they stay with the process until they are given back."""

    def resident_mb() -> float:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6

    pieces = [bytes(50_000) for _ in range(2000)]
    del pieces[:-1]
    before = resident_mb()
    give_back_memory()
    assert resident_mb() < before - 50


def test_timer_counts_no_second_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0
    monkeypatch.setattr("piezomat.usage.perf_counter", lambda: now)
    timer = Timer()
    now = 1.0
    with timer("assembly"):
        now = 3.0
        with timer("contact"):
            now = 7.0
            with pytest.raises(RuntimeError), timer("assembly"):
                now = 15.0
                raise RuntimeError
            now = 31.0
        now = 63.0
    now = 127.0
    with pytest.raises(KeyError, match="no timing bucket 'lunch'"), timer("lunch"):
        pass
    seconds = timer.timings(MPI.COMM_SELF)
    assert seconds["assembly"] == 2 + 8 + 32
    assert seconds["contact"] == 4 + 16
    assert seconds["total"] == 127
    assert seconds["mesh"] == 0
