"""From the scene's [contact] section to contact passes: which surfaces, points, penalties and adhesion."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from app import fenicsx, reductions
from app.contact import Contact, ContactPass
from app.model import Model
from app.planes import PlanePass
from app.scene_errors import SceneError
from app.scene_sections import SIDES, Plane
from app.scene_sections import Contact as ContactKeys
from forms.contact.integrals import nodal_points, quadrature_points
from forms.contact.laws import Adhesion, InterfaceLaw
from forms.contact.lennard_jones import LennardJones
from forms.materials import Material
from meshes.surface import Surface, body_facets, multiplicity, surface

Array = NDArray[np.float64]

FADE = 0.1  # default gap over which the electric contact fades out, in facet sizes


def pair_names(model: Model) -> list[tuple[str, str]]:
    """The pairs of the scene; "auto": every two bodies that share no node."""
    if model.scene.contact is None:
        return []
    given = model.scene.contact.pairs
    if given != "auto":
        return [(a, b) for a, b in given]
    bodies = model.bodies
    parts = [{p for p, members in enumerate(bodies.part_bodies) if i in members} for i in range(len(bodies.bodies))]
    pairs = combinations(range(len(bodies.bodies)), 2)
    return [(bodies.bodies[i], bodies.bodies[j]) for i, j in pairs if not parts[i] & parts[j]]


def contact_of(model: Model) -> Contact | None:
    """The contact of a model; None without [contact] and [[planes]]. Collective. Raises SceneError on all ranks."""
    keys = model.scene.contact
    if keys is None and not model.scene.planes:
        return None
    surfaces: dict[str, Surface] = {}
    passes = []
    pairs = pair_names(model)
    for number, pair in enumerate(pairs):
        for name in pair:
            if name not in surfaces:
                surfaces[name] = _surface(model, name, f"contact.pairs[{number}]")
        directions = [pair, pair[::-1]][: keys.passes]
        for first, (slave, master) in zip((True, False), directions, strict=False):
            passes.append(_pass(model, number, surfaces[slave], surfaces[master], first))
    if not passes and keys is not None:
        raise SceneError("contact.pairs", "no two bodies apart from each other", "bodies that meet, or no [contact]")
    planes = _planes(model, len(pairs))
    return Contact(model.comm, model.space, model.coordinate_vector(), passes, planes, model.potential_scale)


def _planes(model: Model, first_number: int) -> list[PlanePass]:
    """The planes of the scene, which the outside of all bodies meets."""
    if not model.scene.planes:
        return []
    keys = model.scene.contact or ContactKeys()
    outside = surface(model.space, "outside", fenicsx.exterior_facets(model.mesh), model.bodies.order)
    points = quadrature_points(outside.kind, outside.reference)
    if keys.method == "node":
        points = nodal_points(outside.kind, outside.reference)
    size = _facet_sizes(outside)[points.facet]
    body = model.bodies.cell_body[outside.cells[points.facet]]
    stiffness = np.array([stiffness_of(m) for m in model.materials])[body]
    permittivity = np.array([permittivity_of(m) for m in model.materials])[body]
    low = reductions.least(model.comm, model.coordinates.min(axis=0, initial=np.inf))
    high = reductions.largest(model.comm, model.coordinates.max(axis=0, initial=-np.inf))
    found = []
    for number, plane in enumerate(model.scene.planes, start=first_number):
        start, normal = _place(plane, np.stack([low, high]))
        electric = permittivity if plane.potential is not None else None
        law = _interface_law(keys, size, stiffness, electric, None)
        found.append(PlanePass(number, plane, start, normal, outside, points, law, size))
    return found


def _place(plane: Plane, box: Array) -> tuple[Array, Array]:
    """A point (d,) of the plane and its unit normal (d,); box (2, d): low and high ends of all bodies."""
    dim = box.shape[1]
    if isinstance(plane.point, str):
        axis, end = SIDES[dim][plane.point]
        inward = np.eye(dim)[axis] * (1.0 if end == 0 else -1.0)
        start, normal = box[end] * np.eye(dim)[axis], np.asarray(plane.normal or inward, float)
    else:
        start, normal = np.asarray(plane.point, float), np.asarray(plane.normal, float)
    return start, normal / np.linalg.norm(normal)


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
    if keys.method != "node":  # segments begin as whole facets
        points = quadrature_points(slave.kind, slave.reference)
    else:
        shared = multiplicity(model.space, slave) if keys.nodal_weight == "unit" else None
        points = nodal_points(slave.kind, slave.reference, shared)
    size = _facet_sizes(slave)[points.facet]
    materials = [model.materials[i] for i in _bodies_of(model, slave) | _bodies_of(model, master)]
    stiffness = np.full(len(size), min(stiffness_of(m) for m in materials))
    permittivity = np.full(len(size), min(permittivity_of(m) for m in materials))
    # Where one of the bodies has no permittivity, no charge passes.
    electric = permittivity if all(m.permittivity is not None for m in materials) else None
    law = _interface_law(keys, size, stiffness, electric, model)
    depth, share, cuts = _depth(model, slave, master), 1.0 / keys.passes, keys.method == "segment"
    return ContactPass(number, slave, master, points, law, share, first, size, depth, cuts)


def _interface_law(
    keys: ContactKeys, size: Array, stiffness: Array, permittivity: Array | None, adhesive: Model | None
) -> InterfaceLaw:
    """The law at points with these facet sizes (m,), stiffnesses (m,) and permittivities (m,); adhesive: of a model."""
    penalty = np.full(len(size), keys.normal_penalty or 0.0)
    if keys.normal_penalty is None:
        penalty = keys.normal_penalty_factor * stiffness / size
    electric, fade = None, None
    if permittivity is not None:
        electric = np.where(permittivity > 0.0, keys.electric_penalty or 0.0, 0.0)
        if keys.electric_penalty is None:
            electric = keys.electric_penalty_factor * permittivity / size
        fade = FADE * size if keys.electric_range is None else np.full(len(size), keys.electric_range)
    adhesion = _adhesion(adhesive, penalty) if adhesive is not None else None
    return InterfaceLaw(penalty, adhesion, electric, fade)


def stiffness_of(material: Material) -> float:
    """Mean of the stiffnesses along the axes, MPa."""
    return float(np.diag(material.stiffness)[:3].mean())


def permittivity_of(material: Material) -> float:
    """Mean permittivity, pC/(V um); 0 for a body without potential."""
    return 0.0 if material.permittivity is None else float(np.diag(material.permittivity).mean())


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
