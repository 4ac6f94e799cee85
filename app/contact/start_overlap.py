"""How deep bodies that may meet lie inside each other in the undeformed state."""

from __future__ import annotations

import numpy as np

from piezomat.contact.interfaces import Interfaces
from piezomat.contact.seen_nodes import SeenNodes
from piezomat.discretization.model import Model
from piezomat.forms.arrays import Array, Booleans
from piezomat.forms.contact.facets import Facets
from piezomat.meshes import parallel
from piezomat.meshes.contact.facet_bounds import near_points
from piezomat.meshes.contact.global_search import CandidatePairs, GhostFacets, PairingRule, share_facets
from piezomat.meshes.contact.overlap import deepest_overlap
from piezomat.meshes.contact.surface import global_numbers, surface
from piezomat.meshes.mesh_entities import exterior_facets


def start_overlap(model: Model, contact: Interfaces) -> float:
    """Largest depth (um) of the middle of an outside facet of one body inside another that it may meet. Collective.

    What is inside is told by the whole outside of a connected part, which is closed: a facet group as the side of a
    pair is not, and behind it lies what is beside the body, or beyond its other side.
    """
    space, bodies = model.unknowns.space, model.bodies
    outside = surface(space, "outside", exterior_facets(model.mesh), bodies.order)
    part, rule = bodies.cell_part[outside.cells].astype(np.int64), PairingRule(len(bodies.part_bodies))
    component, margin = rule.component(part, part), float(model.parts.thickness.min())
    numbers = global_numbers(space, outside.nodes)
    masters = GhostFacets(numbers, outside.orientation, outside.key, component, part, outside.rounding)
    position = model.unknowns.coordinates[outside.nodes]
    masters = share_facets(model.comm, position, component, masters, position, margin, rule)
    coordinates = model.coordinate_vector()
    nodes = SeenNodes(coordinates, model.unknowns.block, model.dim, [masters.nodes])
    coordinates.destroy()
    body = Facets(outside.kind, nodes.reference[nodes.places(masters.nodes)], masters.orientation, masters.key)
    middles = position.mean(axis=1)
    near = CandidatePairs.near(middles, component, body.nodes, masters.component, margin, rule)
    boxes = _boxes(model)
    may_meet, deepest = _may_meet(model, contact), 0.0
    for number, facets, points in zip(near.component, near.facets, near.points, strict=True):
        other = rule.body(number)
        points = points[may_meet[part[points], other]]
        within = (middles[points] > boxes[0, other]) & (middles[points] < boxes[1, other])
        points = points[within.all(axis=1)]
        points = points[near_points(middles[points], body.nodes[facets], margin)]
        deepest = max(deepest, deepest_overlap(middles[points], body[facets]))
    return float(parallel.largest(model.comm, np.array([deepest]))[0])


def _boxes(model: Model) -> Array:
    """Low and high ends (2, parts, d) of the connected parts, um. Collective."""
    x, part = model.unknowns.coordinates, model.parts.node_part
    low, high = np.full((2, len(model.parts), model.dim), [[[np.inf]], [[-np.inf]]])
    np.minimum.at(low, part, x)
    np.maximum.at(high, part, x)
    return np.stack([parallel.least(model.comm, low), parallel.largest(model.comm, high)])


def _may_meet(model: Model, contact: Interfaces) -> Booleans:
    """Whether two connected parts (parts, parts) may meet. Collective."""
    members = model.bodies.part_bodies
    if contact.pairs.named is None:
        return np.ones((len(members), len(members)), bool)
    found: Booleans = np.zeros((len(members), len(members)), bool)
    for p in contact.surface_pairs:
        slaves = set().union(*model.comm.allgather(set(p.slave.body.tolist())))
        ours, theirs = (np.array([not some.isdisjoint(each) for each in members]) for some in (slaves, p.master_bodies))
        found |= ours[:, None] & theirs
    return found
