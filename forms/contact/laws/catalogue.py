"""Adhesion laws of scenes that have no history, by the name in `contact.adhesion.law`.

A law that is imported here, or added before a scene is first used, is one that a scene can have. Bonds that break are
those of `piezomat.forms.contact.laws.cohesive`.
"""

from __future__ import annotations

from collections.abc import Callable

from piezomat.forms.arrays import Array
from piezomat.forms.contact.laws.law import ContactLaw
from piezomat.forms.contact.laws.lennard_jones import LennardJones

# From strength (MPa), energy (pJ/um2) and normal penalties (m,), MPa/um, to the whole law of the gap, penalty included.
# ValueError where they do not go together.
REVERSIBLE: dict[str, Callable[[float, float, Array], ContactLaw]] = {"lennard_jones": LennardJones.of}
