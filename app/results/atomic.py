"""Files that are never half-written."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


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


def _to_disk(path: Path) -> None:
    """Wait until the file or folder is on disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
