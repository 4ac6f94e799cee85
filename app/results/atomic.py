"""Files that are never half-written."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

# A name that exists already, a link among them, is an error and not followed.
_NEW = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """A new file that takes the name `path` at the end, in one act.

    A process killed at any moment leaves `path` as it was or complete and on disk (fsync), never in between.
    It may leave the new file under its temporary name (`piezomat.results.folder` removes it); an exception removes it.
    OSError: it cannot be written; the error names `path`. A writer of another library must write into this file, or to
    memory: VTK and gmsh report nothing where the disk is full.
    """
    temporary = temporary_name(path)
    try:
        with os.fdopen(os.open(temporary, _NEW, 0o666), "w+b") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.filename in (None, str(temporary)):
            error.filename = str(path)
        raise
    to_disk(path.parent)


def temporary_name(path: Path) -> Path:
    """Hidden name beside `path`, with the same suffix, that nobody can foresee."""
    return path.with_name(f".{path.stem}.{secrets.token_hex(8)}.part{path.suffix}")


def write_text(path: Path, text: str) -> None:
    """Write `text` to `path` as a whole or not at all (`replacing`)."""
    with replacing(path) as file:
        file.write(text.encode())


def to_disk(path: Path) -> None:
    """Wait until the file or folder is on disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
