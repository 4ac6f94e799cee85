"""At what contact is evaluated: the state of the nodes, and what of its law and tangent is taken into account."""

from __future__ import annotations

from dataclasses import dataclass

from piezomat.forms.arrays import Array
from piezomat.forms.contact.laws.law import LawMode


@dataclass(frozen=True)
class EvaluationMode(LawMode):
    """What an evaluation takes into account: at an equilibrium all of it, on the way to one not what does harm there.

    attraction: see `LawMode`
    consistent: whether the tangent has the geometric stiffness and the negative stiffness of the attraction
    viscous: whether viscous bonds resist their opening, where there are any
    search: whether points without a closest point at the last evaluation may get one
    """

    viscous: bool = True
    search: bool = True


COMPLETE = EvaluationMode()


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
