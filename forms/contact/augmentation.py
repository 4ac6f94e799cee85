"""Augmented Lagrangian: multipliers that remove the penetration and the potential jump of a penalty (Uzawa's method).

The law is evaluated at gap + a and jump + b. With the penalties k and rho, k a is the multiplier of the gap (a
pressure, MPa) and rho b that of the jump (a charge, pC/um2). Between two solutions of the equilibrium the remaining gap
and jump are added to a and b, until they vanish (Alart and Curnier 1991; Wriggers 2006).

a and b are values at the corners of slave facets, interpolated by linear functions N; their increments are means
weighted with N. One multiplier per integration point over-constrains non-matching meshes: surfaces lock and pressures
oscillate (Puso and Laursen 2004).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.facets import FacetKind, corner_kind
from piezomat.forms.contact.laws.equal_potential import EqualPotential
from piezomat.forms.contact.laws.interface import InterfaceLaw
from piezomat.forms.contact.laws.response import History, Response


@dataclass
class Multipliers:
    """Multipliers over penalties at corners (f, k) of slave facets: additions to the gap (um, <= 0) and jump (V)."""

    gap: Array
    jump: Array

    @classmethod
    def none(cls, kind: FacetKind, facets: int) -> Multipliers:
        """Zero multipliers."""
        corners = len(corner_kind(kind).nodes)
        return cls(np.zeros((facets, corners)), np.zeros((facets, corners)))

    def copy(self) -> Multipliers:
        """Copy that shares no array."""
        return Multipliers(self.gap.copy(), self.jump.copy())

    def at(self, kind: FacetKind, facet: Integers, xi: Array) -> tuple[Array, Array]:
        """Additions (m,) to gap and jump at points xi (m, t) of facets (m,)."""
        shape = corner_kind(kind).shape(xi)
        return np.einsum("mk,mk->m", shape, self.gap[facet]), np.einsum("mk,mk->m", shape, self.jump[facet])

    def augmented(self, sums: Array) -> Multipliers:
        """Multipliers after one step of Uzawa's method.

        sums (f, k, 4): over the projected points, weight times N times 1, gap, s, and s times jump, where s is the
        share of the electric contact. Where it fades out, s < 1, the steps converge to a jump with the charge
        rho s/(1 - s) jump, so that equal potentials are the limit as surfaces approach.
        """
        weight = sums[..., 0]
        gap, share, jump = np.moveaxis(sums[..., 1:] / np.where(weight > 0.0, weight, 1.0)[..., None], -1, 0)
        return Multipliers(np.where(weight > 0.0, np.minimum(self.gap + gap, 0.0), 0.0), share * self.jump + jump)


def augmented_response(
    law: InterfaceLaw,
    gap: Array,
    jump: Array | None,
    history: History,
    shift: tuple[Array, Array],
    *,
    attraction: bool = True,
    consistent: bool = True,
) -> Response:
    """Response at gaps and jumps (m,) with multipliers, without the energy that they store; see `InterfaceLaw.respond`.

    shift: additions (m,) to gap and jump, `Multipliers.at`
    """
    more_gap, more_jump = shift
    shifted = None if jump is None else jump + more_jump
    r = law.respond(gap + more_gap, shifted, history, attraction=attraction, consistent=consistent)
    r.contact = r.contact - 0.5 * law.penalty * more_gap**2
    if jump is not None and isinstance(law.electric, EqualPotential):
        r.electric = r.electric - 0.5 * law.electric.penalty * more_jump**2
    return r


def electric_share(law: InterfaceLaw, response: Response) -> Array:
    """Share s (m,) of the full penalty for equal potentials that a response has; zero of other laws."""
    if not isinstance(law.electric, EqualPotential):
        return np.zeros_like(response.slope)
    rho = law.electric.penalty
    return np.where(rho > 0.0, -response.electric_curvature / np.where(rho > 0.0, rho, 1.0), 0.0)
