"""Kinematics: strain and electric field of the unknown, and the push-forward from referential to current fields."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import ufl

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.forms.materials import VOIGT

Kinematics = Literal["small", "finite"]


def strain_and_field(w: Any, kinematics: Kinematics) -> Any:
    """UFL vector s: Voigt strain (engineering shears) and, if w has psi, -Grad(psi) = E / potential_scale.

    3 + 2 entries in 2D, 6 + 3 in 3D. Raises ValueError if w has neither dim nor dim + 1 components.
    """
    dim = fenicsx.dimension(w)
    if w.ufl_shape not in ((dim,), (dim + 1,)):
        raise ValueError(f"the unknown must have {dim} or {dim + 1} components, not {w.ufl_shape}")
    if kinematics not in ("small", "finite"):
        raise ValueError(f'kinematics must be "small" or "finite", not "{kinematics}"')
    gradient = ufl.grad(w)

    def strain(i: int, j: int) -> Any:
        linear = gradient[i, j] + gradient[j, i]
        if kinematics == "finite":
            linear = linear + sum(gradient[k, i] * gradient[k, j] for k in range(dim))
        return linear if i != j else 0.5 * linear

    pairs = ((0, 0), (1, 1), (0, 1)) if dim == 2 else ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
    entries = [strain(i, j) for i, j in pairs]
    if w.ufl_shape == (dim + 1,):
        entries += [-gradient[dim, j] for j in range(dim)]
    return ufl.as_vector(entries)


def displacement_gradient(w: Any) -> Any:
    """UFL grad u (d, d) of the displacements in w."""
    dim = fenicsx.dimension(w)
    gradient = ufl.grad(w)
    return ufl.as_matrix([[gradient[i, j] for j in range(dim)] for i in range(dim)])


def cofactor(f: Any) -> Any:
    """UFL det(F) F^-T, as polynomials of the entries of F (d, d)."""
    if f.ufl_shape == (2, 2):
        return ufl.as_matrix([[f[1, 1], -f[1, 0]], [-f[0, 1], f[0, 0]]])
    columns = [[f[i, j] for i in range(3)] for j in range(3)]
    cross = [ufl.cross(ufl.as_vector(columns[j - 2]), ufl.as_vector(columns[j - 1])) for j in range(3)]
    return ufl.as_matrix([[cross[j][i] for j in range(3)] for i in range(3)])


def deformation_gradient(displacement_gradient: Array, out_of_plane_strain: Array) -> Array:
    """F (m, 3, 3) from grad u (m, d, d); in 2D the thickness stretch follows from the Green-Lagrange strain (m,)."""
    points, d, _ = displacement_gradient.shape
    f = np.tile(np.eye(3), (points, 1, 1))
    f[:, :d, :d] += displacement_gradient
    if d == 2:
        f[:, 2, 2] = np.sqrt(1.0 + 2.0 * out_of_plane_strain)
    return f


def push_forward(f: Array, stress: Array, field: Array, displacement: Array) -> tuple[Array, Array, Array]:
    """Cauchy stress (m, 6), current electric field and electric displacement (m, 3) from referential ones.

    f (m, 3, 3); stress (m, 6) second Piola-Kirchhoff in Voigt order, field (m, 3) = -Grad(phi), displacement (m, 3).
    F S F^T / J, F^-T E, F D / J (Dorfmann and Ogden 2005, section 3).
    """
    jacobian = np.linalg.det(f)[:, None]
    s = np.empty_like(f)
    for k, (i, j) in enumerate(VOIGT):
        s[:, i, j] = s[:, j, i] = stress[:, k]
    cauchy = f @ s @ np.swapaxes(f, 1, 2)
    voigt = np.stack([cauchy[:, i, j] for i, j in VOIGT], axis=1) / jacobian
    current_field = np.linalg.solve(np.swapaxes(f, 1, 2), field[..., None])[..., 0]
    return voigt, current_field, (f @ displacement[..., None])[..., 0] / jacobian
