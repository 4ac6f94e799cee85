"""From referential to current quantities: Cauchy stress and the fields as a microscope would see them."""

from __future__ import annotations

import numpy as np

from piezomat.forms.arrays import Array

_VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


def deformation_gradient(displacement_gradient: Array, out_of_plane_strain: Array) -> Array:
    """F (m, 3, 3) from grad u (m, d, d); in 2D the thickness stretch follows from the Green-Lagrange strain (m,)."""
    points, d, _ = displacement_gradient.shape
    f = np.tile(np.eye(3), (points, 1, 1))
    f[:, :d, :d] += displacement_gradient
    if d == 2:
        f[:, 2, 2] = np.sqrt(1.0 + 2.0 * out_of_plane_strain)
    return f


def push_forward(f: Array, stress: Array, field: Array, displacement: Array) -> tuple[Array, Array, Array]:
    """Cauchy stress, current electric field and electric displacement from the referential ones.

    f (m, 3, 3); stress (m, 6) second Piola-Kirchhoff in Voigt order, field (m, 3) = -Grad(phi), displacement (m, 3).
    F S F^T / J, F^-T E, F D / J (Dorfmann and Ogden 2005, section 3).
    """
    jacobian = np.linalg.det(f)[:, None]
    s = np.empty_like(f)
    for k, (i, j) in enumerate(_VOIGT):
        s[:, i, j] = s[:, j, i] = stress[:, k]
    cauchy = f @ s @ np.swapaxes(f, 1, 2)
    voigt = np.stack([cauchy[:, i, j] for i, j in _VOIGT], axis=1) / jacobian
    current_field = np.linalg.solve(np.swapaxes(f, 1, 2), field[..., None])[..., 0]
    return voigt, current_field, (f @ displacement[..., None])[..., 0] / jacobian
