"""Memory of a long run, and of one run after the other: each measured in a process of its own.

Every measurement goes on with what frees the memory switched off, which must be seen.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import LAUNCH, bare_environment

ROOT = Path(__file__).parents[2]

MANY_STEPS = """
from mpi4py import MPI

from piezomat.assembly.problem import Problem
from piezomat.solver.load_steps import steps
from tests.marching import stepper_of
from tests.scenes import facing_halves

scene = facing_halves(1e5, steps=20)
mesh = scene.mesh.model_copy(update={"size": 0.076, "contact_size": 0.016})
scene = scene.model_copy(update={"mesh": mesh})
with stepper_of(scene, MPI.COMM_WORLD) as stepper:
    for step in steps(scene.load):
        stepper.advance(step, lambda part: None)
        if step.number in (4, 12, 20):
            pages = MPI.COMM_WORLD.allreduce(int(open("/proc/self/statm").read().split()[1]))
            if MPI.COMM_WORLD.rank == 0:
                print("MB", pages * 4096 / 1024**2)
        if step.number == 12:
            Problem.collect_garbage = lambda self: None
"""

MANY_RUNS = """
import gc

from mpi4py import MPI

from piezomat.solver.condensation import Condensation
from piezomat.solver.load_steps import steps
from tests.marching import stepper_of
from tests.scenes import facing_halves

gc.disable()
held = []
scene = facing_halves(1e5, steps=1)
for run in range(4):
    if run == 3:
        Condensation.close = lambda self: held.append(self)  # PETSc 3.22 would free it with Python's last reference
    with stepper_of(scene, MPI.COMM_SELF) as stepper:
        stepper.advance(next(steps(scene.load)), lambda part: None)
    del stepper
    if run > 0:
        pages = int(open("/proc/self/statm").read().split()[1])
        print("MB", pages * 4096 / 1024**2)
"""

RUNS_IN_A_ROW = """
import ctypes

from mpi4py import MPI

import piezomat as pz
from piezomat.assembly.problem import Problem

held = []
keys = {"mesh.size": 0.05, "mesh.contact_size": 0.006, "load.steps": [1, 1]}
for number in range(6):
    if number == 4:
        Problem.close = lambda self: held.append(self)
    result = pz.run("fibers_2d", keys, comm=MPI.COMM_SELF, quiet=True)
    result.grid(1), result.contact(1)
    if number in (1, 3, 5):
        ctypes.CDLL(None).malloc_trim(0)
        pages = int(open("/proc/self/statm").read().split()[1])
        print("MB", pages * 4096 / 1024**2)
"""


def growth(code: str, ranks: int = 1) -> tuple[float, float]:
    """Growth of the memory between the three that a new process prints, MB: as it is, then with what leaks."""
    mpirun = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    command = [*mpirun, sys.executable, "-m", "mpi4py", "-c", code]
    environment = bare_environment() | LAUNCH
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    first, second, third = (float(line.split()[-1]) for line in done.stdout.splitlines() if line.startswith("MB"))
    return second - first, third - second


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the memory in use is Linux's to say")
@pytest.mark.skipif(shutil.which("mpirun") is None, reason="no mpirun")
def test_memory_does_not_grow_with_the_number_of_steps() -> None:
    """What Python has released PETSc destroys when all ranks call for it: a long snap-through filled 24 GB before.

    On one rank PETSc 3.22 destroys it at once.
    """
    found, leaking = growth(MANY_STEPS, ranks=2)
    assert found < 0.8 and leaking > 1.2


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the memory in use is Linux's to say")
def test_factors_are_freed_at_the_end_of_a_run() -> None:
    """Python would collect them some time: 20 MB of 15,000 unknowns."""
    found, leaking = growth(MANY_RUNS)
    assert found < 6.0 and leaking > 12.0


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the memory in use is Linux's to say")
def test_runs_one_after_the_other_do_not_fill_the_memory() -> None:
    """Of 26,000 unknowns 35 MB a run stayed at first; 4 MB where vectors outlived their mesh's communicator."""
    found, leaking = (grown / 2 for grown in growth(RUNS_IN_A_ROW))
    assert found < 1.0 and leaking > 2.0
