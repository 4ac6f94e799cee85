"""What all tests share: seeds, the communicator, the guard that keeps the ranks of a parallel test together.

A test marked `mpi` is collective: it runs on one rank and, under mpirun, on any number of ranks. The guard
makes every rank run the same tests, counts a test that failed on one rank as failed on all, shows that
rank's traceback on rank 0, and ends the whole run when a rank has failed and the others wait for it. Tests
without the mark are left out on more than one rank. With --share-cases 2, 3 and 4 ranks each run a third of a
test's cases. Rank 0 alone writes.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import logging
import random
import subprocess
import sys
import time
import zlib
from collections import defaultdict
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

SEED = 20200214
# How long the ranks that are done with a test wait for the others (s): once a rank has failed, and at most.
PATIENCE_AFTER_FAILURE = 30.0
PATIENCE = 900.0

WORLD = MPI.COMM_WORLD
# The guard's messages never meet those of a test.
GUARD = WORLD.Dup()
PASSED, SKIPPED, FAILED = range(3)


# What mpirun's options would say, in the words of all versions (see scripts/setup).
LAUNCH = {
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
    "OMPI_MCA_orte_execute_quiet": "1",
    "OMPI_MCA_btl": "^tcp",
    **({"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"} if os.geteuid() == 0 else {}),
}


def launched_ranks() -> int:
    """How many ranks mpirun started: Open MPI's or MPICH's word for it, 0 without mpirun."""
    return int(os.environ.get("OMPI_COMM_WORLD_SIZE") or os.environ.get("PMI_SIZE") or 0)


def bare_environment() -> dict[str, str]:
    """The environment for a process that is not to take itself for one of this process's ranks."""
    launchers = ("OMPI_", "PMI", "PRTE_", "SLURM_")
    return {name: value for name, value in os.environ.items() if not name.startswith(launchers)}


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--share-cases", action="store_true", help="2, 3 and 4 ranks each run a third of a test's cases")


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    launched = launched_ranks() or WORLD.size
    if launched != WORLD.size:
        raise pytest.UsageError(
            f"mpirun started {launched} ranks but mpi4py sees {WORLD.size}: they belong to different MPIs"
        )
    if WORLD.rank > 0:
        config.option.xmlpath = None
        # pytest's reporter, which starts after this, keeps what it finds here.
        sys.stdout = open(os.devnull, "w")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if WORLD.size == 1:
        return
    chosen = [item.nodeid for item in items if item.get_closest_marker("mpi") is not None]
    names = set(third(chosen, WORLD.size % 3) if config.option.share_cases else chosen)
    config.hook.pytest_deselected(items=[item for item in items if item.nodeid not in names])
    items[:] = [item for item in items if item.nodeid in names]


def third(names: Sequence[str], part: int) -> list[str]:
    """Of each test a third of its cases (part 0, 1 or 2), mixed but always alike; of tests of one case a third."""
    cases = defaultdict(list)
    for name in names:
        cases[name.partition("[")[0]].append(name)
    chosen = []
    for test, group in cases.items():
        # Tests begin in different parts, or one part would have all those of one case.
        mixed = sorted(group, key=lambda name: zlib.crc32(name.encode()))
        chosen += mixed[(part - zlib.crc32(test.encode())) % 3 :: 3]
    return chosen


def pytest_collection_finish(session: pytest.Session) -> None:
    names = GUARD.allgather([item.nodeid for item in session.items])
    for rank, other in enumerate(names):
        if other != names[0]:
            differing = sorted(set(other) ^ set(names[0])) or ["the same tests in another order"]
            raise pytest.UsageError(f"ranks 0 and {rank} collected different tests: {differing[0]}")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if WORLD.size > 1:
        _agree(item, report)
    return report


def _agree(item: pytest.Item, report: pytest.TestReport) -> None:
    """Makes `report` a failure, with the tracebacks, unless all ranks passed or all skipped. Collective."""
    outcome = {"passed": PASSED, "skipped": SKIPPED, "failed": FAILED}[report.outcome]
    mine = np.array([outcome, -outcome])
    extremes = np.empty_like(mine)
    request = GUARD.Iallreduce(mine, extremes, op=MPI.MAX)
    patience = PATIENCE_AFTER_FAILURE if outcome == FAILED else PATIENCE
    if not _completed(request, patience):
        # The others are inside a collective call that this rank will never join: nothing can go on.
        print(f"\n{item.nodeid}: the other ranks did not come within {patience:.0f} s", file=sys.__stderr__)
        print(_told(report), file=sys.__stderr__, flush=True)
        WORLD.Abort(1)
    worst, best = extremes[0], -extremes[1]
    if worst == FAILED or worst != best:
        told = GUARD.allgather(None if outcome == PASSED else _told(report))
        report.outcome = "failed"
        report.longrepr = "\n\n".join(text for text in told if text)


def _completed(request: MPI.Request, patience: float) -> bool:
    """Whether a request completes within so many seconds, asked without keeping a core busy."""
    deadline = time.monotonic() + patience
    while not request.Test():
        if time.monotonic() > deadline:
            return False
        time.sleep(1e-3)
    return True


def _told(report: pytest.TestReport) -> str:
    """What happened on this rank: a line, then the traceback."""
    crash = getattr(report.longrepr, "reprcrash", None)
    why = f": {crash.message.splitlines()[0]}" if crash else ""
    where = f"{report.outcome} on rank {WORLD.rank} of {WORLD.size} ({report.when})"
    return f"{where}{why}\n{report.longreprtext}"


@pytest.hookimpl(trylast=True)
def pytest_unconfigure() -> None:
    # A rank that ends with failed tests ends all: rank 0 must have written its report by then.
    _completed(GUARD.Ibarrier(), PATIENCE_AFTER_FAILURE)


@pytest.fixture(autouse=True)
def _log_as_imported() -> None:
    """The command line keeps the log to itself: a later test, or one with a fixture that ran it, would hear nothing."""
    log = logging.getLogger("piezomat")
    log.setLevel(logging.NOTSET)
    log.propagate, log.handlers = True, []


@pytest.fixture(autouse=True)
def seeded() -> None:
    """Every test starts from the same random numbers, on every rank."""
    random.seed(SEED)
    np.random.seed(SEED)  # noqa: NPY002 - libraries may use the global generator


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fixed seed, the same on every rank."""
    return np.random.default_rng(SEED)


@pytest.fixture
def comm() -> MPI.Comm:
    """The communicator of all ranks."""
    return WORLD


@pytest.fixture
def shared_tmp_path(tmp_path_factory: pytest.TempPathFactory, comm: MPI.Comm) -> Path:
    """An empty directory that is the same on all ranks. Collective."""
    path = tmp_path_factory.mktemp("shared") if comm.rank == 0 else None
    return comm.bcast(path)


@pytest.fixture
def mpirun() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs Python with these arguments on so many ranks and gives back what it said: mpirun(2, "-m", "app").

    Keywords go on to subprocess.run. For tests that are not parallel themselves; one rank's error ends all.
    """
    environment = bare_environment() | LAUNCH

    def run(ranks: int, *arguments: str | Path, **keywords: Any) -> subprocess.CompletedProcess[str]:
        command = ["mpirun", "-n", str(ranks), sys.executable, "-m", "mpi4py"]
        options = {"env": environment, "stdin": subprocess.DEVNULL, "capture_output": True, "text": True}
        return subprocess.run([*command, *arguments], **(options | keywords))

    return run
