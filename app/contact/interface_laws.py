"""From the scene's [contact] section to interface laws: penalties, electric contact and adhesion of each point."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from piezomat.forms.arrays import Array
from piezomat.forms.contact.integrals import quadrature_points
from piezomat.forms.contact.laws.catalogue import REVERSIBLE
from piezomat.forms.contact.laws.cohesive import CohesiveLaw
from piezomat.forms.contact.laws.interface import InterfaceLaw, stable_electric_range
from piezomat.forms.contact.laws.response import AdhesionLaw
from piezomat.meshes.contact.load_balance import SlaveFacets
from piezomat.scene.errors import SceneError
from piezomat.scene.sections import Contact as ContactKeys

# Default gap over which the electric contact fades out, in facet sizes. Measured on facing_halves and crossed_fibers:
# it lowers the voltage by 3 % in 2D and 13 % in 3D, less as facets shrink; 0.01 lowers it by 1 and 2 %, but attraction
# is then so steep that there are several equilibria, and with stiff penalties Newton's method takes twice as long.
FADE = 0.1


def interface_law(
    keys: ContactKeys, voltage: float, size: Array, stiffness: Array, permittivity: Array | None
) -> InterfaceLaw:
    """The law without adhesion at points with these facet sizes (m,), stiffnesses (m,) and permittivities (m,).

    voltage: largest difference of prescribed potentials, V. There is no electric contact without `permittivity`,
    nor with an electric penalty of zero.
    """
    penalty = np.full(len(size), keys.normal_penalty or 0.0)
    if keys.normal_penalty is None:
        penalty = keys.normal_penalty_factor * stiffness / size
    if permittivity is None or keys.electric_penalty == 0.0:
        return InterfaceLaw(penalty)
    electric = np.where(permittivity > 0.0, keys.electric_penalty or 0.0, 0.0)
    if keys.electric_penalty is None:
        electric = keys.electric_penalty_factor * permittivity / size
    if keys.electric_range is not None:
        fade = np.full(len(size), keys.electric_range)
    else:
        fade = np.maximum(FADE * size, stable_electric_range(voltage, permittivity, stiffness))
    return InterfaceLaw(penalty, None, electric, fade)


def adhesion_law(comm: MPI.Comm, keys: ContactKeys, penalty: Array) -> AdhesionLaw | None:
    """The adhesion of points with these penalties (m,) that the scene asks for; None without. Collective.

    Raises SceneError on all ranks if the law is stiffer than the penalty of a point.
    """
    if keys.adhesion is None:
        return None
    adhesion, least = keys.adhesion, comm.allreduce(float(penalty.min(initial=np.inf)), op=MPI.MIN)
    if adhesion.law in REVERSIBLE:
        law = REVERSIBLE[adhesion.law]
        try:
            law(adhesion.strength, adhesion.energy, np.array([least]))
        except ValueError as error:
            raise SceneError("contact.adhesion.strength", str(error), "a law no stiffer than the penalty") from None
        return law(adhesion.strength, adhesion.energy, penalty)
    longest, always = adhesion.strength / least, adhesion.starts == "always"
    energy = adhesion.energy
    if energy is None:
        if adhesion.range <= longest:
            raise SceneError(
                "contact.adhesion.range", f"{adhesion.range:g}", f"more than strength / normal_penalty = {longest:g} um"
            )
        # A range is the same for all points, the energy up to it is not: it depends on the penalty.
        return CohesiveLaw.cutoff_at(adhesion.strength, adhesion.range, penalty, always)
    spent = 0.5 * adhesion.strength * longest
    if energy <= spent:
        allowed = f"more than strength^2 / (2 normal_penalty) = {spent:g} pJ/um2, or a larger penalty"
        raise SceneError("contact.adhesion.energy", f"{energy:g}", allowed)
    cohesive = {"bilinear": CohesiveLaw.bilinear, "cutoff": CohesiveLaw.cutoff}[adhesion.law]
    return cohesive(adhesion.strength, energy, penalty, always)


def facet_sizes(facets: SlaveFacets) -> Array:
    """Length (f,) of each facet, or the side of a square of its area, um."""
    points = quadrature_points(facets.kind, facets.reference)
    area = np.bincount(points.facet, points.weight, minlength=len(facets))
    if facets.kind.dim == 1:
        return area
    return np.sqrt(2.0 * area if facets.kind.simplex else area)
