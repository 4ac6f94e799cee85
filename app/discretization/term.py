"""What a term of a problem is: one summand of its residual, tangent, energies and history.

A term has no say in what the others do, and the problem sums them without knowing what they are. The tangent of an
`AssembledTerm` has its places among those of the bulk. That of a `BlockTerm` has places that change, as contact has, or
that couple bodies: it comes as matrices of groups of nodes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from petsc4py import PETSc

from piezomat.discretization.evaluation_mode import COMPLETE, EvaluationMode
from piezomat.discretization.state import ReadPoints, SavedHistory
from piezomat.forms.arrays import Array, Integers


class Term:
    """A summand of a problem, by default without loads, energies and history. Every method is collective.

    phase: of the run, to which its time is counted
    is_symmetric: whether the tangent is symmetric: that of an energy is
    largest_penalty: MPa/um; the rounding of positions times it is a force out of balance
    """

    phase: str = "assembly"
    is_symmetric: bool = True
    largest_penalty: float = 0.0

    def set_loads(self, factors: dict[str, float]) -> None:
        """Go to the load level with these load factors."""

    def begin_step(self, x: PETSc.Vec) -> None:
        """Start from the converged state x."""

    def energies(self, x: PETSc.Vec) -> dict[str, float]:
        """Energies stored and dissipated at x, where the residual was evaluated last, by name, pJ (2D: pJ/um)."""
        return {}

    def add_external_forces(self, result: PETSc.Vec) -> None:
        """Add the share that forces from outside the bodies have of the last residual."""

    def commit(self) -> None:
        """Advance the history: the last evaluation is the end of a part of a step that has converged."""

    def history(self) -> Any:
        """The history at the end of the last part that has converged, never changed any more; None without one."""

    def restore(self, history: Any) -> None:
        """Return to an earlier `history`."""

    def saved(self) -> SavedHistory:
        """The history for a checkpoint."""
        return SavedHistory()

    def resume(self, read: ReadPoints, scalars: Mapping[str, float]) -> None:
        """Take up the history of a checkpoint."""


class AssembledTerm(Term, ABC):
    """A term with a matrix whose entries have places among those of the bulk: unknowns of nodes that share a cell.

    is_constant: whether the tangent is the same at any state
    """

    is_constant: bool = True

    @abstractmethod
    def add_residual(self, x: PETSc.Vec, result: PETSc.Vec) -> None:
        """Add the residual at x, at which the model's trial state is too."""

    def add_constant_residual(self, result: PETSc.Vec) -> None:
        """Add what a constant tangent times x is less than the residual at x."""

    @abstractmethod
    def add_tangent(self, matrix: PETSc.Mat) -> None:
        """Add the tangent at the model's trial state to an assembled matrix, and leave it assembled."""


class BlockTerm(Term, ABC):
    """A term whose tangent is a sum of matrices of groups of nodes, whose places change with the state.

    The places near a state are found by `detect`, and `reserve` gives those of the near future.
    """

    @abstractmethod
    def detect(self, x: PETSc.Vec, radius: float) -> None:
        """Find what may act on what at x, and until a node has moved by half of the radius, um."""

    @abstractmethod
    def add_residual(self, x: PETSc.Vec, result: PETSc.Vec, mode: EvaluationMode = COMPLETE) -> None:
        """Add the residual at x; where it cannot be evaluated the result is not a number."""

    @abstractmethod
    def linearize(self, x: PETSc.Vec, mode: EvaluationMode = COMPLETE) -> None:
        """Take the residual and the tangent at x for the methods below."""

    @abstractmethod
    def blocks(self) -> tuple[Integers, Array]:
        """The tangent: global nodes (k, n) of each group of this rank, its matrix (k, n b, n b)."""

    @abstractmethod
    def reserve(self) -> Integers:
        """Global nodes (k, n) of the groups that have a matrix or may soon have one."""

    @abstractmethod
    def add_linearized_residual(self, result: PETSc.Vec) -> None:
        """Add the residual at the state of the tangent."""

    @abstractmethod
    def add_product(self, change: PETSc.Vec, result: PETSc.Vec) -> None:
        """Add the tangent times a change of state."""
