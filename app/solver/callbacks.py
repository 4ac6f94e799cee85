"""Exceptions in what PETSc calls back: those after which a run goes on do not pass through PETSc.

They would leave its vectors locked for good (3.22; not 3.18), and the step could not be tried again in parts. Instead
the first one is kept, and raised when PETSc has returned. Until then callbacks do nothing, and results are not numbers,
at which PETSc ends its solve by itself. This takes all ranks: only what is raised on all of them is kept. Any other
exception passes at once, for it may be of one rank alone, the others waiting for it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from petsc4py import PETSc

from piezomat.solver.outcome import SolveError
from piezomat.solver.step_watch import StepAbandoned


class CallbackErrors:
    """The first exception of callbacks on this rank since PETSc was called."""

    def __init__(self) -> None:
        self._error: BaseException | None = None

    def call(self, function: Callable[..., Any], instead: Callable[..., Any], *arguments: Any) -> Any:
        """function(*arguments), or `instead` of it where an exception is kept. Not collective."""
        if self._error is None:
            try:
                return function(*arguments)
            except BaseException as error:
                self._error = error
                if not isinstance(error, SolveError | StepAbandoned):
                    raise
        return instead(*arguments)

    @contextmanager
    def raised(self) -> Iterator[None]:
        """Context of a call of PETSc, at whose end a callback's exception is raised. Not collective.

        It is raised in place of the error that PETSc makes of one that passes (3.22).
        """
        try:
            yield
        finally:
            error, self._error = self._error, None
            if error is not None:
                raise error


def nothing(*arguments: Any) -> None:
    """Do nothing."""


def not_numbers(*arguments: Any) -> None:
    """Fill the result, a callback's last argument."""
    result: PETSc.Vec = arguments[-1]
    result.set(np.nan)


def callback(instead: Callable[..., Any]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorator of a method that PETSc calls, of a class with `callback_errors`: these keep its exception.

    instead: is called with the method's arguments in place of it once there is one.
    """

    def decorate(method: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(method)
        def called(self: Any, *arguments: Any) -> Any:
            return self.callback_errors.call(method, instead, self, *arguments)

        return called

    return decorate
