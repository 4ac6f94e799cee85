"""What a solve came to: its iterations, or the reason why there is no solution."""

from __future__ import annotations

from dataclasses import dataclass, field


class SolveError(RuntimeError):
    """A load level could not be solved; the message is the reason in words. Raised on all ranks."""


@dataclass
class NewtonReport:
    """Newton iterations (the start value counts as one), Krylov iterations, and relative residuals per iteration."""

    iterations: int = 0
    krylov: int = 0
    residuals: list[float] = field(default_factory=list)
