"""The files of a run in its folder: history, summary, fields, contact points, log.

A file that others read is either absent, as it was, or complete, also when the process is killed: tables and
indices are replaced in one act, and an index names a step's pieces only once every rank has written its own.
"""

from __future__ import annotations

import csv
import io
import json
import logging
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from mpi4py import MPI

from piezomat.meshes.parallel import on_all, on_root
from piezomat.results.atomic import replacing, to_disk, write_text
from piezomat.results.folder import CHECKPOINT, FIBERS, MESH, PIECES, remove_results, remove_unfinished
from piezomat.results.log_file import LogFile
from piezomat.results.pairs_table import pairs_until
from piezomat.results.summary import summary
from piezomat.results.vtk import (
    PIECE,
    ContactPoints,
    FieldPiece,
    IndexEntry,
    ResultsError,
    read_index,
    write_index,
    xml,
)

Value = float | int | str
T = TypeVar("T")
log = logging.getLogger("piezomat")


class OutputError(OSError):
    """A file of the results cannot be written; the message says which and why. Raised on all ranks."""


class Results:
    """The files of one run in the folder `out`, which the caller holds (`piezomat.results.folder`).

    Every method but `close` is collective over `comm`, and only rank 0 writes shared files. An error on one rank
    is raised on all. OutputError: a file cannot be written; those that were complete are as they were.

    rows: the rows of history.csv, the same on all ranks.
    """

    def __init__(self, out: Path, comm: MPI.Comm) -> None:
        self.out = Path(out)
        self.comm = comm
        self.rows: list[dict[str, Value]] = []
        self._columns: list[str] = []
        self._pairs: str | None = None
        self._log: LogFile | None = None

    def __enter__(self) -> Results:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def start(
        self, scene_text: str, columns: Sequence[str], mesh: Path | None = None, table: Path | None = None
    ) -> None:
        """Make the folder, remove an older run's files (nothing else), write scene.toml, open the log.

        mesh: the mesh, complete and in the folder under a temporary name; it is moved to the checkpoints. table: a
        table of fibers, which is copied there.
        """
        self._columns, self.rows = list(columns), []

        def begin() -> None:
            self.out.mkdir(parents=True, exist_ok=True)
            remove_results(self.out, mesh)
            write_text(self.out / "scene.toml", scene_text)
            self._write_history([])
            self._open_log()
            self._keep_inputs(mesh, table)

        self._on_root(begin)

    def resume(
        self,
        columns: Sequence[str],
        last_step: int,
        rows: Sequence[Mapping[str, Value]] | None = None,
        scene_text: str = "",
    ) -> None:
        """Go on after `last_step`: what came before is kept, later rows and pieces are removed.

        `rows` (a checkpoint's) take the place of those in history.csv, which then need not exist. A damaged index is
        made anew from the pieces, and of a damaged pairs.csv the sound rows are kept. A missing scene.toml is written.
        ResultsError: other columns than those given, or no row of `last_step`; nothing has been removed then.
        """
        self._columns = list(columns)

        def begin() -> list[dict[str, Value]]:
            path = self.out / "history.csv"
            if rows is not None:
                known: Sequence[Mapping[str, Value]] = rows
            else:
                known = read_history(path) if last_step > 0 else []
            kept = [dict(row) for row in known if int(row["step"]) <= last_step]
            if last_step > 0 and (not kept or kept[-1]["step"] != last_step):
                raise ResultsError(f"{path} has no row of step {last_step}, after which the run goes on")
            for row in kept:
                self._check(row)
            self._open_log()
            remove_unfinished(self.out)
            if not (self.out / "scene.toml").exists():
                write_text(self.out / "scene.toml", scene_text)
            if (self.out / "pairs.csv").exists():
                self._pairs = pairs_until(self.out / "pairs.csv", last_step)
                write_text(self.out / "pairs.csv", self._pairs)
            self._write_history(kept)
            for folder in PIECES:
                self._forget(folder, last_step)
            for name in ("summary.json", "picture.png", "report.txt", "report.html", "report.json"):
                (self.out / name).unlink(missing_ok=True)
            return kept

        self.rows = self._on_root(begin)

    def row(self, values: Mapping[str, Value]) -> None:
        """Append rank 0's row to history.csv, on disk on return; ResultsError: keys not the columns."""

        def append() -> dict[str, Value]:
            self._check(values)
            row = {name: _plain(values[name]) for name in self._columns}
            self._write_history([*self.rows, row])
            return row

        self.rows.append(self._on_root(append))

    def pairs(self, step: int, columns: Sequence[str], rows: Sequence[tuple[str, Sequence[float]]]) -> None:
        """Append the pairs of bodies in contact at the end of a step, (name, values), to pairs.csv."""

        def append() -> None:
            text = io.StringIO()
            table = csv.writer(text, lineterminator="\n")
            if not self._pairs:
                table.writerow(["step", "pair", *columns])
            table.writerows([step, name, *(float(v) for v in values[: len(columns)])] for name, values in rows)
            whole = (self._pairs or "") + text.getvalue()
            write_text(self.out / "pairs.csv", whole)
            self._pairs = whole

        self._on_root(append)

    def fields(self, step: int, stage_time: float, piece: FieldPiece) -> None:
        """Write each rank's fields of a step, and name them in fields.pvd at the time `stage_time`."""
        self._write_pieces("fields", step, stage_time, piece)

    def contact(self, step: int, points: ContactPoints, stage_time: float | None = None) -> None:
        """Write each rank's contact points of a step, and name them in contact.pvd (at `step` by default)."""
        self._write_pieces("contact", step, step if stage_time is None else stage_time, points)

    def summary(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Write summary.json, see `piezomat.results.summary`; what it holds, with the rows of the history."""
        content = summary(self.comm, self.rows, values)

        def write() -> None:
            text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)
            write_text(self.out / "summary.json", text + "\n")

        self._on_root(write)
        return content

    def close(self) -> None:
        """Close the log file. Not collective."""
        if self._log is not None:
            self._log.detach(log)
            self._log.close()
            self._log = None

    def _keep_inputs(self, mesh: Path | None, table: Path | None) -> None:
        folder = self.out / CHECKPOINT
        if mesh is not None:
            folder.mkdir(exist_ok=True)
            os.replace(mesh, folder / MESH)
            to_disk(folder)
        if table is not None:
            with table.open("rb") as original, replacing(folder / FIBERS) as copy:
                shutil.copyfileobj(original, copy)

    def _open_log(self) -> None:
        """Log to log.txt, behind what is there."""
        self.close()
        self._log = LogFile(self.out / "log.txt")
        self._log.attach(log)

    def _on_root(self, action: Callable[[], T]) -> T:
        """`on_root` of an action that writes. Raises OutputError."""
        with self._named_errors():
            return on_root(self.comm, action)

    @contextmanager
    def _named_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            file = f"{error.filename}: " if error.filename else ""
            raise OutputError(f"cannot write results in {self.out}: {file}{error.strerror or error}") from error

    def _check(self, row: Mapping[str, Value]) -> None:
        wrong = sorted(set(row) ^ set(self._columns))
        if wrong:
            raise ResultsError(f"columns of the history that are missing or unknown: {', '.join(wrong)}")

    def _write_history(self, rows: Sequence[Mapping[str, Value]]) -> None:
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        table.writerow(self._columns)
        # csv writes a float by repr(), which reads back as the same number
        table.writerows([row[name] for name in self._columns] for row in rows)
        write_text(self.out / "history.csv", text.getvalue())

    def _write_pieces(self, folder: str, step: int, time: float, piece: FieldPiece | ContactPoints) -> None:
        # a rank that has nothing writes nothing; where no rank has anything, rank 0 writes an empty piece
        sizes = self.comm.allgather(len(piece))
        writers = [rank for rank, size in enumerate(sizes) if size] or [0]
        names = {rank: f"{folder}/step_{step:04d}_rank_{rank:04d}.{PIECES[folder]}" for rank in writers}
        self._on_root(lambda: (self.out / folder).mkdir(exist_ok=True))

        def write() -> None:
            if self.comm.rank in names:
                with replacing(self.out / names[self.comm.rank]) as file:
                    file.write(xml(piece.vtk()))

        with self._named_errors():
            on_all(self.comm, write)

        def name() -> None:
            index = self.out / f"{folder}.pvd"
            entry = IndexEntry(step, float(time), tuple(Path(name) for name in names.values()))
            write_index(index, [e for e in read_index(index) if e.step != step] + [entry])

        self._on_root(name)

    def _forget(self, folder: str, last_step: int) -> None:
        """Remove the pieces of later steps, the index first."""
        index = self.out / f"{folder}.pvd"
        if index.exists():
            try:
                entries = read_index(index)
            except ResultsError as error:
                log.warning("%s; it is made anew from the pieces in %s", error, folder)
                entries = _entries_of(self.out, folder)
            write_index(index, [entry for entry in entries if entry.step <= last_step])
        pieces = [(PIECE.fullmatch(file.name), file) for file in _pieces(self.out, folder)]
        for match, file in pieces:
            if int(match["step"]) > last_step:
                file.unlink()
        if pieces and not any((self.out / folder).iterdir()):
            (self.out / folder).rmdir()


def _pieces(out: Path, folder: str) -> list[Path]:
    there = sorted((out / folder).iterdir()) if (out / folder).is_dir() else []
    return [file for file in there if PIECE.fullmatch(file.name) and file.is_file()]


def _entries_of(out: Path, folder: str) -> list[IndexEntry]:
    """The index of the pieces that are there; the time of a step is its number."""
    steps: dict[int, list[Path]] = {}
    for file in _pieces(out, folder):
        steps.setdefault(int(PIECE.fullmatch(file.name)["step"]), []).append(file.relative_to(out))
    return [IndexEntry(step, float(step), tuple(files)) for step, files in steps.items()]


def read_history(path: Path) -> list[dict[str, Value]]:
    """Rows of a history.csv, numbers as numbers. ResultsError: it is absent or not a history."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        history = [{name: _number(text) for name, text in row.items()} for row in rows]
    except FileNotFoundError as error:
        raise ResultsError(f"there is no {path}") from error
    except (TypeError, ValueError) as error:
        raise ResultsError(f"{path} is not a history: {error}") from error
    if not all(isinstance(row.get("step"), int) for row in history):
        raise ResultsError(f"{path} is not a history: a row has no number of a step")
    return history


def _plain(value: Value) -> Value:
    """The value with numpy's and boolean numbers as Python's own, whose repr is the number alone."""
    if isinstance(value, (bool, np.bool_, np.integer)):
        return int(value)
    return float(value) if isinstance(value, np.floating) else value


def _number(text: str | None) -> Value:
    """The entry as the number that was written, if it is one: a float's repr() never reads as an integer."""
    if text is None:
        raise ValueError("a row is too short")
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text
