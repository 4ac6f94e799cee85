"""Progress of a run: one line a load step and, on a terminal, a live bar. From rank 0 alone."""

from __future__ import annotations

import logging
from typing import Any

from mpi4py import MPI
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

log = logging.getLogger("piezomat")


class Progress:
    """Context in which load steps are reported as they converge."""

    def __init__(self, comm: MPI.Comm, title: str, total: int, done: int) -> None:
        self._rank = comm.rank
        self._many = comm.size > 1  # mpirun shows every program a terminal, a batch job's log too
        self._title, self._total, self._done = title, total, done
        self._bar: Bar | None = None

    def __enter__(self) -> Progress:
        if self._rank == 0:
            console = Console(highlight=False)
            shape = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
            self._bar = Bar(*shape, console=console, disable=self._many or not console.is_terminal, transient=True)
            self._bar.start()
            self._task = self._bar.add_task(self._title, total=self._total, completed=self._done)
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def step(self, row: dict[str, Any]) -> None:
        """Report a converged step from its history row."""
        if self._bar is None:
            return
        factors = "  ".join(f"{k.removeprefix('factor:')} {v:+.4f}" for k, v in row.items() if k.startswith("factor:"))
        cut = f", cut {row['cutbacks']} times" if row["cutbacks"] else ""
        line = (
            f"step {row['step']:3d}/{self._total}  {factors}  {row['newton']} iterations{cut}  {row['seconds']:.2f} s"
        )
        self._bar.console.print(line, markup=False)
        self._bar.advance(self._task)
        log.info("%s", line)
