"""Progress of a run: one line a load step and, on a terminal, a live bar. From rank 0 alone.

What it writes to may be closed, full or gone (`run | head`): then progress ends, and the run goes on.
"""

from __future__ import annotations

import logging
import signal
import sys
import threading
from collections.abc import Callable
from time import monotonic
from typing import Any

from mpi4py import MPI
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

from piezomat.results.log_file import is_passed_on

log = logging.getLogger("piezomat")

WAIT = 10.0  # s of a step without a line


def ignore_broken_pipes() -> None:
    """A reader that has gone is an error of the write alone. For PETSc, once it is loaded, it is a crash."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGPIPE, signal.SIG_IGN)


class Progress:
    """Context in which load steps are reported as they converge. quiet: to the log alone.

    warnings: the doubts about the results that were reported.
    """

    def __init__(self, comm: MPI.Comm, title: str, total: int, done: int, *, quiet: bool = False) -> None:
        self.warnings: list[str] = []
        self._rank = comm.rank
        self._quiet = quiet
        self._many = comm.size > 1  # mpirun shows every program a terminal, a batch job's log too
        self._title, self._total, self._done = title, total, done
        self._bar: Bar | None = None
        self._start_waiting()

    def __enter__(self) -> Progress:
        if self._rank == 0 and not self._quiet:
            ignore_broken_pipes()
            self._attempt(self._start)
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._attempt(self._bar.stop)

    def step(self, row: dict[str, Any]) -> None:
        """Report a converged step from its history row."""
        if self._rank != 0:
            return
        factors = "  ".join(
            f"{k.removeprefix('factor:')} {round(v, 4) + 0.0:+.4f}" for k, v in row.items() if k.startswith("factor:")
        )
        cut = f", cut {row['cutbacks']} times" if row["cutbacks"] else ""
        effort = f"{row['newton']} iterations, {row['linear_solves']} linear solves{cut}"
        line = f"step {row['step']:3d}/{self._total}  {factors}  {effort}  {row['seconds']:.2f} s"
        self.done(line)

    def done(self, line: str) -> None:
        """Report in one line that one of the `total` is done."""
        if self._rank != 0:
            return
        self._attempt(lambda: self._print(line))
        self._start_waiting()
        log.info("%s", line)

    def working(self, line: str) -> None:
        """Show what a long step is at: after 10 s, then at most every 10 s; in a file or pipe ever more seldom."""
        if self._rank != 0 or monotonic() < self._next:
            return
        self._attempt(lambda: self._show(line))
        self._next = monotonic() + self._wait

    def warn(self, text: str) -> None:
        """Report a doubt about the results, one sentence, once."""
        if text in self.warnings:
            return
        self.warnings.append(text)
        if self._rank != 0:
            return
        if not _prints(log):
            self._attempt(lambda: self._print(f"warning: {text}", advance=0))
        log.warning("%s", text)

    def _start(self) -> None:
        console = _Console(highlight=False)
        shape = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        self._bar = Bar(*shape, console=console, disable=self._many or not console.is_terminal, transient=True)
        self._bar.start()
        self._task = self._bar.add_task(self._title, total=self._total, completed=self._done)

    def _start_waiting(self) -> None:
        self._wait, self._next = WAIT, monotonic() + WAIT

    def _show(self, line: str) -> None:
        if self._bar is None:
            return
        if self._bar.disable:
            self._print(f"  {line}", advance=0)
            self._wait *= 2.0  # a night's log stays short
        else:
            self._bar.update(self._task, description=f"{self._title} ({line})")

    def _print(self, line: str, advance: int = 1) -> None:
        if self._bar is not None:
            self._bar.console.print(line, markup=False, soft_wrap=True)
            self._bar.console.file.flush()
            self._bar.update(self._task, advance=advance, description=self._title)

    def _attempt(self, write: Callable[[], object]) -> None:
        """Write, unless that fails: then nothing more is written."""
        try:
            write()
        except (OSError, ValueError, AttributeError) as error:  # gone or full; closed by Python; never opened
            self._bar = None
            log.warning("no more progress on the terminal: %s", error)


def _prints(logger: logging.Logger | None) -> bool:
    """Whether logging itself shows the warnings of a logger on the terminal, as it does in a program of its own."""
    heard = False
    while logger is not None:
        for handler in logger.handlers:
            heard = True
            if getattr(handler, "stream", None) in (sys.stderr, sys.stdout) and handler.level <= logging.WARNING:
                return True
        logger = logger.parent if logger.propagate or is_passed_on(logger) else None
    return not heard  # by the handler of last resort


class _Console(Console):
    """A console whose reader may go away."""

    def on_broken_pipe(self) -> None:
        """Raise what rich has caught, which else ends the process."""
        raise
