"""The guard of parallel tests, tried on a test of two ranks that fail, skip or wait apart."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from tests.conftest import launched_ranks, third


@pytest.mark.mpi
def test_every_rank_runs_the_same(comm: MPI.Comm, shared_tmp_path: Path, rng: np.random.Generator) -> None:
    assert comm.size == (launched_ranks() or 1)
    seen = comm.allgather((str(shared_tmp_path), rng.random(), np.random.rand()))  # noqa: NPY002
    assert len(set(seen)) == 1
    (shared_tmp_path / str(comm.rank)).touch()
    comm.barrier()
    assert len(list(shared_tmp_path.iterdir())) == comm.size


def test_two_three_and_four_ranks_share_the_cases_of_a_test() -> None:
    tests = {"a.py::six": [f"a.py::six[{x}-{y}]" for x in "pqr" for y in (1, 2)]}
    tests["b.py::two"] = ["b.py::two[0]", "b.py::two[1]"]
    tests |= {f"c.py::one_{x}": [f"c.py::one_{x}"] for x in "abcdefgh"}
    names = [name for cases in tests.values() for name in cases]
    parts = [third(names, part) for part in range(3)]
    assert sorted(name for part in parts for name in part) == sorted(names)
    assert [sum(name.startswith("a.py::six") for name in part) for part in parts] == [2, 2, 2]
    assert sorted(sum(name.startswith("b.py::two") for name in part) for part in parts) == [0, 1, 1]
    assert all(any(name.startswith("c.py::one") for name in part) for part in parts)


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("assert comm.rank == 0; comm.barrier()", "failed on rank 1 of 2 (call): assert 1 == 0"),
        ("comm.rank == 0 or pytest.skip()", "skipped on rank 1 of 2 (call)"),
        ("comm.rank == 0 and comm.barrier()", "test_one: the other ranks did not come within 2 s"),
        ("comm.barrier()", "1 passed"),
    ],
)
def test_what_one_rank_does_is_told(
    mpirun: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path, body: str, told: str
) -> None:
    # Without the guard the first would hang: rank 0 waits in the barrier for rank 1, which has failed.
    conftest = Path(__file__).with_name("conftest.py").read_text()
    conftest = conftest.replace("AFTER_FAILURE = 30.0", "AFTER_FAILURE = 1.0").replace("= 900.0", "= 2.0")
    (tmp_path / "conftest.py").write_text(conftest)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = mpi\n")
    (tmp_path / "test_it.py").write_text(
        "import pytest\n\n"
        f"@pytest.mark.mpi\ndef test_one(comm):\n    {body}\n\n"
        "def test_not_parallel():\n    assert False\n"
    )
    run = mpirun(2, "-m", "pytest", "-q", ".", cwd=tmp_path, timeout=60)
    output = run.stdout + run.stderr
    assert told in output
    assert (run.returncode == 0) == (told == "1 passed"), output
