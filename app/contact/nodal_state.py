"""The state of the nodes that contact is evaluated at, and how."""

from __future__ import annotations

from dataclasses import dataclass

from piezomat.forms.arrays import Array


@dataclass(frozen=True)
class NodalState:
    """The state that contact is evaluated at: position (n, d) of the nodes, um, and their potential unknowns (n,).

    These times `scale` are potentials, V; both are None where there are none. block_size: unknowns of a node. pulls:
    whether the electric contact pulls on the surfaces; exact: whether the tangent is; for both see
    `InterfaceLaw.respond`.
    """

    position: Array
    potentials: Array | None
    block_size: int
    scale: float | None
    attraction: bool
    consistent_tangent: bool
