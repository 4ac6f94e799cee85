"""Enthalpy of the bodies: the sum over their material laws, its residual, tangent and stored energies.

The unknown w has the components u_1 .. u_dim and, with a potential, psi = phi / potential_scale. With
s = (strain in Voigt order, electric field) and the density H of each body's law (`piezomat.forms.constitutive`), which
is 1/2 s.M.s for the linear law of `piezomat.forms.materials`,

    Pi(w) = int H(s) dV - int t.u dA + int q phi dA,      E = -grad(phi).

Small kinematics: S = sym(grad u). Finite: the Green-Lagrange strain and the referential field E = -Grad(phi), a total
Lagrangian description in which T is the second Piola-Kirchhoff stress. The material enters only as numbers of each
cell: every scene with the same cell, order, kinematics, fields and laws uses the same compiled forms.

The derivative of Pi by psi is potential_scale times that by phi: the free charge on a boundary (-D.n dA) is minus the
sum of the internal residual's psi entries there, divided by potential_scale.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import dolfinx
import numpy as np
import ufl
from numpy.typing import NDArray

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.forms.constitutive import ConstitutiveLaw, Plane
from piezomat.forms.kinematics import Kinematics, strain_and_field


@dataclass(frozen=True)
class Region:
    """The cells whose materials have one law.

    law: of any of them
    numbers: DG0 Function, `ConstitutiveLaw.numbers` of each cell's material
    tags, tag: cell tags of the mesh, and which of them the cells have; None where they are all cells
    """

    law: ConstitutiveLaw
    numbers: Any
    tags: Any = None
    tag: int | None = None

    def measure(self, w: Any) -> Any:
        """The `volume_measure` of these cells."""
        return volume_measure(w) if self.tag is None else volume_measure(w)(self.tag, subdomain_data=self.tags)


def regions(
    mesh: Any,
    materials: Sequence[ConstitutiveLaw],
    cell_material: NDArray[np.int32],
    plane: Plane,
    potential_scale: float | None,
    axes: Mapping[int, Array] | None = None,
) -> list[Region]:
    """The regions of a mesh, one for each class of its materials. Collective.

    cell_material (local cells,): number of the material of each cell
    axes: of materials whose axes differ from cell to cell, by number, in 3D: rotations (n, 3, 3) to each of its local
        cells, whose columns are the axes
    potential_scale: V, of the potential unknown; None without potential
    """
    dim = mesh.topology.dim
    classes = list(dict.fromkeys(type(material) for material in materials))
    cell_class = np.array([classes.index(type(material)) for material in materials], np.int32)[cell_material]
    cells = np.arange(len(cell_material), dtype=np.int32)
    tags = dolfinx.mesh.meshtags(mesh, dim, cells, cell_class) if len(classes) > 1 else None
    found = []
    for tag, kind in enumerate(classes):
        of_class = {i: m.numbers(dim, plane, potential_scale) for i, m in enumerate(materials) if type(m) is kind}
        table = np.zeros((len(materials), len(next(iter(of_class.values())))))
        for i, numbers in of_class.items():
            table[i] = numbers
        field = dolfinx.fem.Function(fenicsx.piecewise_constant(mesh, table.shape[1]))
        places = fenicsx.dofmap(field.function_space)[: len(cell_material), 0]
        values = table[cell_material]
        for i, rotations in (axes or {}).items():
            if i in of_class:
                values[cell_material == i] = materials[i].numbers_in(rotations, potential_scale)
        field.x.array.reshape(-1, table.shape[1])[places] = values
        field.x.scatter_forward()
        law = next(material for material in materials if type(material) is kind)
        found.append(Region(law, field) if tags is None else Region(law, field, tags, tag))
    return found


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


def enthalpy(w: Any, regions: Sequence[Region], kinematics: Kinematics) -> Any:
    """UFL functional of w, pJ (2D: per um of depth): the enthalpy density of each region, integrated."""
    s = strain_and_field(w, kinematics)
    return _sum([region.law.density(s, region.numbers) * region.measure(w) for region in regions])


def internal_form(w: Any, regions: Sequence[Region], kinematics: Kinematics) -> Any:
    """Residual F(w; v), the derivative of the enthalpy at w, with the test function v of w's space: dH/ds.ds(v)."""
    s = strain_and_field(w, kinematics)
    variation = ufl.derivative(s, w, ufl.TestFunction(w.function_space))
    return _sum([ufl.inner(r.law.gradient(s, r.numbers), variation) * r.measure(w) for r in regions])


def tangent_form(w: Any, regions: Sequence[Region], kinematics: Kinematics) -> Any:
    """Symmetric bilinear form, the derivative of the residual; in small kinematics linear laws make it constant."""
    return ufl.derivative(internal_form(w, regions, kinematics), w)


def stored_energies(w: Any, regions: Sequence[Region], kinematics: Kinematics) -> tuple[Any, Any | None]:
    """UFL functionals of the elastic and the electric energy (None without potential).

    Their sum is the internal energy, pJ (2D: per um of depth).
    """
    s = strain_and_field(w, kinematics)
    densities = [region.law.stored_energies(s, region.numbers) for region in regions]
    elastic, electric = zip(*densities, strict=True)
    measures = [region.measure(w) for region in regions]
    with_potential = [(e, dx) for e, dx in zip(electric, measures, strict=True) if e is not None]
    return (
        _sum([e * dx for e, dx in zip(elastic, measures, strict=True)]),
        _sum([e * dx for e, dx in with_potential]) if with_potential else None,
    )


def _sum(forms: Sequence[Any]) -> Any:
    return sum(forms[1:], forms[0])
