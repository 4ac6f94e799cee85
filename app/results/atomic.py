"""Files that are never half-written, and work of rank 0 whose failure every rank learns of."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from mpi4py import MPI

T = TypeVar("T")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Temporary path beside `path`; what is written there takes the name `path` at the end, in one act.

    A process killed at any moment leaves `path` as it was or complete and on disk (fsync), never in between.
    It may leave the temporary file, which the next writer overwrites; an exception removes it. OSError: it
    cannot be written, or nothing was (VTK does not raise).
    """
    temporary = temporary_name(path)
    try:
        yield temporary
        _to_disk(temporary)
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    _to_disk(path.parent)


def temporary_name(path: Path) -> Path:
    """Hidden name beside `path` with the same suffix (writers choose the format by it)."""
    return path.with_name(f".{path.stem}.part{path.suffix}")


def write_text(path: Path, text: str) -> None:
    """Write `text` to `path` as a whole or not at all (`replacing`)."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def on_root(comm: MPI.Comm, action: Callable[[], T]) -> T:
    """What `action()` returns on rank 0, on every rank. Collective.

    An exception of `action` is raised on every rank, so that no rank waits for one that has failed.
    """
    result: T | None = None
    failure: Exception | None = None
    if comm.rank == 0:
        try:
            result = action()
        except Exception as error:
            failure = _portable(error)
    result, failure = comm.bcast((result, failure))
    if failure is not None:
        raise failure
    return result  # type: ignore[return-value]


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
    """The exception, or its words alone if it cannot be sent to other ranks."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def _to_disk(path: Path) -> None:
    """Wait until the file or folder is on disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
