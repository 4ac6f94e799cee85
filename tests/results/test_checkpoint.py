"""Checkpoints: exact, independent of the number of ranks, and whole whenever the process is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import piezomat.results.checkpoint
from piezomat.results.checkpoint import CheckpointError, load, save
from tests.conftest import bare_environment

NODES = 1000
POINTS = 300
# values whose decimal text would not do: denormal, signed zero, infinite, not a number
AWKWARD = (5e-324, -0.0, 0.1, 1 / 3, np.inf, np.nan, -1.7976931348623157e308)
SCALARS = {
    "stage": 2,
    "increment": 0.1 + 0.2,
    "history": [{"step": 1, "force_x@top": -1e-300}],
    "title": "fiber",
}


@pytest.fixture(autouse=True)
def small_slices(monkeypatch: pytest.MonkeyPatch) -> None:
    """Several slices a rank also in these small cases."""
    monkeypatch.setattr(piezomat.results.checkpoint, "SLICE", 64)


def state(step: int = 0) -> tuple[Any, Any, Any, Any]:
    """Node numbers, nodal values (n, 3), point keys (m, 4), point values (m, 2), the same on every rank."""
    rng = np.random.default_rng(7)
    ids = rng.permutation(10 * NODES)[:NODES].astype(np.int64)
    values = rng.standard_normal((NODES, 3)) + step
    values[: len(AWKWARD), 1] = AWKWARD
    keys = np.unique(rng.integers(-3, 8, (POINTS, 4)), axis=0)[rng.permutation(250)]
    return ids, values, keys.astype(np.int64), rng.standard_normal((len(keys), 2)) + step


def save_part(comm: MPI.Comm, folder: Path, step: int = 3, **changes: Any) -> None:
    """Save `state`, the nodes dealt out in one way and the points in another."""
    ids, values, keys, damage = state()
    owner = (ids * 7919) % comm.size
    mine = owner == comm.rank
    last = np.arange(len(keys)) % (comm.size + 1) == comm.rank + 1  # rank 0 has the rest too
    if comm.rank == 0:
        last |= np.arange(len(keys)) % (comm.size + 1) == 0
    nodal = {"solution": (ids[mine], values[mine]), "flag": (ids[mine], ids[mine] % 3 == 0)}
    save(comm, folder, step, nodal, {"damage": (keys[last], damage[last])}, SCALARS, **changes)


def same_bits(a: Any, b: Any) -> bool:
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def check_whole(comm: MPI.Comm, folder: Path) -> None:
    """Load what `save_part` wrote, each rank asking for other nodes, some of them twice."""
    ids, values, keys, damage = state()
    checkpoint = load(comm, folder)
    assert checkpoint.scalars == SCALARS
    wanted = np.random.default_rng(comm.rank).integers(0, NODES, 700)
    if comm.rank == comm.size - 1 and comm.size > 1:
        wanted = wanted[:0]
    assert same_bits(checkpoint.nodal("solution", ids[wanted]), values[wanted])
    assert same_bits(checkpoint.nodal("flag", ids[wanted]), ids[wanted] % 3 == 0)
    asked = np.vstack([keys[::2], keys[:3] + 100, keys[:1]])
    got, found = checkpoint.points("damage", asked)
    expected = np.vstack([damage[::2], np.zeros((3, 2)), damage[:1]])
    assert same_bits(got, expected)
    assert found.tolist() == [True] * len(keys[::2]) + [False] * 3 + [True]


@pytest.mark.mpi
def test_round_trip_is_exact(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    save_part(comm, shared_tmp_path)
    check_whole(comm, shared_tmp_path)


@pytest.mark.mpi
def test_number_of_ranks_may_change(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    parts = comm.Split(comm.rank == 0, comm.rank)
    save_part(comm, shared_tmp_path / "all")
    if comm.rank == 0:
        check_whole(parts, shared_tmp_path / "all")
        save_part(parts, shared_tmp_path / "one")
    comm.barrier()
    check_whole(comm, shared_tmp_path / "one")
    parts.Free()


@pytest.mark.mpi
def test_the_two_newest_are_kept(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    if comm.rank == 0:
        (shared_tmp_path / "mesh.msh").write_text("mesh")
        (shared_tmp_path / "step_20000.npz").write_text("later than the step that a run goes on from")
    for step in (2, 3, 12345):
        save_part(comm, shared_tmp_path, step)
    files = ["mesh.msh", "step_0003.npz", "step_12345.npz"]
    assert sorted(file.name for file in shared_tmp_path.iterdir()) == files
    assert load(comm, shared_tmp_path).step == 12345


@pytest.mark.mpi
def test_empty_tables(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    points = {"damage": (np.empty((0, 4), np.int64), np.empty((0, 2)))}
    save(comm, shared_tmp_path, 0, {}, points, {})
    checkpoint = load(comm, shared_tmp_path)
    values, found = checkpoint.points("damage", np.zeros((2, 4), np.int64))
    assert values.shape == (2, 2) and not found.any()
    values, found = checkpoint.points("damage", np.empty((0, 4), np.int64))
    assert values.shape == (0, 2) and found.shape == (0,)


@pytest.mark.mpi
def test_missing_and_foreign_values_are_named(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="there is no checkpoint in"):
        load(comm, shared_tmp_path / "nowhere")
    save_part(comm, shared_tmp_path)
    checkpoint = load(comm, shared_tmp_path)
    with pytest.raises(CheckpointError, match="no nodal values 'temperature'"):
        checkpoint.nodal("temperature", np.zeros(1, np.int64))
    foreign = np.array([-5] if comm.rank == 0 else [], np.int64)
    with pytest.raises(CheckpointError, match="no value of 'solution' for 1 nodes: it belongs to another mesh"):
        checkpoint.nodal("solution", foreign)


@pytest.mark.mpi
def test_ranks_that_do_not_agree_are_refused(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    ids = np.arange(3, dtype=np.int64)
    wrong = np.zeros((2, 2)) if comm.rank == comm.size - 1 else np.zeros((3, 2))
    with pytest.raises(ValueError, match="cannot save: nodal 'u'"):
        save(comm, shared_tmp_path, 1, {"u": (ids, wrong)}, {}, {})
    if comm.size > 1:
        name = "u" if comm.rank else "v"
        with pytest.raises(ValueError, match="cannot save: the ranks give different arrays"):
            save(comm, shared_tmp_path, 1, {name: (ids, np.zeros(3))}, {}, {})


@pytest.mark.mpi
@pytest.mark.parametrize("moment", ["begin", "data", "replace", "json"])
def test_failure_to_write_reaches_every_rank_and_keeps_the_last(
    comm: MPI.Comm, shared_tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    save_part(comm, shared_tmp_path, 3)
    seen = 0

    def full(*args: Any, **kwargs: Any) -> Any:
        raise OSError(28, "No space left on device")

    def full_later(*args: Any, **kwargs: Any) -> Any:
        nonlocal seen
        seen += 1
        return full() if seen == 3 else header(*args, **kwargs)

    header = np.lib.format.write_array_header_1_0
    with monkeypatch.context() as patch:
        if moment == "begin":
            patch.setattr("zipfile.ZipFile.writestr", full)
        elif moment == "data":
            patch.setattr(np.lib.format, "write_array_header_1_0", full_later)
        elif moment == "replace":
            patch.setattr(os, "replace", full)
        else:
            patch.setitem(SCALARS, "impossible", object())
        error: Any = TypeError if moment == "json" else CheckpointError
        with pytest.raises(error, match="cannot"):
            save_part(comm, shared_tmp_path, 4)
    assert [file.name for file in shared_tmp_path.iterdir()] == ["step_0003.npz"]
    check_whole(comm, shared_tmp_path)


def test_damaged_files_are_refused_or_give_the_saved_values(tmp_path: Path, comm: MPI.Comm) -> None:
    save_part(comm, tmp_path)
    file = tmp_path / "step_0003.npz"
    whole = file.read_bytes()
    ids, values, _, _ = state()
    rng = np.random.default_rng(1)
    damaged = [whole[:cut] for cut in rng.integers(0, len(whole), 20)]
    for place in rng.integers(0, len(whole), 60):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << int(rng.integers(8))
        damaged.append(bytes(flipped))
    refused = 0
    for data in damaged:
        file.write_bytes(data)
        try:
            assert same_bits(load(comm, tmp_path).nodal("solution", ids), values)
        except CheckpointError as error:
            assert "is damaged or not a checkpoint" in str(error)
            refused += 1
    assert refused > 70  # a flipped bit in a date or attribute of the archive does no harm


def test_a_sound_older_file_is_used_if_the_newest_is_damaged(tmp_path: Path, comm: MPI.Comm) -> None:
    save_part(comm, tmp_path)
    (tmp_path / "step_0009.npz").write_bytes(b"PK")
    assert load(comm, tmp_path).step == 3


def test_it_is_an_ordinary_archive(tmp_path: Path, comm: MPI.Comm) -> None:
    save_part(comm, tmp_path)
    with np.load(tmp_path / "step_0003.npz") as archive:
        ids, values, _, _ = state()
        assert np.array_equal(archive["nodal/solution/keys"], ids)
        assert same_bits(archive["nodal/solution/values"], values)


FOREVER = """
import sys
from pathlib import Path
import numpy as np
from mpi4py import MPI
from piezomat.results.checkpoint import save
ids = np.arange(20000)
print("ready", flush=True)
for step in range(1, 10**6):
    nodal = {"u": (ids, np.full((20000, 3), float(step)))}
    save(MPI.COMM_SELF, Path(sys.argv[1]), step, nodal, {}, {"at": step})
"""


def test_killed_at_any_moment(tmp_path: Path, comm: MPI.Comm) -> None:
    """A process that saves one step after the other is killed outright; its newest file is whole."""
    root = Path(__file__).resolve().parents[2]
    steps = []
    rng = np.random.default_rng(3)
    for _ in range(4):
        process = subprocess.Popen(
            [sys.executable, "-c", FOREVER, str(tmp_path)], cwd=root, env=bare_environment(), stdout=subprocess.PIPE
        )
        assert process.stdout is not None
        process.stdout.readline()
        while not any(tmp_path.glob("step_*.npz")) and process.poll() is None:
            time.sleep(0.001)
        time.sleep(float(rng.uniform(0.0, 0.1)))
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        checkpoint = load(comm, tmp_path)
        assert checkpoint.scalars == {"at": checkpoint.step}
        values = checkpoint.nodal("u", np.arange(20000))
        assert np.array_equal(values, np.full((20000, 3), float(checkpoint.step)))
        steps.append(checkpoint.step)
        for file in tmp_path.glob("step_*.npz"):
            file.unlink()
    assert min(steps) >= 1
