"""From the scene's [contact] section to contact passes: which surfaces, points, penalties and adhesion."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations_with_replacement, product

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from piezomat.contact.interfaces import Interfaces
from piezomat.contact.rigid_plane import RigidPlane
from piezomat.contact.surface_pair import Pairs, SurfacePair
from piezomat.discretization.model import Model
from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.augmentation import corner_kind
from piezomat.forms.contact.integrals import SlavePoints, nodal_points, quadrature_points
from piezomat.forms.contact.laws.cohesive import CohesiveLaw
from piezomat.forms.contact.laws.interface import InterfaceLaw, stable_electric_range
from piezomat.forms.contact.laws.lennard_jones import LennardJones
from piezomat.forms.contact.laws.response import AdhesionLaw
from piezomat.meshes import parallel
from piezomat.meshes.contact.geodesic import geodesic_distance
from piezomat.meshes.contact.global_search import MASTER, ONE_TO_ONE, SLAVE, GhostFacets, PairingRule
from piezomat.meshes.contact.load_balance import SlaveFacets, balanced_ranks
from piezomat.meshes.contact.nodal_normals import smoothed
from piezomat.meshes.contact.self_contact import NEIGHBOURHOOD
from piezomat.meshes.contact.surface import Surface, body_facets, global_numbers, multiplicity, surface
from piezomat.meshes.mesh_entities import cell_volumes, exterior_facets
from piezomat.meshes.parallel import redistributed
from piezomat.scene.errors import SceneError
from piezomat.scene.sections import SIDES, Plane
from piezomat.scene.sections import Contact as ContactKeys

LISTED_BODIES = 6  # of more bodies, the pairs have no columns in the history
# Default gap over which the electric contact fades out, in facet sizes. Measured on facing_halves and crossed_fibers:
# it lowers the voltage by 3 % in 2D and 13 % in 3D, less as facets shrink; 0.01 lowers it by 1 and 2 %, but attraction
# is then so steep that there are several equilibria, and with stiff penalties Newton's method takes twice as long.
FADE = 0.1
# Of half the least thickness: how near surfaces are, beyond the motion prescribed, whose contact is shared out.
NEAR = 0.1


def interfaces_of(model: Model) -> Interfaces | None:
    """The contact of a model; None without [contact] and [[planes]]. Collective. Raises SceneError on all ranks."""
    keys = model.scene.contact
    if keys is None and not model.scene.planes:
        return None
    thickness = _fiber_thickness(model) if keys is not None and keys.self_contact else None
    if keys is None:
        passes, pairs = [], Pairs((), (), {})
    elif keys.pairs == "auto":
        passes, pairs = _of_bodies(model, thickness)
    else:
        passes, pairs = _of_scene(model)
    planes = _planes(model, len(pairs.listed))
    x, scale = model.coordinate_vector(), model.potential_scale
    geodesic = _geodesic(model, thickness) if thickness is not None else None
    return Interfaces(model.comm, model.unknowns.space, x, passes, planes, pairs, scale, geodesic)


def _of_scene(model: Model) -> tuple[list[SurfacePair], Pairs]:
    """Passes of the pairs that the scene names."""
    keys = model.scene.contact
    surfaces: dict[str, Surface] = {}
    passes = []
    for number, pair in enumerate(keys.pairs):
        for name in pair:
            if name not in surfaces:
                surfaces[name] = _surface(model, name, f"contact.pairs[{number}]")
        directions = [pair, pair[::-1]][: keys.passes]
        for first, (slave, master) in zip((True, False), directions, strict=False):
            components = [
                np.full(len(surfaces[name]), component) for name, component in ((slave, SLAVE), (master, MASTER))
            ]
            passes.append(_pass(model, number, surfaces[slave], surfaces[master], *components, ONE_TO_ONE, first))
    names = tuple("-".join(pair) for pair in keys.pairs)
    return passes, Pairs(model.bodies.bodies, names, dict(enumerate(names)))


def _of_bodies(model: Model, thickness: Array | None) -> tuple[list[SurfacePair], Pairs]:
    """Passes of every two bodies that share no node: one for all bodies of a kind against all of another.

    With self-contact, given the `thickness` of parts, every two bodies, and each with itself. A kind is what the
    penalties depend on: stiffness and permittivity.
    """
    bodies, keys = model.bodies, model.scene.contact
    rule = PairingRule(len(bodies.part_bodies), ordered=keys.passes == 1, self_contact=keys.self_contact)
    outside = exterior_facets(model.mesh)
    whole = surface(model.unknowns.space, "outside", outside, bodies.order)
    kinds = [(m.mean_stiffness, m.mean_permittivity) for m in model.materials]
    surfaces, components = {}, {}
    for kind in dict.fromkeys(kinds):
        of_kind = np.array([k == kind for k in kinds])[bodies.cell_body[whole.cells]]
        surfaces[kind] = _facets(model, "bodies", outside[of_kind])
        cells = surfaces[kind].cells
        components[kind] = rule.component(bodies.cell_body[cells], bodies.cell_part[cells])
    components_of_bodies = {kind: [] for kind in surfaces}
    for part, members in enumerate(bodies.part_bodies):
        for body in members:
            components_of_bodies[kinds[body]].append(int(rule.component(body, part)))
    passes = []
    for slave, master in product(surfaces, repeat=2):
        every = [np.array(components_of_bodies[kind]) for kind in (slave, master)]
        if any(rule.allows(component, every[1]).any() for component in every[0]):
            given = surfaces[slave], surfaces[master], components[slave], components[master]
            passes.append(_pass(model, len(passes), *given, rule, True, thickness))
    if not passes and not model.scene.planes:
        raise SceneError("contact.pairs", "no two bodies apart from each other", "bodies that meet, or no [contact]")
    return passes, _listed(model)


def _listed(model: Model) -> Pairs:
    """All pairs of bodies, if they are few."""
    bodies = model.bodies
    count = len(bodies.bodies)
    listed = {}
    if count <= LISTED_BODIES:
        parts = [{p for p, members in enumerate(bodies.part_bodies) if i in members} for i in range(count)]
        itself = model.scene.contact.self_contact
        meet = [(i, j) for i, j in combinations_with_replacement(range(count), 2) if itself or not parts[i] & parts[j]]
        listed = {i * count + j: f"{bodies.bodies[i]}-{bodies.bodies[j]}" for i, j in meet}
    return Pairs(bodies.bodies, None, listed)


def _geodesic(model: Model, thickness: Array) -> PETSc.Vec:
    """Geodesic distances of the nodes over the neighbourhood, in the first components of a vector like the state."""
    neighbourhood = NEIGHBOURHOOD * thickness[model.parts.node_part]
    vector = model.coordinate_vector()
    values = np.zeros((model.unknowns.owned, model.unknowns.block))
    distance = geodesic_distance(model.unknowns.space, model.parts.node_part, len(model.bodies.part_bodies))
    values[:, 0] = (distance / neighbourhood)[: model.unknowns.owned]
    vector.array[:] = values.ravel()
    return vector


def _fiber_thickness(model: Model) -> Array:
    """Thickness (parts,) of each part however it is bent, um: 2 (d - 1) times its volume over its surface.

    That is a fiber's diameter and the thickness of a strip in two dimensions.
    """
    bodies = model.bodies
    outside = surface(model.unknowns.space, "outside", exterior_facets(model.mesh), bodies.order)
    points = quadrature_points(outside.kind, outside.reference)
    part, parts = bodies.cell_part[outside.cells[points.facet]], len(bodies.part_bodies)
    area = parallel.total(model.comm, np.bincount(part, points.weight, parts))
    volume = parallel.total(model.comm, np.bincount(bodies.cell_part, cell_volumes(model.mesh), parts))
    return 2.0 * (model.dim - 1) * volume / area


def _planes(model: Model, first_number: int) -> list[RigidPlane]:
    """The planes of the scene, which the outside of all bodies meets."""
    if not model.scene.planes:
        return []
    keys = model.scene.contact or ContactKeys()
    surface_here = _facets(model, "outside", exterior_facets(model.mesh))
    body = model.bodies.cell_body[surface_here.cells]
    outside = SlaveFacets.of(model.unknowns.space, surface_here, np.zeros(len(body), np.int64), body)
    points = _points(keys, outside)
    size, body = _facet_sizes(outside)[points.facet], body[points.facet]
    stiffness = np.array([m.mean_stiffness for m in model.materials])[body]
    permittivity = np.array([m.mean_permittivity for m in model.materials])[body]
    low = parallel.least(model.comm, model.unknowns.coordinates.min(axis=0, initial=np.inf))
    high = parallel.largest(model.comm, model.unknowns.coordinates.max(axis=0, initial=-np.inf))
    found = []
    for number, plane in enumerate(model.scene.planes, start=first_number):
        start, normal = _place(plane, np.stack([low, high]))
        electric = permittivity if plane.potential is not None else None
        law = _interface_law(model, keys, size, stiffness, electric, adhesive=False)
        found.append(RigidPlane(number, plane, start, normal, outside, points, law, size))
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
        facets = body_facets(model.unknowns.space, bodies.cell_body, bodies.bodies.index(name))
    else:
        facets = np.intersect1d(bodies.facets[name], exterior_facets(model.mesh))
    result = _facets(model, name, facets.astype(np.int32))
    if model.comm.allreduce(len(result)) == 0:
        raise SceneError(key, f'"{name}", which has no facets on the outside', "a body or a facet group of the outside")
    return result


def _facets(model: Model, name: str, facets: NDArray[np.int32]) -> Surface:
    """The surface of some facets, curved if the scene asks for it."""
    keys, flat = model.scene.contact, surface(model.unknowns.space, name, facets, model.bodies.order)
    return smoothed(model.unknowns.space, flat) if keys is not None and keys.smoothing else flat


def _points(keys: ContactKeys, group: SlaveFacets, shared: Array | None = None) -> SlavePoints:
    """The points of a surface that the method asks for; of nodes those with unknowns alone.

    shared: the `multiplicity` of `nodal_points`. Segments begin as whole facets.
    """
    if keys.method != "node":
        return quadrature_points(group.kind, group.reference)
    if not group.rounding.shape[1]:
        return nodal_points(group.kind, group.reference, shared)
    flat = corner_kind(group.kind)
    points = nodal_points(flat, group.reference[:, : len(flat.nodes)], shared)
    return replace(points, shape=group.kind.shape(points.xi))


def _pass(
    model: Model,
    number: int,
    slave: Surface,
    master: Surface,
    slave_component: Integers,
    master_component: Integers,
    rule: PairingRule,
    first: bool,
    thickness: Array | None = None,
) -> SurfacePair:
    keys, comm = model.scene.contact, model.comm
    slave_bodies, master_bodies = _bodies_of(model, slave), _bodies_of(model, master)
    depth = _depth(model, slave, master)
    numbers = global_numbers(model.unknowns.space, master.nodes)
    masters = GhostFacets(numbers, master.orientation, master.key, master_component, master.rounding)
    slaves = SlaveFacets.of(model.unknowns.space, slave, slave_component, model.bodies.cell_body[slave.cells])
    radius = model.prescription.largest_motion() + NEAR * depth
    rank = balanced_ranks(comm, slaves, masters, master.reference, radius, rule)
    unit = keys.method == "node" and keys.nodal_weight == "unit"
    shared = redistributed(comm, multiplicity(model.unknowns.space, slave), rank) if unit else None
    slaves = slaves.redistributed(comm, rank)
    points = _points(keys, slaves, shared)
    size = _facet_sizes(slaves)[points.facet]
    materials = [model.materials[i] for i in slave_bodies | master_bodies]
    stiffness = np.full(len(size), min(m.mean_stiffness for m in materials))
    permittivity = np.full(len(size), min(m.mean_permittivity for m in materials))
    # Where one of the bodies has no permittivity, no charge passes.
    electric = permittivity if all(m.electric for m in materials) else None
    law = _interface_law(model, keys, size, stiffness, electric, adhesive=True)
    own_depth = 0.5 * float(thickness.min()) if thickness is not None else depth
    given = slaves, masters, frozenset(master_bodies), rule, points, law, 1.0 / keys.passes, first, size
    return SurfacePair(number, *given, depth, own_depth, keys.method == "segment")


def _interface_law(
    model: Model, keys: ContactKeys, size: Array, stiffness: Array, permittivity: Array | None, *, adhesive: bool
) -> InterfaceLaw:
    """The law at points with these facet sizes (m,), stiffnesses (m,) and permittivities (m,)."""
    penalty = np.full(len(size), keys.normal_penalty or 0.0)
    if keys.normal_penalty is None:
        penalty = keys.normal_penalty_factor * stiffness / size
    electric, fade = None, None
    if permittivity is not None:
        electric = np.where(permittivity > 0.0, keys.electric_penalty or 0.0, 0.0)
        if keys.electric_penalty is None:
            electric = keys.electric_penalty_factor * permittivity / size
        if keys.electric_range is not None:
            fade = np.full(len(size), keys.electric_range)
        else:
            voltage = model.prescription.largest_voltage()
            fade = np.maximum(FADE * size, stable_electric_range(voltage, permittivity, stiffness))
    adhesion = _adhesion(model, penalty) if adhesive else None
    return InterfaceLaw(penalty, adhesion, electric, fade)


def _adhesion(model: Model, penalty: Array) -> AdhesionLaw | None:
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
        return CohesiveLaw.cutoff_at(keys.strength, keys.range, penalty, keys.starts == "always")
    if energy <= 0.5 * keys.strength * longest:
        allowed = (
            f"more than strength^2 / (2 normal_penalty) = {0.5 * keys.strength * longest:g} pJ/um2, or a larger penalty"
        )
        raise SceneError("contact.adhesion.energy", f"{energy:g}", allowed)
    law = {"bilinear": CohesiveLaw.bilinear, "cutoff": CohesiveLaw.cutoff}[keys.law]
    return law(keys.strength, energy, penalty, keys.starts == "always")


def _facet_sizes(group: SlaveFacets) -> Array:
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
    return 0.5 * float(model.parts.thickness[sorted(parts)].min())


def _bodies_of(model: Model, group: Surface) -> set[int]:
    here = set(model.bodies.cell_body[group.cells].tolist())
    return set().union(*model.comm.allgather(here))
