"""Loads on boundaries: dead tractions, pressure that may follow the surface, charge densities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import ufl

from piezomat.forms import fenicsx
from piezomat.forms.kinematics import Kinematics, cofactor, displacement_gradient


@dataclass(frozen=True)
class Load:
    """Loads on the facets of one tag, as DOLFINx Constants, so that a load step recompiles nothing.

    traction (dim,), MPa: dead force per reference area
    pressure, MPa: against the outer normal; dead in small kinematics, follows the surface in finite
    charge_density, pC/um2: free charge per reference area
    """

    tag: int
    traction: Any = None
    pressure: Any = None
    charge_density: Any = None


def boundary_loads(
    v: Any, w: Any, ds: Any, loads: Sequence[Load], kinematics: Kinematics, potential_scale: float | None
) -> Any:
    """Form that all loads together ADD to the residual, empty without loads.

    A traction adds -t.v, a pressure +p n.v (finite: +p (cof F N).v per reference area), a charge +q potential_scale
    v_psi. In plane stress a load acts per reference thickness. Raises ValueError for a charge without a potential.

    v: test function of w's space
    ds: measure of exterior facets, with the loads' tags in its subdomain_data
    """
    domain = fenicsx.domain(w)
    dim = fenicsx.dimension(w)
    degree = 2 * fenicsx.degree(w)
    normal = ufl.FacetNormal(domain)
    if kinematics == "finite":
        normal = cofactor(ufl.Identity(dim) + displacement_gradient(w)) * normal
    form = ufl.Form([])
    for load in loads:
        work = []
        if load.traction is not None:
            work += [-load.traction[i] * v[i] for i in range(dim)]
        if load.pressure is not None:
            work += [load.pressure * normal[i] * v[i] for i in range(dim)]
        if load.charge_density is not None:
            if w.ufl_shape != (dim + 1,) or potential_scale is None:
                raise ValueError("a charge density needs a potential: no material of the model has a permittivity")
            work.append(load.charge_density * potential_scale * v[dim])
        if work:
            form += sum(work) * ds(load.tag, degree=degree)
    return form


def load_tangent(form: Any, w: Any) -> Any | None:
    """Derivative of `boundary_loads` at w, not symmetric; None if the loads do not depend on w."""
    return ufl.derivative(form, w) if w in form.coefficients() else None
