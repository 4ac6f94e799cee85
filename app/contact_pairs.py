"""From the scene's [contact] section to contact passes: which surfaces, points, penalties and adhesion."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from app import fenicsx
from app.contact import Contact, ContactPass
from app.model import Model
from app.scene_errors import SceneError
from forms.contact.integrals import nodal_points, quadrature_points
from forms.contact.laws import Adhesion, InterfaceLaw
from forms.contact.lennard_jones import LennardJones
from meshes.surface import Surface, body_facets, multiplicity, surface

Array = NDArray[np.float64]

FADE = 0.1  # default gap over which the electric contact fades out, in facet sizes


def pair_names(model: Model) -> list[tuple[str, str]]:
    """The pairs of the scene; "auto": every two bodies that share no node."""
    given = model.scene.contact.pairs
    if given != "auto":
        return [(a, b) for a, b in given]
    bodies = model.bodies
    parts = [{p for p, members in enumerate(bodies.part_bodies) if i in members} for i in range(len(bodies.bodies))]
    pairs = combinations(range(len(bodies.bodies)), 2)
    return [(bodies.bodies[i], bodies.bodies[j]) for i, j in pairs if not parts[i] & parts[j]]


def contact_of(model: Model) -> Contact | None:
    """The contact of a model, or None without a [contact] section. Collective. Raises SceneError on all ranks."""
    keys = model.scene.contact
    if keys is None:
        return None
    surfaces: dict[str, Surface] = {}
    passes = []
    for number, pair in enumerate(pair_names(model)):
        for name in pair:
            if name not in surfaces:
                surfaces[name] = _surface(model, name, f"contact.pairs[{number}]")
        directions = [pair, pair[::-1]][: keys.passes]
        for first, (slave, master) in zip((True, False), directions, strict=False):
            passes.append(_pass(model, number, surfaces[slave], surfaces[master], first))
    if not passes:
        raise SceneError("contact.pairs", "no two bodies apart from each other", "bodies that meet, or no [contact]")
    return Contact(model.comm, model.space, model.coordinate_vector(), passes, model.potential_scale)


def _surface(model: Model, name: str, key: str) -> Surface:
    bodies = model.bodies
    if name in bodies.bodies:
        facets = body_facets(model.space, bodies.cell_body, bodies.bodies.index(name))
    else:
        facets = np.intersect1d(bodies.facets[name], fenicsx.exterior_facets(model.mesh))
    result = surface(model.space, name, facets.astype(np.int32), bodies.order)
    if model.comm.allreduce(len(result)) == 0:
        raise SceneError(key, f'"{name}", which has no facets on the outside', "a body or a facet group of the outside")
    return result


def _pass(model: Model, number: int, slave: Surface, master: Surface, first: bool) -> ContactPass:
    keys = model.scene.contact
    if keys.method == "point":
        points = quadrature_points(slave.kind, slave.reference)
    else:
        shared = multiplicity(model.space, slave) if keys.nodal_weight == "unit" else None
        points = nodal_points(slave.kind, slave.reference, shared)
    size = _facet_sizes(slave)[points.facet]
    materials = [model.materials[i] for i in _bodies_of(model, slave) | _bodies_of(model, master)]
    stiffness = min(float(np.diag(m.stiffness)[:3].mean()) for m in materials)
    penalty = np.full(len(size), keys.normal_penalty or 0.0)
    if keys.normal_penalty is None:
        penalty = keys.normal_penalty_factor * stiffness / size
    electric, fade = None, None
    if all(m.permittivity is not None for m in materials):
        permittivity = min(float(np.diag(m.permittivity).mean()) for m in materials)
        electric = np.full(len(size), keys.electric_penalty or 0.0)
        if keys.electric_penalty is None:
            electric = keys.electric_penalty_factor * permittivity / size
        fade = FADE * size if keys.electric_range is None else np.full(len(size), keys.electric_range)
    law = InterfaceLaw(penalty, _adhesion(model, penalty), electric, fade)
    return ContactPass(number, slave, master, points, law, 1.0 / keys.passes, first, size, _depth(model, slave, master))


def _adhesion(model: Model, penalty: Array) -> Adhesion | LennardJones | None:
    keys = model.scene.contact.adhesion
    if keys is None:
        return None
    least = model.comm.allreduce(float(penalty.min(initial=np.inf)), op=MPI.MIN)
    if keys.law == "lennard_jones":
        try:
            LennardJones.of(keys.strength, keys.energy, np.array([least]))
        except ValueError as error:
            raise SceneError("contact.adhesion.strength", str(error), "a law no stiffer than the penalty") from None
        return LennardJones.of(keys.strength, keys.energy, penalty)
    longest = keys.strength / least
    energy = keys.energy
    if energy is None:
        if keys.range <= longest:
            raise SceneError(
                "contact.adhesion.range", f"{keys.range:g}", f"more than strength / normal_penalty = {longest:g} um"
            )
        # A range is the same for all points, the energy up to it is not: it depends on the penalty.
        return Adhesion.until(keys.strength, keys.range, penalty, keys.starts == "always")
    if energy <= 0.5 * keys.strength * longest:
        allowed = (
            f"more than strength^2 / (2 normal_penalty) = {0.5 * keys.strength * longest:g} pJ/um2, or a larger penalty"
        )
        raise SceneError("contact.adhesion.energy", f"{energy:g}", allowed)
    law = {"bilinear": Adhesion.bilinear, "cutoff": Adhesion.cutoff}[keys.law]
    return law(keys.strength, energy, penalty, keys.starts == "always")


def _facet_sizes(group: Surface) -> Array:
    """Length of each facet, or the side of a square of its area."""
    points = quadrature_points(group.kind, group.reference)
    area = np.bincount(points.facet, points.weight, minlength=len(group))
    if group.kind.dim == 1:
        return area
    return np.sqrt(2.0 * area if group.kind.simplex else area)


def _depth(model: Model, *surfaces: Surface) -> float:
    """Half the least thickness of the parts that surfaces belong to, um."""
    here = {int(part) for group in surfaces for part in model.bodies.cell_part[group.cells]}
    parts = set().union(*model.comm.allgather(here))
    return 0.5 * float(model.part_thickness[sorted(parts)].min())


def _bodies_of(model: Model, group: Surface) -> set[int]:
    here = set(model.bodies.cell_body[group.cells].tolist())
    return set().union(*model.comm.allgather(here))
