"""What a term of a problem is: one summand of its residual, tangent, energies and history.

A term has no say in what the others do, and the problem sums them without knowing what they are. Contact is a `Term`
whose residual and tangent are vectors and matrices of pairs of facets, in places that change; all others are
`AssembledTerm`s.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from petsc4py import PETSc

from piezomat.discretization.state import ReadPoints, SavedHistory


class Term:
    """A summand of a problem, by default without loads, energies and history. Every method is collective."""

    def set_loads(self, factors: dict[str, float]) -> None:
        """Go to the load level with these load factors."""

    def begin_step(self, x: PETSc.Vec) -> None:
        """Start from the converged state x."""

    def energies(self, x: PETSc.Vec) -> dict[str, float]:
        """Energies stored and dissipated at x, where the residual was evaluated last, by name, pJ (2D: pJ/um)."""
        return {}

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
    is_symmetric: whether the tangent is symmetric: that of an energy is
    """

    is_constant: bool = True
    is_symmetric: bool = True

    @abstractmethod
    def add_residual(self, x: PETSc.Vec, result: PETSc.Vec) -> None:
        """Add the residual at x, at which the model's trial state is too."""

    def add_constant_residual(self, result: PETSc.Vec) -> None:
        """Add what a constant tangent times x is less than the residual at x."""

    @abstractmethod
    def add_tangent(self, matrix: PETSc.Mat) -> None:
        """Add the tangent at the model's trial state to an assembled matrix, and leave it assembled."""
