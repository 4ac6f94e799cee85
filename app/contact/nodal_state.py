"""At what contact is evaluated: the state of the nodes, and the mode of the evaluation."""

from __future__ import annotations

from dataclasses import dataclass

from piezomat.discretization.evaluation_mode import EvaluationMode
from piezomat.forms.arrays import Array


@dataclass(frozen=True)
class NodalState:
    """Positions and potentials of the nodes that a rank sees, and the mode of the evaluation.

    position (n, d): um
    potentials (n,): potential unknowns; times `scale` they are V. Both are None without potentials
    block_size: number of unknowns of a node
    mode: what is taken into account; viscous bonds only where there are any
    """

    position: Array
    potentials: Array | None
    block_size: int
    scale: float | None
    mode: EvaluationMode
