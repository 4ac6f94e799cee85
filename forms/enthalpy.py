"""Enthalpy of the bodies: one density of coupled piezoelectricity, its residual, tangent and stored energies.

The unknown w has the components u_1 .. u_dim and, with a potential, psi = phi / potential_scale. With
s = (strain in Voigt order, electric field) and the matrix M of `piezomat.forms.materials`,

    Pi(w) = int 1/2 s.M.s dV - int t.u dA + int q phi dA,      E = -grad(phi).

Small kinematics: S = sym(grad u). Finite: the Green-Lagrange strain and the referential field E = -Grad(phi), a total
Lagrangian description in which T is the second Piola-Kirchhoff stress. The material enters only as numbers of each
cell: every scene with the same cell, order, kinematics and fields uses the same compiled forms.

The derivative of Pi by psi is potential_scale times that by phi: the free charge on a boundary (-D.n dA) is minus the
sum of the internal residual's psi entries there, divided by potential_scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import dolfinx
import numpy as np
import ufl
from numpy.typing import NDArray

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.forms.kinematics import Kinematics, strain_and_field, strain_components


def constitutive_field(
    mesh: Any,
    matrices: Sequence[Array],
    cell_matrix: NDArray[np.int32],
    potential_scale: float | None,
) -> Any:
    """Upper triangle, row by row, of each cell's enthalpy matrix as a blocked DG0 Function. Collective.

    15 components in 2D, 45 in 3D; without potential 6 or 21, the elastic block only.

    matrices: of `Material.constitutive_matrix`, (5, 5) or (9, 9)
    cell_matrix (local cells,): number of the matrix of each cell
    potential_scale: V, multiplies rows and columns of the electric field; None without potential
    """
    dim = mesh.geometry.dim
    strains = strain_components(dim)
    size = strains if potential_scale is None else strains + dim
    scale = np.ones(size)
    scale[strains:] = potential_scale or 1.0
    rows, columns = np.triu_indices(size)
    table = np.array([(scale[:, None] * m[:size, :size] * scale)[rows, columns] for m in matrices])
    field = dolfinx.fem.Function(fenicsx.piecewise_constant(mesh, rows.size))
    cells = fenicsx.dofmap(field.function_space)[: len(cell_matrix), 0]
    field.x.array.reshape(-1, rows.size)[cells] = table[cell_matrix]
    field.x.scatter_forward()
    return field


def symmetric_matrix(constitutive: Any, size: int) -> Any:
    """UFL matrix M (size, size) of the cellwise `constitutive_field`. Raises ValueError if its size differs."""
    if constitutive.ufl_shape != (size * (size + 1) // 2,):
        raise ValueError(f"a matrix of {constitutive.ufl_shape[0]} entries does not fit a state of {size} components")
    entry = {pair: constitutive[number] for number, pair in enumerate(zip(*np.triu_indices(size), strict=True))}
    return ufl.as_matrix([[entry[min(i, j), max(i, j)] for j in range(size)] for i in range(size)])


def enthalpy(w: Any, constitutive: Any, kinematics: Kinematics) -> Any:
    """UFL density 1/2 s.M.s of w, pJ/um3, with the `constitutive_field`. Raises ValueError if their sizes differ."""
    s = strain_and_field(w, kinematics)
    return 0.5 * ufl.inner(s, symmetric_matrix(constitutive, len(s)) * s)


def volume_measure(w: Any) -> Any:
    """UFL dx of the least sufficient degree for elements of w's order on a mesh of the same geometry order.

    Exact for the small-strain tangent on affine cells, and on curved ones for int grad(v) dV, so that a uniform stress
    is in equilibrium: degree (d - 1)(p - 1) from the cofactor of the geometry's gradient and p - 1 from the gradient of
    v. On tensor cells the Gauss rule of p + 1 points in each direction is exact for both.
    """
    domain = fenicsx.domain(w)
    order = fenicsx.degree(w)
    if fenicsx.cell_name(domain) in ("quadrilateral", "hexahedron"):
        degree = 2 * order
    else:
        degree = fenicsx.dimension(w) * (order - 1)
    return ufl.dx(domain=domain, degree=degree)


def internal_form(w: Any, constitutive: Any, kinematics: Kinematics) -> Any:
    """Residual F(w; v), the derivative of the enthalpy at w, with the test function v of w's space.

    Written as (M s).ds(v) with M symmetric: equal to ufl.derivative of 1/2 s.M.s, but the C code of its tangent is half
    as long and compiles four times as fast.
    """
    s = strain_and_field(w, kinematics)
    variation = ufl.derivative(s, w, ufl.TestFunction(w.function_space))
    return ufl.inner(symmetric_matrix(constitutive, len(s)) * s, variation) * volume_measure(w)


def tangent_form(w: Any, constitutive: Any, kinematics: Kinematics) -> Any:
    """Symmetric bilinear form, the derivative of the residual; independent of w in small kinematics."""
    return ufl.derivative(internal_form(w, constitutive, kinematics), w)


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
