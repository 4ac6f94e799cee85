"""Laws of points by the materials of the two bodies that meet, of which the search alone knows the second."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from piezomat.contact.interface_laws import GapMedium, law_of_gap, normal_penalty, with_equal_potential
from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.forms.constitutive import ConstitutiveLaw
from piezomat.forms.contact.laws.law import ContactLaw
from piezomat.forms.contact.laws.medium import Medium
from piezomat.scene.sections import Contact as ContactKeys


@dataclass(frozen=True)
class PairLaws:
    """Laws with penalties by the smaller stiffness and permittivity of two bodies, each given by its kind.

    kind (bodies,): bodies with equal mean stiffness and permittivity are of one kind
    stiffness, MPa, permittivity, pC/(V um) (kinds,); the latter is zero without one
    electric: whether there is an electric contact at all
    medium: of the gaps, None without one; voltage: largest difference of prescribed potentials, V
    """

    keys: ContactKeys
    kind: Integers
    stiffness: Array
    permittivity: Array
    electric: bool
    medium: GapMedium | None
    voltage: float

    @classmethod
    def of(
        cls,
        keys: ContactKeys,
        materials: Sequence[ConstitutiveLaw],
        medium: GapMedium | None,
        voltage: float,
        *,
        electric: bool,
    ) -> PairLaws:
        """Laws of bodies of these materials. A rotation of its axes changes the means of a material by rounding."""
        means = np.array([(m.mean_stiffness, m.mean_permittivity if m.electric else 0.0) for m in materials])
        first = [int(np.isclose(means, mean, rtol=1e-9, atol=0.0).all(axis=1).argmax()) for mean in means]
        number, kind = np.unique(first, return_inverse=True)
        return cls(keys, kind, *means[number].T, electric, medium, voltage)

    @property
    def several(self) -> bool:
        """Whether there are bodies of several kinds."""
        return len(self.stiffness) > 1

    def softest(self, bodies: Iterable[int]) -> int:
        """Kind of the softest of some bodies."""
        return int(min(self.kind[sorted(bodies)], key=lambda kind: self.stiffness[kind]))

    def passes(self, slave: Integers, master: Integers) -> Booleans:
        """Whether charges pass between bodies of these kinds (m,): where one has no permittivity, none does."""
        return np.minimum(self.permittivity[slave], self.permittivity[master]) > 0.0

    def penalty(self, size: Array, slave: Integers, master: Integers) -> Array:
        """Penalty (m,), MPa/um; arguments as of `at`."""
        return normal_penalty(self.keys, size, self._least(slave, master)[0])

    def at(self, size: Array, slave: Integers, master: Integers) -> ContactLaw:
        """The law of points with these facet sizes (m,), um, on bodies of one kind (m,) that meet another (m,)."""
        stiffness, permittivity = self._least(slave, master)
        law = law_of_gap(self.keys, normal_penalty(self.keys, size, stiffness))
        if not self.electric:
            return law
        if self.medium is None:
            return with_equal_potential(law, self.keys, self.voltage, size, stiffness, permittivity)
        return law + self.medium.laws(size, stiffness, permittivity, law.equilibrium_gap)[1]

    def rest(self, size: Array, slave: Integers, master: Integers, rest_gap: float) -> Medium:
        """What the medium has beyond the law of points; rest_gap: of surfaces at rest, um; the others as of `at`."""
        return self.medium.laws(size, *self._least(slave, master), rest_gap)[2]

    def _least(self, slave: Integers, master: Integers) -> tuple[Array, Array]:
        """The smaller stiffness and permittivity (m,) of two kinds (m,)."""
        return (
            np.minimum(self.stiffness[slave], self.stiffness[master]),
            np.minimum(self.permittivity[slave], self.permittivity[master]),
        )
