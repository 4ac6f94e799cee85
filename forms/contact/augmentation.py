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
from piezomat.forms.contact.laws.law import COMPLETE_LAW, ContactLaw, LawMode
from piezomat.forms.contact.laws.response import Response

PENALTY_ENERGIES = "contact", "electric"  # names of the energies that the penalties of gap and jump store


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

    def at(self, kind: FacetKind, facet: Integers, xi: Array) -> Array:
        """Additions (m, 2) to gap and jump at points xi (m, t) of facets (m,)."""
        shape = corner_kind(kind).shape(xi)
        return np.stack([np.einsum("mk,mk->m", shape, at[facet]) for at in (self.gap, self.jump)], axis=1)

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
    law: ContactLaw, q: Array, history: Array, shift: Array, mode: LawMode = COMPLETE_LAW
) -> Response:
    """Response at kinematics q (m, k) with multipliers, without the energy that they store; see `ContactLaw.respond`.

    shift (m, k): additions to q, `Multipliers.at`
    """
    r = law.respond(q + shift, history, mode)
    energies = dict(r.energies)
    for name, penalty, more in zip(PENALTY_ENERGIES, law.penalties, shift.T, strict=False):
        energies[name] = r.energy(name) - 0.5 * penalty * more**2
    return Response(energies, r.gradient, r.hessian)


def electric_share(law: ContactLaw, response: Response) -> Array:
    """Share s (m,) of the full penalty for equal potentials that a response has; zero of other laws."""
    rho = law.penalties[1] + np.zeros(len(response.gradient))
    if response.gradient.shape[1] == 1:
        return np.zeros_like(rho)
    return np.where(rho > 0.0, -response.hessian[:, 1, 1] / np.where(rho > 0.0, rho, 1.0), 0.0)
