"""The passes of a pair of surfaces: points of the facets of one against the other, its sharp corners, and edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from piezomat.contact.corner_points import corner_points
from piezomat.contact.edge_pair import EdgePair
from piezomat.contact.interface_laws import adhesion_law, facet_sizes, interface_law
from piezomat.contact.surface_pair import SurfacePair
from piezomat.discretization.model import Model
from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.facets import corner_kind
from piezomat.forms.contact.integrals import SlavePoints, nodal_points, quadrature_points
from piezomat.meshes.contact.global_search import GhostFacets, PairingRule
from piezomat.meshes.contact.load_balance import SlaveFacets, balanced_ranks
from piezomat.meshes.contact.sharp_corners import SharpCorners, sharp_corners
from piezomat.meshes.contact.sharp_edges import EdgedFacets, sharp_edges
from piezomat.meshes.contact.surface import Surface, global_numbers, multiplicity
from piezomat.meshes.parallel import redistributed
from piezomat.scene.sections import Contact as ContactKeys

# Facets that are nearer to each other than the prescribed motion and this share of half the least thickness are
# distributed over the ranks.
NEAR = 0.1


def facet_points(keys: ContactKeys, group: SlaveFacets, shared: Array | None = None) -> SlavePoints:
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


def surface_pass(
    model: Model,
    number: int,
    slave: Surface,
    master: Surface,
    slave_component: Integers,
    master_component: Integers,
    rule: PairingRule,
    first: bool,
    thickness: Array | None = None,
    corners: SharpCorners | None = None,
) -> SurfacePair:
    """One pass, with slave facets distributed over the ranks; components (f,) of its facets here. Collective.

    corners: of the slave facets, which then are its only points, and stay with their cells.
    """
    keys, comm = model.scene.contact, model.comm
    slave_bodies, master_bodies = _bodies_of(model, slave), _bodies_of(model, master)
    depth = _depth(model, slave, master)
    numbers = global_numbers(model.unknowns.space, master.nodes)
    masters = GhostFacets(numbers, master.orientation, master.key, master_component, master.rounding)
    slaves = SlaveFacets.of(model.unknowns.space, slave, slave_component, model.bodies.cell_body[slave.cells])
    which = None
    if corners is None:
        radius = model.prescription.largest_motion() + NEAR * depth
        rank = balanced_ranks(comm, slaves, masters, master.reference, radius, rule)
        unit = keys.method == "node" and keys.nodal_weight == "unit"
        shared = redistributed(comm, multiplicity(model.unknowns.space, slave), rank) if unit else None
        slaves = slaves.redistributed(comm, rank)
        points = facet_points(keys, slaves, shared)
    else:
        points, which = corner_points(slaves, corners)
    size = facet_sizes(slaves)[points.facet]
    materials = [model.materials[i] for i in slave_bodies | master_bodies]
    stiffness = np.full(len(size), min(m.mean_stiffness for m in materials))
    permittivity = np.full(len(size), min(m.mean_permittivity for m in materials))
    # Where one of the bodies has no permittivity, no charge passes.
    electric = permittivity if all(m.electric for m in materials) else None
    law = interface_law(keys, model.prescription.largest_voltage(), size, stiffness, electric)
    return SurfacePair(
        pair=number,
        slave=slaves,
        master=masters,
        master_bodies=frozenset(master_bodies),
        rule=rule,
        points=points,
        law=law if which is not None else replace(law, adhesion=adhesion_law(comm, keys, law.penalty)),
        facet_size=size,
        share=1.0 / keys.passes if which is None else 1.0,
        corners=which,
        first=first,
        depth=depth,
        self_depth=0.5 * float(thickness.min()) if thickness is not None else depth,
        segments=keys.method == "segment" and which is None,
    )


def corner_pass(
    model: Model,
    number: int,
    slave: Surface,
    master: Surface,
    slave_component: Integers,
    master_component: Integers,
    rule: PairingRule,
    first: bool,
    thickness: Array | None = None,
    *,
    taken: bool,
) -> list[SurfacePair]:
    """A pass of the sharp corners of the slave, in a list; none where the method has points there. Collective.

    taken: whether the slave's own points are in a pass too, where `node` has one at every corner with a weight.
    """
    if taken and model.scene.contact.method == "node" and slave.kind.name != "tri6":
        return []
    corners = sharp_corners(model.unknowns.space, slave)
    if not model.comm.allreduce(len(corners)):
        return []
    some, facet = np.unique(corners.facet, return_inverse=True)
    given = slave[some], master, slave_component[some], master_component, rule, first, thickness
    return [surface_pass(model, number, *given, replace(corners, facet=facet))]


def edge_pass(
    model: Model,
    number: int,
    slave: Surface,
    master: Surface,
    slave_component: Integers,
    master_component: Integers,
    rule: PairingRule,
    first: bool,
    thickness: Array | None = None,
) -> list[SurfacePair]:
    """The crossings of sharp edges of two surfaces, in a list; none where one has no such edge. Collective."""
    if model.dim == 2:
        return []
    space = model.unknowns.space
    edges = [sharp_edges(space, surface) for surface in (slave, master)]
    edged = [np.flatnonzero((found != 0.0).any(axis=(1, 2, 3))) for found in edges]
    if not all(model.comm.allreduce(np.array([len(rows) for rows in edged]))):
        return []
    given = (
        slave[edged[0]],
        master[edged[1]],
        slave_component[edged[0]],
        master_component[edged[1]],
        rule,
        first,
        thickness,
    )
    none = SharpCorners(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 1, model.dim)))
    p = surface_pass(model, number, *given, none)
    size = facet_sizes(p.slave)
    # Without corners the pass has no points to take the law of; that of the facets is made as theirs.
    stiffness = min(model.materials[i].mean_stiffness for i in _bodies_of(model, slave) | _bodies_of(model, master))
    law = interface_law(model.scene.contact, 0.0, size, np.full(len(size), stiffness), None)
    masters = EdgedFacets(**p.master.__dict__, edges=edges[1][edged[1]])
    names = (
        "pair",
        "slave",
        "master_bodies",
        "rule",
        "points",
        "law",
        "facet_size",
        "corners",
        "first",
        "depth",
        "self_depth",
    )
    kept = {name: getattr(p, name) for name in names}
    return [EdgePair(**kept, master=masters, edges=edges[0][edged[0]], facet_law=law, size=size)]


def _depth(model: Model, *surfaces: Surface) -> float:
    """Half the least thickness of the parts that surfaces belong to, um. Collective."""
    here = {int(part) for group in surfaces for part in model.bodies.cell_part[group.cells]}
    parts = set().union(*model.comm.allgather(here))
    return 0.5 * float(model.parts.thickness[sorted(parts)].min())


def _bodies_of(model: Model, group: Surface) -> set[int]:
    """Bodies that a surface belongs to on any rank. Collective."""
    here = set(model.bodies.cell_body[group.cells].tolist())
    return set().union(*model.comm.allgather(here))
