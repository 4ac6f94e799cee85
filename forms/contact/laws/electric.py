"""What an electric law gives for a point: the capacitance per area of its gap."""

from __future__ import annotations

from typing import Protocol

from numpy.typing import NDArray

from piezomat.forms.arrays import Array

# A function of the gap with its first and second derivative, (m,) each.
WithDerivatives = tuple[Array, Array, Array]


class ElectricLaw(Protocol):
    """Capacitance c of a gap: it stores -1/2 c(g) j^2 per area at a potential jump j, so its charge is -c j."""

    @property
    def pulls(self) -> bool:
        """Whether charges pull on the surfaces."""

    @property
    def interaction_range(self) -> float:
        """Largest gap of any point with a charge, um."""

    def __getitem__(self, rows: NDArray) -> ElectricLaw: ...

    def capacitance(self, gap: Array, bonds: WithDerivatives | None) -> WithDerivatives:
        """Capacitance (m,), pC/(V um2), with derivatives, at gaps (m,) beyond that of surfaces at rest, um.

        bonds: share of the contact that bonds maintain; None without adhesion.
        """
