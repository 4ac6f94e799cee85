"""The state of the nodes at which contact is evaluated, and what of its law and tangent is taken into account."""

from __future__ import annotations

from dataclasses import dataclass

from piezomat.forms.arrays import Array


@dataclass(frozen=True)
class NodalState:
    """Positions and potentials of the nodes that a rank sees, and the mode of the evaluation.

    position (n, d): um
    potentials (n,): potential unknowns; times `scale` they are V. Both are None without potentials
    block_size: number of unknowns of a node
    attraction: whether the electric contact pulls on the surfaces, see `InterfaceLaw.respond`
    consistent_tangent: whether the tangent has the geometric stiffness and the negative stiffness of the attraction
    """

    position: Array
    potentials: Array | None
    block_size: int
    scale: float | None
    attraction: bool
    consistent_tangent: bool
