"""What ends a load step before it converges: a bound on its Newton iterations, and a signal that asks for the end."""

from __future__ import annotations

from collections.abc import Callable

# Newton iterations of one load step, with those of failed tries. Shipped scenes take at most 40, snapping bonds
# 256 (fibers_2d with adhesion.strength = 120); a load that nothing can carry took 20,000 without an end.
MAX_ITERATIONS = 2000


class StepAbandoned(RuntimeError):
    """A load step has ended before it converged, and is not tried in smaller parts. Raised on all ranks."""


class TooManyIterations(StepAbandoned):
    """The load step has used up its Newton iterations; the message says what it was at."""


class StopRequested(StepAbandoned):
    """A signal asks for the end of the run; the message says where it came."""


class StepWatch:
    """Counts the Newton iterations of a load step, and ends it at a bound or where a stop is requested.

    stop_requested: whether a signal has come, the same on all ranks; collective, one allreduce an iteration.
    show: receives a line on the present step in each iteration; on any rank, not collective.
    iterations: of the present step so far. Nothing depends on time: a slower machine ends a step at the same iteration.
    """

    def __init__(
        self,
        stop_requested: Callable[[], bool] = lambda: False,
        show: Callable[[str], None] = lambda line: None,
        max_iterations: int = MAX_ITERATIONS,
    ) -> None:
        self.stop_requested = stop_requested
        self.show = show
        self.max_iterations = max_iterations
        self.iterations = 0
        self._step, self._tries, self._share, self._reason = 0, 0, 1.0, ""
        self._end: StepAbandoned | None = None

    def show_with(self, show: Callable[[str], None]) -> None:
        """Let `show` receive the lines from now on."""
        self.show = show

    def start(self, step: int) -> None:
        """Begin a load step, by its number."""
        self._step, self._tries, self.iterations = step, 0, 0
        self._reason, self._end = "", None

    def start_try(self, share: float) -> None:
        """Begin to solve one more part of the step, this share of it."""
        self._tries += 1
        self._share = share

    def failed(self, reason: str) -> None:
        """Note why a part of the step could not be solved."""
        self._reason = f": {reason}"

    def count(self, residual: float | None = None) -> bool:
        """Count an iteration, at this relative residual if it is known; whether the step must end. Collective."""
        self.iterations += 1
        self.show(self._described(residual))
        if self.stop_requested():
            self._end = StopRequested(f"in step {self._step}")
        elif self.iterations > self.max_iterations:
            self._end = TooManyIterations(
                f"step {self._step} has not converged in {self.max_iterations} Newton iterations, "
                f"{self._tries} tries, the last of {_fraction(self._share)}{self._reason}"
            )
        return self._end is not None

    def end_step(self) -> None:
        """Raise StepAbandoned where the step must end."""
        if self._end is not None:
            raise self._end

    def _described(self, residual: float | None) -> str:
        left = f", relative residual {residual:.0e}" if residual is not None else ""
        return f"step {self._step}: try {self._tries}, {_fraction(self._share)}, {self.iterations} iterations{left}"


def _fraction(share: float) -> str:
    return "the whole step" if share >= 1.0 else f"1/{1.0 / share:.4g} of the step"
