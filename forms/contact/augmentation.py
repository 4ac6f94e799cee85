"""Augmented Lagrangian: multipliers that take gap and potential jump of a penalty away, found by Uzawa's steps.

The law is asked at gap + a and jump + b in the place of gap and jump: with the penalties k and rho, k a is the
multiplier of the gap (a pressure, MPa) and rho b that of the jump (a charge, pC/um2). Between two solutions of the
equilibrium a and b take in what gap and jump are left, until nothing is (Alart and Curnier 1991; Wriggers 2006).

a and b belong to the corners of slave facets, with linear functions N in between, and take in means weighted with N.
As many multipliers as integration points would ask two meshes that do not match for more than they can do: surfaces
lock and pressures oscillate (Puso and Laursen 2004).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezomat.forms.arrays import Array
from piezomat.forms.contact.facets import FacetKind, facet_kind
from piezomat.forms.contact.laws.interface import InterfaceLaw
from piezomat.forms.contact.laws.response import History, Response


@dataclass
class Multipliers:
    """What is added to gap, um, never positive, and to potential jump, V, at the corners (f, k) of slave facets."""

    gap: Array
    jump: Array

    @classmethod
    def none(cls, kind: FacetKind, facets: int) -> Multipliers:
        """Penalties alone."""
        corners = len(corner_kind(kind).nodes)
        return cls(np.zeros((facets, corners)), np.zeros((facets, corners)))

    def copy(self) -> Multipliers:
        """A shift of its own."""
        return Multipliers(self.gap.copy(), self.jump.copy())

    def at(self, kind: FacetKind, facet: NDArray[np.int64], xi: Array) -> tuple[Array, Array]:
        """Shifts of gap and jump (m,) at points of facets."""
        shape = corner_kind(kind).shape(xi)
        return np.einsum("mk,mk->m", shape, self.gap[facet]), np.einsum("mk,mk->m", shape, self.jump[facet])

    def augmented(self, sums: Array) -> Multipliers:
        """The shift after one of Uzawa's steps.

        sums (f, k, 4): over the points that meet something, weight times N times 1, gap, s and s times jump, s being
        the share of the electric contact. Where it fades out, s < 1, jumps that carry rho s/(1 - s) jump are the end
        of this, so that equal potentials are their limit as surfaces come near.
        """
        weight = sums[..., 0]
        gap, share, jump = np.moveaxis(sums[..., 1:] / np.where(weight > 0.0, weight, 1.0)[..., None], -1, 0)
        return Multipliers(np.where(weight > 0.0, np.minimum(self.gap + gap, 0.0), 0.0), share * self.jump + jump)


def corner_kind(kind: FacetKind) -> FacetKind:
    """The facet of order 1 on a facet's corners, which are its first nodes."""
    return facet_kind("line2" if kind.dim == 1 else "tri3" if kind.simplex else "quad4")


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
    """The law's response with multipliers: derivatives of its enthalpy less what the multipliers store, pJ/um2."""
    more_gap, more_jump = shift
    shifted = None if jump is None else jump + more_jump
    r = law.respond(gap + more_gap, shifted, history, attraction=attraction, consistent=consistent)
    r.contact = r.contact - 0.5 * law.penalty * more_gap**2
    if jump is not None and law.electric_penalty is not None:
        r.electric = r.electric - 0.5 * law.electric_penalty * more_jump**2
    return r


def electric_share(law: InterfaceLaw, response: Response) -> Array:
    """Share s (m,) of the electric contact in a response."""
    if law.electric_penalty is None:
        return np.zeros_like(response.slope)
    rho = law.electric_penalty
    return np.where(rho > 0.0, -response.electric_curvature / np.where(rho > 0.0, rho, 1.0), 0.0)
