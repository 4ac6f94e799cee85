"""What a nonlinear solve came to: its effort, or the reason why there is no solution."""

from __future__ import annotations

from dataclasses import dataclass, field

FAR = 0.1  # relative residual at which a state is far from any equilibrium
# Iterations far from equilibrium, in one solve, after which rounding may pick where they lead. Shipped scenes take at
# most 3; the tips of a C that are driven past each other take 8, took up to 21, and ended elsewhere on two ranks.
WANDERING = 6
ERRATIC = (
    "of several equilibria rounding may have picked one in steps {steps}: Newton's method wandered far from any before "
    "it converged; take smaller steps, or compare runs on different numbers of ranks"
)
SINGULAR = "the tangent matrix is singular: something can move, or charge up, without resistance"


class LibraryError(RuntimeError):
    """PETSc, or a library that it calls, gave up; the message has its words. It may be raised on one rank alone."""


class SolveError(RuntimeError):
    """A load level could not be solved; the message is the reason in words. Raised on all ranks."""


@dataclass
class NewtonReport:
    """Effort of the solution of one load level.

    iterations: Newton iterations, the start value counted as one; linear_solves: with the tangent, those of the active-
    set prediction included; krylov: iterations of the Krylov solver, a direct solve counted as one; residuals: relative
    residual at each iteration. With a condensed bulk, factor_solves: solves with the factors of the bulk on this rank;
    candidates: nodes that the bulk is condensed to, at the end. wandering: iterations of the last solve that converged
    whose relative residual was above `FAR`.
    """

    iterations: int = 0
    linear_solves: int = 0
    krylov: int = 0
    residuals: list[float] = field(default_factory=list)
    factor_solves: int = 0
    candidates: int = 0
    wandering: int = 0

    def add(self, krylov: int, *, iterations: int = 0, linear_solves: int = 1) -> None:
        """Add linear solves, the iterations of the Krylov solver in them, and the Newton iterations that they made."""
        self.iterations += iterations
        self.linear_solves += linear_solves
        self.krylov += krylov

    def add_condensed(self, factor_solves: int, candidates: int) -> None:
        """Add what a solve took of a condensed bulk."""
        self.factor_solves += factor_solves
        self.candidates = candidates

    def note_converged(self, first: int) -> None:
        """Note that the solve has converged whose first residual has this index."""
        self.wandering = sum(residual > FAR for residual in self.residuals[first:])
