"""From the scene's [contact] and [[planes]] to surface pairs and rigid planes: their surfaces, points and ranks."""

from __future__ import annotations

from itertools import combinations, combinations_with_replacement

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from piezomat.contact.gap_exchange import GapExchange
from piezomat.contact.interface_laws import (
    check_adhesion,
    facet_sizes,
    gap_medium,
    normal_penalty,
    with_equal_potential,
)
from piezomat.contact.interfaces import Interfaces
from piezomat.contact.pair_laws import PairLaws
from piezomat.contact.pairs import Pairs
from piezomat.contact.plate_capacitor import PlateCapacitor
from piezomat.contact.rigid_plane import RigidPlane
from piezomat.contact.segmented_pair import SegmentedPair
from piezomat.contact.slave_points import facets_at_corners, has_corner_points, slave_points
from piezomat.contact.surface_pair import SurfacePair
from piezomat.discretization.model import Model
from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.facets import corner_kind
from piezomat.forms.contact.integrals import facet_areas
from piezomat.forms.contact.laws.law import ContactLaw
from piezomat.forms.contact.laws.penalty import NormalPenalty
from piezomat.meshes import parallel
from piezomat.meshes.contact.geodesic import geodesic_distance
from piezomat.meshes.contact.global_search import MASTER, ONE_TO_ONE, SLAVE, GhostFacets, PairingRule
from piezomat.meshes.contact.load_balance import SlaveFacets, balanced_ranks
from piezomat.meshes.contact.nodal_normals import smoothed
from piezomat.meshes.contact.self_contact import NEIGHBOURHOOD
from piezomat.meshes.contact.shadow import covered_area
from piezomat.meshes.contact.sharp_corners import SharpNodes, corners_towards_plane
from piezomat.meshes.contact.surface import Surface, body_facets, global_numbers, multiplicity, surface
from piezomat.meshes.mesh_entities import cell_volumes, exterior_facets
from piezomat.meshes.parallel import redistributed
from piezomat.scene.errors import SceneError, named, shown
from piezomat.scene.sections import SIDES, Plane
from piezomat.scene.sections import Contact as ContactKeys

LISTED_BODIES = 6  # of more bodies, the pairs have no columns in the history
NARROW = 0.02  # share of the width of blending where Newton's method cycles about shared points
# Facets that are nearer to each other than the prescribed motion and this share of half the least thickness are
# distributed over the ranks.
NEAR = 0.1
COVERED = 1e-6  # share of planes that is free by rounding


def interfaces_of(model: Model) -> Interfaces | None:
    """The contact of a model; None without [contact] and [[planes]]. Collective. Raises SceneError on all ranks."""
    keys = model.scene.contact
    if keys is None and not model.scene.planes:
        return None
    thickness = _fiber_thickness(model) if keys is not None and keys.self_contact else None
    names = tuple(plane.name for plane in model.scene.planes)
    space = model.unknowns.space
    sharp = SharpNodes.of(space, surface(space, "outside", exterior_facets(model.mesh), model.bodies.order))
    if keys is None:
        surface_pairs, pairs = [], Pairs((), (), {}, names)
    elif keys.pairs == "auto":
        surface_pairs, pairs = _of_bodies(model, sharp, thickness, names)
    else:
        surface_pairs, pairs = _of_scene(model, sharp, names)
    planes, plates = _planes(model, sharp, len(pairs.listed))
    x, scale = model.coordinate_vector(), model.potential_scale
    geodesic = _geodesic(model, thickness) if thickness is not None else None
    given = model.comm, space, x, surface_pairs, planes, pairs, scale, geodesic, plates
    return Interfaces(*given, augmented=keys is not None and keys.augment is not None)


def _of_scene(model: Model, sharp: SharpNodes, planes: tuple[str, ...]) -> tuple[list[SurfacePair], Pairs]:
    """The passes of the pairs that the scene names."""
    keys = model.scene.contact
    surfaces: dict[str, Surface] = {}
    passes = []
    for number, pair in enumerate(keys.pairs):
        for name in pair:
            if name not in surfaces:
                surfaces[name] = _surface(model, name, f"contact.pairs[{number}]")
    _check_twice(model, surfaces)
    for number, pair in enumerate(keys.pairs):
        directions = [pair, pair[::-1]][: keys.passes]
        for first, (slave, master) in zip((True, False), directions, strict=False):
            components = [
                np.full(len(surfaces[name]), component) for name, component in ((slave, SLAVE), (master, MASTER))
            ]
            some = [any(model.materials[i].electric for i in _bodies_of(model, surfaces[name])) for name in pair]
            laws = _laws(model, electric=all(some))
            given = surfaces[slave], surfaces[master], *components
            passes.append(_pass(model, sharp, number, *given, ONE_TO_ONE, first, laws))
    names = tuple("-".join(pair) for pair in keys.pairs)
    return passes, Pairs(model.bodies.bodies, names, dict(enumerate(names)), planes)


def _check_twice(model: Model, surfaces: dict[str, Surface]) -> None:
    """Raise SceneError where two pairs have facets of both sides in common, or both sides of one pair. Collective."""
    names = list(surfaces)
    keys = [surface.key for surface in surfaces.values()]
    count = np.array([[len(np.intersect1d(one, other)) for other in keys] for one in keys])
    count = model.comm.allreduce(count)
    pairs = [tuple(names.index(name) for name in pair) for pair in model.scene.contact.pairs]
    for i, (slave, master) in enumerate(pairs):
        key, found = f"contact.pairs[{i}]", " and ".join(shown(name) for name in model.scene.contact.pairs[i])
        if count[slave, master]:
            common = f"{found}, which have {count[slave, master]} facets in common"
            raise SceneError(key, common, "two surfaces without common facets")
        for j, (one, other) in enumerate(pairs[:i]):
            for ours, theirs in ((count[slave, one], count[master, other]), (count[slave, other], count[master, one])):
                if ours and theirs:
                    twice = f"{found}, which have {ours} and {theirs} facets in common with contact.pairs[{j}]"
                    raise SceneError(key, twice, "each two facets in one pair alone: in two they would meet twice")


def _of_bodies(
    model: Model, sharp: SharpNodes, thickness: Array | None, planes: tuple[str, ...]
) -> tuple[list[SurfacePair], Pairs]:
    """The one pass of all bodies against all: every two bodies that share no node.

    With self-contact, given the `thickness` of parts, every two bodies, and each with itself.
    """
    bodies, keys = model.bodies, model.scene.contact
    rule = PairingRule(len(bodies.part_bodies), ordered=keys.passes == 1, self_contact=keys.self_contact)
    outside = exterior_facets(model.mesh)
    every = _facets(model, "bodies", outside)
    component = rule.component(bodies.cell_body[every.cells], bodies.cell_part[every.cells])
    numbers = [(int(rule.component(body, part)), body) for part, some in enumerate(bodies.part_bodies) for body in some]
    passes = []
    if _may_meet(rule, [number for number, _ in numbers]):
        electric = [number for number, body in numbers if model.materials[body].electric]
        laws = _laws(model, electric=_may_meet(rule, electric))
        passes.append(_pass(model, sharp, 0, every, every, component, component, rule, True, laws, thickness))
    if not passes and not model.scene.planes:
        bonded = [
            f"{named([bodies.bodies[i] for i in members])} share nodes, which bonds them"
            for members in bodies.part_bodies
            if len(members) > 1
        ]
        found = f"no two bodies apart from each other: {'; '.join(bonded)}"
        raise SceneError("contact.pairs", found, "bodies that meet, or no [contact]")
    return passes, _pairs_of_bodies(model, planes)


def _may_meet(rule: PairingRule, components: list[int]) -> bool:
    """Whether any two of these components may meet, or one itself."""
    every = np.array(components, np.int64)
    return any(bool(rule.allows(component, every).any()) for component in every)


def _laws(model: Model, *, electric: bool) -> PairLaws:
    """The laws of any two bodies of the model; electric: whether two that have a permittivity may meet."""
    voltage = model.prescription.largest_voltage()
    return PairLaws.of(model.scene.contact, model.materials, gap_medium(model), voltage, electric=electric)


def _pairs_of_bodies(model: Model, planes: tuple[str, ...]) -> Pairs:
    """Any two bodies; those that may meet are listed if they are few."""
    bodies = model.bodies
    count = len(bodies.bodies)
    listed = {}
    if count <= LISTED_BODIES:
        parts = [{p for p, members in enumerate(bodies.part_bodies) if i in members} for i in range(count)]
        itself = model.scene.contact.self_contact
        meet = [(i, j) for i, j in combinations_with_replacement(range(count), 2) if itself or not parts[i] & parts[j]]
        listed = {i * count + j: f"{bodies.bodies[i]}-{bodies.bodies[j]}" for i, j in meet}
    return Pairs(bodies.bodies, None, listed, planes)


def _geodesic(model: Model, thickness: Array) -> PETSc.Vec:
    """Geodesic distances of the nodes over the neighbourhood, in the first components of a vector like the state."""
    neighbourhood = NEIGHBOURHOOD * thickness[model.parts.node_part]
    vector = model.coordinate_vector()
    values = np.zeros((model.unknowns.owned, model.unknowns.block))
    distance = geodesic_distance(model.unknowns.space, model.parts.node_part, len(model.bodies.part_bodies))
    values[:, 0] = (distance / neighbourhood)[: model.unknowns.owned]
    model.unknowns.set_by_node(vector, values)
    return vector


def _fiber_thickness(model: Model) -> Array:
    """Thickness (parts,) of each part however it is bent, um: 2 (d - 1) times its volume over its surface.

    That is a fiber's diameter and the thickness of a strip in two dimensions.
    """
    bodies = model.bodies
    outside = surface(model.unknowns.space, "outside", exterior_facets(model.mesh), bodies.order)
    part, parts = bodies.cell_part[outside.cells], len(bodies.part_bodies)
    area = parallel.total(model.comm, np.bincount(part, facet_areas(outside.kind, outside.reference), parts))
    volume = parallel.total(model.comm, np.bincount(bodies.cell_part, cell_volumes(model.mesh), parts))
    return 2.0 * (model.dim - 1) * volume / area


def _planes(model: Model, sharp: SharpNodes, first_number: int) -> tuple[list[RigidPlane], list[PlateCapacitor]]:
    """The planes of the scene, which the outside of all bodies meets, and what they are with each other."""
    if not model.scene.planes:
        return [], []
    keys = model.scene.contact or ContactKeys()
    surface_here = _facets(model, "outside", exterior_facets(model.mesh))
    body = model.bodies.cell_body[surface_here.cells]
    outside = SlaveFacets.of(model.unknowns.space, surface_here, np.zeros(len(body), np.int64), body)
    low = parallel.least(model.comm, model.unknowns.coordinates.min(axis=0, initial=np.inf))
    high = parallel.largest(model.comm, model.unknowns.coordinates.max(axis=0, initial=-np.inf))
    places = [_place(plane, np.stack([low, high]), model.unknowns.origin) for plane in model.scene.planes]
    closed, edges = np.zeros(len(outside), bool), sharp.of_facets(surface_here) >= 0
    if not has_corner_points(keys, outside):
        reach = model.prescription.largest_motion() + _depth(model, surface_here)
        for start, normal in places:
            closed |= corners_towards_plane(model.comm, sharp, surface_here, start, normal, reach).any(axis=1)
    points = slave_points(keys, outside, closed)
    size, body = facet_sizes(outside)[points.facet], body[points.facet]
    stiffness = np.array([m.mean_stiffness for m in model.materials])[body]
    permittivity = np.array([m.mean_permittivity for m in model.materials])[body]
    voltage, medium = model.prescription.largest_voltage(), gap_medium(model)
    electrodes = model.constraints.electrodes
    nodes = {name: model.unknowns.reference_node(e.reference) for e in electrodes for name in e.planes}
    pushed = {p.plane.name: p for p in model.constraints.pushed}
    found = []
    for number, (plane, (start, normal)) in enumerate(zip(model.scene.planes, places, strict=True), start=first_number):
        is_electrode = plane.potential is not None or plane.name in nodes
        law: ContactLaw = NormalPenalty(normal_penalty(keys, size, stiffness))
        if is_electrode and medium is not None:
            law += medium.laws(size, stiffness, permittivity)[0]
        elif is_electrode:
            law = with_equal_potential(law, keys, voltage, size, stiffness, permittivity)
        push = pushed.get(plane.name)
        found.append(
            RigidPlane(
                pair=number,
                plane=plane,
                start=start,
                normal=normal,
                sharp=edges,
                reference_node=nodes.get(plane.name),
                travel_node=None if push is None else model.unknowns.reference_node(push.reference),
                direction=None if push is None else push.direction,
                slave=outside,
                points=points,
                law=law,
                facet_size=size,
            )
        )
    return found, [] if medium is None else _plates(model, found, medium.permittivity)


def _plates(model: Model, planes: list[RigidPlane], permittivity: float) -> list[PlateCapacitor]:
    """What planes with a known area are with each other where no body lies between them. Collective."""
    found = []
    for first, second in combinations(planes, 2):
        both = first.plane, second.plane
        # A given area comes before that of the box.
        areas = [p.area for p in both if p.area] or [a for p in both if (a := model.scene.area_of(p))]
        if not (areas and PlateCapacitor.is_between(first, second)):
            continue
        corners = first.slave.reference[:, : len(corner_kind(first.slave.kind).nodes)]
        area = min(areas)
        free = area - covered_area(model.comm, corners, first.normal)
        if free > COVERED * area:
            found.append(PlateCapacitor(first, second, free, permittivity, here=model.comm.rank == 0))
    return found


def _place(plane: Plane, box: Array, origin: Array) -> tuple[Array, Array]:
    """A point (d,) of the plane and its unit normal (d,); box (2, d): low and high ends of all bodies.

    Point and box are relative to the origin (d,) of the nodes' coordinates.
    """
    dim = box.shape[1]
    if isinstance(plane.point, str):
        axis, end = SIDES[dim][plane.point]
        return box[end] * np.eye(dim)[axis], plane.inward(dim)
    return np.asarray(plane.point, float) - origin, plane.inward(dim)


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


def _pass(
    model: Model,
    sharp: SharpNodes,
    number: int,
    slave: Surface,
    master: Surface,
    slave_component: Integers,
    master_component: Integers,
    rule: PairingRule,
    first: bool,
    laws: PairLaws,
    thickness: Array | None = None,
) -> SurfacePair:
    """One pass, with slave facets distributed over the ranks; components (f,) of its facets here. Collective."""
    keys, comm = model.scene.contact, model.comm
    master_bodies, bodies = _bodies_of(model, master), model.bodies.cell_body
    depth = _depth(model, slave, master)
    numbers = global_numbers(model.unknowns.space, master.nodes)
    of_masters = np.asarray(bodies[master.cells], np.int64)
    masters = GhostFacets(numbers, master.orientation, master.key, master_component, of_masters, master.rounding)
    slaves = SlaveFacets.of(model.unknowns.space, slave, slave_component, bodies[slave.cells])
    radius = model.prescription.largest_motion() + NEAR * depth
    rank = balanced_ranks(comm, slaves, masters, master.reference, radius, rule)
    unit = keys.method == "node" and keys.nodal_weight == "unit"
    shared = redistributed(comm, multiplicity(model.unknowns.space, slave), rank) if unit else None
    reach = model.prescription.largest_motion() + depth
    sides = (slave, slave_component), (master, master_component)
    closed, unseen = facets_at_corners(comm, keys, sharp, *sides, reach, rule)
    edges = redistributed(comm, sharp.of_facets(slave) >= 0, rank)
    slaves, closed = slaves.redistributed(comm, rank), redistributed(comm, closed, rank)
    points = slave_points(keys, slaves, closed, shared)
    sizes = facet_sizes(slaves)
    size = sizes[points.facet]
    self_depth = 0.5 * float(thickness.min()) if thickness is not None else depth
    given = size, laws.kind[slaves.body][points.facet], np.full(len(size), laws.softest(master_bodies))
    check_adhesion(comm, keys, float(laws.penalty(*given).min(initial=np.inf)))
    law = laws.at(*given)
    exchange = None
    if laws.electric and laws.medium is not None:
        exchange = GapExchange(slaves, laws, sizes, 1.0 / keys.passes, law.equilibrium_gap)
    pair_class = SegmentedPair if keys.method == "segment" else SurfacePair
    return pair_class(
        pair=number,
        slave=slaves,
        master=masters,
        master_bodies=frozenset(master_bodies),
        rule=rule,
        points=points,
        law=law,
        laws=laws,
        facet_size=size,
        share=1.0 / keys.passes,
        first=first,
        depth=depth,
        self_depth=self_depth,
        closed=closed,
        sharp=edges,
        unseen_corners=unseen,
        blending=_blending(model, keys.method, exchange),
        exchange=exchange,
    )


def _blending(model: Model, method: str, exchange: GapExchange | None) -> float:
    """Width over which facets share points near their edges, over that of `blending`.

    With a medium, Newton's method cycles about shared points in two cases, and does not without: nodes (two of 18 runs
    of discs of 30 to 60 facets, pressed by up to a third of their thickness), and prescribed voltages, whose attraction
    is strong (PZT-5H, 20 V, a load). Facets then share little more than what lies over an edge: by symmetry nodes do,
    and one facet alone pushed one pass of them sideways by 3 % of the force.
    """
    cycles = exchange is not None and (method == "node" or model.prescription.largest_voltage() > 0.0)
    return NARROW if cycles else 1.0


def _depth(model: Model, *surfaces: Surface) -> float:
    """Half the least thickness of the parts that surfaces belong to, um. Collective."""
    here = {int(part) for group in surfaces for part in model.bodies.cell_part[group.cells]}
    parts = set().union(*model.comm.allgather(here))
    return 0.5 * float(model.parts.thickness[sorted(parts)].min())


def _bodies_of(model: Model, group: Surface) -> set[int]:
    """Bodies that a surface belongs to on any rank. Collective."""
    here = set(model.bodies.cell_body[group.cells].tolist())
    return set().union(*model.comm.allgather(here))
