"""What a nonlinear solve came to: its effort, or the reason why there is no solution."""

from __future__ import annotations

from dataclasses import dataclass, field

SINGULAR = "the tangent matrix is singular: something can move, or charge up, without resistance"


class SolveError(RuntimeError):
    """A load level could not be solved; the message is the reason in words. Raised on all ranks."""


@dataclass
class NewtonReport:
    """Effort of the solution of one load level.

    iterations: Newton iterations, the start value counted as one; krylov: iterations of the Krylov solver, a direct
    solve counted as one; residuals: relative residual at each iteration. With a condensed bulk, factor_solves: solves
    with the factors of the bulk on this rank; candidates: nodes that the bulk is condensed to, at the end.
    """

    iterations: int = 0
    krylov: int = 0
    residuals: list[float] = field(default_factory=list)
    factor_solves: int = 0
    candidates: int = 0
