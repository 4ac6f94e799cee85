"""The medium in the gaps: facing surfaces are a capacitor, open or closed.

A thin gap g between surfaces has the capacitance eps/g per area. c(g) = eps / sqrt(max(g, 0)^2 + g0^2) is that law down
to gaps of g0, a few atoms, and finite in contact, where it makes the potentials equal. It has a continuous slope at
touch, which is zero there. Beyond `reach` surfaces do not count as facing: c is taken smoothly to zero before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.forms.arrays import Array
from piezomat.forms.contact.laws.electric import CapacitiveLaw, WithDerivatives, smooth_step
from piezomat.forms.contact.laws.equal_potential import stable_electric_range
from piezomat.forms.materials import VACUUM_PERMITTIVITY

CUT = 0.75  # share of the reach from which the capacitance is taken to zero
AIR = VACUUM_PERMITTIVITY  # pC/(V um); that of dry air is 6e-4 larger
LARGEST_GAP = 1e-3  # um; default of g0, where the bodies' capacitance does not ask for less
RESOLVED = 3.0  # facets that a cohesive zone must have
CLOSED = 100.0  # capacitance of a closed contact over that of the bodies' thickness, at least


@dataclass(frozen=True)
class Medium(CapacitiveLaw):
    """Capacitance of a gap filled with a medium.

    permittivity (m,): pC/(V um), zero where no charge passes
    closed_gap: g0, um; reach: gap from which there is none, um
    near (m,): gap, um, over which the law is divided in two: one falls to zero there, and the other has the rest; None:
        the law is whole
    rest: whether this is the rest
    pulls: whether charges pull on the surfaces; without, c is a given function of the state
    switch (m,): gap, um, over which a closed contact is switched off, see `stable_switch`; zero or None: at once
    """

    permittivity: Array
    closed_gap: float
    reach: float
    near: Array | None = None
    rest: bool = False
    pulls: bool = True
    switch: Array | None = None
    rest_gap: float = 0.0

    @property
    def interaction_range(self) -> float:
        """Largest gap of any point with a charge, um."""
        if self.near is None or self.rest:
            return self.rest_gap + self.reach
        return self.rest_gap + min(self.reach, float(self.near.max(initial=0.0)))

    def field(self, q: Array) -> Array:
        """Field (m,), V/um, at kinematics q (m, 2); zero where a gap is closed or out of reach."""
        gap = q[:, 0] - self.rest_gap
        is_open = (gap > 0.0) & (gap < self.reach) & (self.permittivity > 0.0)
        return np.where(is_open, np.abs(q[:, 1]) / np.hypot(gap, self.closed_gap), 0.0)

    def capacitance(self, gap: Array) -> WithDerivatives:
        """Capacitance (m,) with derivatives, see `CapacitiveLaw`."""
        g = np.maximum(gap, 0.0)
        root = np.sqrt(g**2 + self.closed_gap**2)
        c = self.permittivity / root
        c1 = -c * g / root**2
        c2 = np.where(gap > 0.0, c * (2.0 * g**2 - self.closed_gap**2) / root**4, 0.0)
        if self.switch is not None:
            more, used = self.permittivity / self.closed_gap - c, self.switch > 0.0
            s, s1, s2 = _fall(gap, 0.0, np.where(used, self.switch, 1.0))
            c = c + np.where(used, s * more, 0.0)
            c2 = c2 + np.where(used, s2 * more - 2.0 * s1 * c1 - s * c2, 0.0)
            c1 = c1 + np.where(used, s1 * more - s * c1, 0.0)
        whole = _product((c, c1, c2), _fall(gap, CUT * self.reach, self.reach))
        if self.near is None:
            return whole
        s, s1, s2 = _fall(gap, 0.0, self.near)
        return _product(whole, (1.0 - s, -s1, -s2) if self.rest else (s, s1, s2))


def _fall(gap: Array, start: Array | float, end: Array | float) -> WithDerivatives:
    """A fall from one at `start` to zero at `end`."""
    width = end - start
    s, s1, s2 = smooth_step((gap - start) / width)
    return s, s1 / width, s2 / width**2


def _product(a: WithDerivatives, b: WithDerivatives) -> WithDerivatives:
    return a[0] * b[0], a[1] * b[0] + a[0] * b[1], a[2] * b[0] + 2.0 * a[1] * b[1] + a[0] * b[2]


def stable_switch(
    voltage: float, permittivity: Array, stiffness: Array, thickness: float, facet_size: Array, medium: float
) -> Array:
    """Gap (m,), um, over which a closed contact is to be switched off, zero where it needs no switch.

    Surfaces with a voltage between them hold each other like an adhesive of strength s = D^2 / (2 eps_m) and energy
    G = D V / 2, with D = eps V / thickness of the bodies. Facets that do not resolve its cohesive zone, E G / s^2, snap
    to and fro; there the switch of `stable_electric_range` is used.

    voltage, V; permittivity (m,), of the bodies, and of the medium, pC/(V um); stiffness (m,), MPa; thickness, um
    """
    if not voltage:
        return np.zeros(len(permittivity))
    charge = np.maximum(permittivity * voltage / thickness, np.finfo(float).tiny)
    zone = 2.0 * stiffness * voltage * (medium / charge) ** 2 / charge
    return np.where(zone < RESOLVED * facet_size, stable_electric_range(voltage, permittivity, stiffness), 0.0)


def closed_gap(permittivity: float, bodies: float) -> float:
    """Default of g0, um, in a medium of this permittivity between bodies of this capacitance per area, pC/(V um2)."""
    return permittivity / max(CLOSED * bodies, permittivity / LARGEST_GAP)
