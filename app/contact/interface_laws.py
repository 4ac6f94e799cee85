"""From the scene's [contact] section to interface laws: penalties, electric contact and adhesion of each point."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np
from mpi4py import MPI

from piezomat.discretization.model import Model
from piezomat.forms.arrays import Array
from piezomat.forms.contact.integrals import facet_areas
from piezomat.forms.contact.laws.catalogue import REVERSIBLE
from piezomat.forms.contact.laws.cohesive import CohesiveLaw
from piezomat.forms.contact.laws.equal_potential import ConductingBonds, EqualPotential, stable_electric_range
from piezomat.forms.contact.laws.law import ContactLaw
from piezomat.forms.contact.laws.medium import AIR, Medium, closed_gap, stable_switch
from piezomat.forms.contact.laws.penalty import NormalPenalty
from piezomat.meshes.contact.load_balance import SlaveFacets
from piezomat.scene.errors import SceneError
from piezomat.scene.sections import Contact as ContactKeys

# Default gap over which the penalty for equal potentials is switched off, in facet sizes. Measured on facing_halves and
# crossed_fibers: 0.01 is nearer to the limit, but attraction is then so steep that there are several equilibria, and
# with stiff penalties Newton's method takes twice as long.
FADE = 0.1
# Gap, in facet sizes, up to which the medium is integrated with the points of contact at their present closest points.
NEAR = 0.1


@dataclass(frozen=True)
class GapMedium:
    """The medium in the gaps of a model.

    permittivity: pC/(V um); closed_gap, reach: um; pulls: see `Medium`
    voltage: largest difference of prescribed potentials, V; thickness: of the bodies, um
    """

    permittivity: float
    closed_gap: float
    reach: float
    pulls: bool
    voltage: float
    thickness: float

    def laws(
        self, size: Array, stiffness: Array, permittivity: Array, rest_gap: float = 0.0
    ) -> tuple[Medium, Medium, Medium]:
        """The law of points with these facet sizes, stiffnesses and permittivities (m,), and its near part and rest.

        No charge passes where a permittivity is zero. rest_gap: gap of surfaces at rest, um.
        """
        switch = stable_switch(self.voltage, permittivity, stiffness, self.thickness, size, self.permittivity)
        here = np.where(permittivity > 0.0, self.permittivity, 0.0)
        whole = Medium(here, self.closed_gap, self.reach, pulls=self.pulls, switch=switch, rest_gap=rest_gap)
        near = np.maximum(NEAR * size, 2.0 * switch)
        return whole, replace(whole, near=near), replace(whole, near=near, rest=True)


def gap_medium(model: Model) -> GapMedium | None:
    """The medium in the gaps of a model; None where it has no potential, or no medium.

    Without two prescribed potentials, or a prescribed charge, charges do not pull on bodies that contact alone holds:
    the potentials of their strain do so with a thousandth of the forces of contact, but Newton's method follows each
    free fiber that it moves (a mat: 39 iterations of a step instead of 14).
    """
    keys = model.scene.contact or ContactKeys()
    if not model.electric or keys.medium == "none":
        return None
    permittivity = AIR if keys.medium == "air" else keys.medium
    thickness, voltage = model.parts.thickness, model.prescription.largest_voltage()
    gap, reach = keys.medium_gap, keys.medium_range
    if gap is None:
        members = [(part, model.materials[b]) for part, some in enumerate(model.bodies.part_bodies) for b in some]
        capacitances = [m.mean_permittivity / thickness[part] for part, m in members if m.electric and not m.conductor]
        gap = closed_gap(permittivity, max(capacitances, default=0.0))
    least = float(thickness.min())
    if reach is None:
        reach = getattr(model.scene.geometry, "radius", 0.5 * least)
    scene = model.scene
    is_charged = any(row.charge for row in scene.electrodes) or any(row.charge_density for row in scene.boundaries)
    pulls = not model.has_unconstrained_bodies or len(scene.potentials) > 1 or is_charged
    return GapMedium(permittivity, gap, reach, pulls, voltage, least)


def normal_penalty(keys: ContactKeys, size: Array, stiffness: Array) -> Array:
    """Penalty (m,), MPa/um, of points with these facet sizes (m,) and stiffnesses (m,)."""
    if keys.normal_penalty is not None:
        return np.full(len(size), keys.normal_penalty)
    return keys.normal_penalty_factor * stiffness / size


def with_equal_potential(
    law: ContactLaw, keys: ContactKeys, voltage: float, size: Array, stiffness: Array, permittivity: Array
) -> ContactLaw:
    """A law of the gap with equal potentials, without a medium; as it is with an electric penalty of zero.

    size, stiffness, permittivity (m,): of the points; voltage: largest difference of prescribed potentials, V
    """
    if keys.electric_penalty == 0.0:
        return law
    parts = list(law.summands())
    bonds = next((part for part in parts if isinstance(part, CohesiveLaw)), None)
    electric = np.where(permittivity > 0.0, keys.electric_penalty or 0.0, 0.0)
    if keys.electric_penalty is None:
        electric = keys.electric_penalty_factor * permittivity / size
    if keys.electric_range is not None:
        fade = np.full(len(size), keys.electric_range)
    else:
        fade = np.maximum(FADE * size, stable_electric_range(voltage, permittivity, stiffness))
    # The range that keeps surfaces at a voltage apart from pulling each other in was measured beyond touch.
    beyond = (voltage > 0.0 and keys.electric_range is None) or bonds is not None
    equal = EqualPotential(electric, fade, 0.0 if beyond else -0.5, law.equilibrium_gap)
    if bonds is None:
        return law + equal
    others = (part for part in parts if part is not bonds)
    return reduce(add, (*others, ConductingBonds((bonds, equal))))


def check_adhesion(comm: MPI.Comm, keys: ContactKeys, penalty: float) -> None:
    """Raise SceneError on all ranks if the scene's adhesion is stiffer than the least penalty of a point. Collective.

    penalty: the least one on this rank, MPa/um
    """
    adhesion = keys.adhesion
    least = comm.allreduce(penalty, op=MPI.MIN) if adhesion is not None else np.inf
    if np.isinf(least):
        return
    if adhesion.law in REVERSIBLE:
        try:
            REVERSIBLE[adhesion.law](adhesion.strength, adhesion.energy, np.array([least]))
        except ValueError as error:
            raise SceneError("contact.adhesion.strength", str(error), "a law no stiffer than the penalty") from None
        return
    longest = adhesion.strength / least
    if adhesion.energy is None:
        if adhesion.range <= longest:
            raise SceneError(
                "contact.adhesion.range", f"{adhesion.range:g}", f"more than strength / normal_penalty = {longest:g} um"
            )
        return
    spent = 0.5 * adhesion.strength * longest
    if adhesion.energy <= spent:
        allowed = f"more than strength^2 / (2 normal_penalty) = {spent:g} pJ/um2, or a larger penalty"
        raise SceneError("contact.adhesion.energy", f"{adhesion.energy:g}", allowed)


def law_of_gap(keys: ContactKeys, penalty: Array) -> ContactLaw:
    """The penalties (m,) of points and the adhesion that the scene asks for and `check_adhesion` allows."""
    adhesion = keys.adhesion
    if adhesion is None:
        return NormalPenalty(penalty)
    if adhesion.law in REVERSIBLE:
        return REVERSIBLE[adhesion.law](adhesion.strength, adhesion.energy, penalty)
    always = adhesion.starts == "always"
    if adhesion.energy is None:
        # A range is the same for all points, the energy up to it is not: it depends on the penalty.
        return NormalPenalty(penalty) + CohesiveLaw.cutoff_at(adhesion.strength, adhesion.range, penalty, always)
    cohesive = {"bilinear": CohesiveLaw.bilinear, "cutoff": CohesiveLaw.cutoff}[adhesion.law]
    return NormalPenalty(penalty) + cohesive(adhesion.strength, adhesion.energy, penalty, always)


def facet_sizes(facets: SlaveFacets) -> Array:
    """Length (f,) of each facet, or the side of a square of its area, um."""
    area = facet_areas(facets.kind, facets.reference)
    if facets.kind.dim == 1:
        return area
    return np.sqrt(2.0 * area if facets.kind.simplex else area)
