"""Stabilization of bodies without constraints: springs at their unknowns."""

from __future__ import annotations

from typing import Any

import ufl

from piezomat.forms import fenicsx


def stabilization_form(v: Any, strength: Any) -> Any:
    """Linear form whose vector holds the stiffness of a spring at every unknown.

    Their energy in a rigid motion is that of springs distributed over the volume, whatever the order: the square of the
    motion is integrated from its nodal values.

    strength: DG0 vector of two, MPa/um2: of each displacement, and of the potential unknown. The latter has the sign of
        the dielectric term, so that the signature of the tangent does not change.
    """
    dim = fenicsx.dimension(v)
    density = strength[0] * sum(v[i] for i in range(dim))
    if v.ufl_shape[0] > dim:
        density = density - strength[1] * v[dim]
    return density * ufl.dx(degree=fenicsx.degree(v))
