"""What an evaluation takes into account: at an equilibrium all of it, on the way to one not what does harm there."""

from __future__ import annotations

from dataclasses import dataclass

from piezomat.forms.contact.laws.law import LawMode


@dataclass(frozen=True)
class EvaluationMode(LawMode):
    """Mode of an evaluation of contact.

    attraction: see `LawMode`
    consistent: whether the tangent has the geometric stiffness and the negative stiffness of the attraction
    viscous: whether viscous bonds resist their opening, where there are any
    search: whether points without a closest point at the last evaluation may get one
    """

    viscous: bool = True
    search: bool = True


COMPLETE = EvaluationMode()
