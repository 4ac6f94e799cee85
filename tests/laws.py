"""Laws of contact points, taken apart."""

from __future__ import annotations

from typing import TypeVar

from piezomat.forms.contact.laws.law import ContactLaw

Law = TypeVar("Law", bound=ContactLaw)


def summand(law: ContactLaw, kind: type[Law]) -> Law:
    """The only summand of this kind."""
    (found,) = (part for part in law.summands() if isinstance(part, kind))
    return found
