"""Stored energies of the bodies, and the stabilization of bodies without constraints."""

from __future__ import annotations

from typing import Any

import ufl

from piezomat.forms import fenicsx
from piezomat.forms.kinematics import Kinematics, strain_and_field, strain_components
from piezomat.forms.piezo import symmetric_matrix, volume_measure


def stored_energies(w: Any, constitutive: Any, kinematics: Kinematics) -> tuple[Any, Any | None]:
    """UFL functionals of the elastic energy 1/2 S.C.S and the electric energy 1/2 E.eps.E (None without potential).

    Their sum is the internal energy, pJ (2D: per um of depth): the piezoelectric terms of T.S and D.E cancel.
    """
    s = strain_and_field(w, kinematics)
    matrix = symmetric_matrix(constitutive, len(s))
    dim = fenicsx.dimension(w)
    strains = strain_components(dim)

    def half_square(indices: range) -> Any:
        return 0.5 * sum(matrix[i, j] * s[i] * s[j] for i in indices for j in indices) * volume_measure(w)

    if len(s) == strains:
        return half_square(range(strains)), None
    return half_square(range(strains)), -half_square(range(strains, len(s)))


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
