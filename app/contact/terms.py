"""What contact passes and planes add to residual and tangent at a state, summed over each pair of facets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezomat.contact.active_set import linearized_response, response
from piezomat.contact.nodal_state import NodalState
from piezomat.contact.rigid_plane import RigidPlane
from piezomat.contact.surface_pair import SurfacePair
from piezomat.forms.arrays import Array
from piezomat.forms.contact.integrals import contact_vectors
from piezomat.forms.contact.laws.response import Response


@dataclass
class ContactTerms:
    """For each pair of facets in contact its nodes (k, n) (numbers in `Contact.nodes`) and its terms.

    vectors (k, n, block_size) and, of the tangent, matrices (k, n * block_size, n * block_size).
    """

    nodes: NDArray[np.int64]
    vectors: Array
    matrices: Array | None


def no_terms(p: SurfacePair | RigidPlane, block_size: int, *, tangent: bool) -> ContactTerms:
    """The terms of a pass where nothing is in contact."""
    n = 2 * p.slave.nodes.shape[1]
    matrices = np.zeros((0, n * block_size, n * block_size)) if tangent else None
    return ContactTerms(np.zeros((0, n), np.int64), np.zeros((0, n, block_size)), matrices)


def surface_terms(p: SurfacePair, at: NodalState, *, tangent: bool, viscous: bool) -> ContactTerms:
    """The terms of a pass whose points have met their partners; sets its `jump`, `gap`, `response` and `force`.

    viscous: whether the pass's drag counts.
    """
    kind, rows, partner = p.slave.kind, p.projected_points, p.partner
    facet, xi, shape = p.points.facet[rows], p.points.xi[rows], p.points.shape[rows]
    p.jump = None
    if at.potentials is not None and p.law.electric_penalty is not None:
        here, there = p.potentials_at(at.potentials, facet, partner)
        p.jump = np.einsum("mk,mk->m", shape, here)
        p.jump = at.scale * (p.jump - np.einsum("mk,mk->m", kind.shape(p.projection.xi), there))
    shift = p.multipliers.at(kind, facet, xi)
    p.gap = p.projection.gap + shift[0]
    r = p.response = response(p, at, shift)
    if viscous:
        r.slope = r.slope + p.viscous_bonds.traction(p.projection.gap, rows)
        r.curvature = r.curvature + p.viscous_bonds.stiffness[rows]
    active = (r.slope != 0.0) | (r.curvature != 0.0) | (r.electric_curvature != 0.0)
    scaled, (slope, charge) = r, linearized_response(p)
    if p.jump is not None:
        scaled = Response(**{**r.__dict__, "charge": at.scale * r.charge, "mixed": at.scale * r.mixed})
        scaled.electric_curvature = at.scale**2 * r.electric_curvature
        charge = at.scale * charge
    scaled = Response(**{name: value[active] for name, value in scaled.__dict__.items()})
    vectors, matrices = contact_vectors(
        kind,
        p.projection[active],
        shape[active],
        p.share * p.points.weight[rows][active],
        (slope[active], charge[active]),
        scaled,
        at.block_size,
        there[active] if p.jump is not None else None,
        tangent=tangent,
        geometric_stiffness=at.consistent_tangent,
        roundings=(p.slave.rounding[facet[active]], p.ghost_facets.rounding[partner[active]]),
    )
    d = at.position.shape[1]
    p.force = np.zeros((len(rows), d))
    p.force[active] = -vectors[:, : vectors.shape[1] // 2, :d].sum(axis=1)
    facet, partner, masters = facet[active], partner[active], max(len(p.ghost_facets), 1)
    nodes = np.concatenate([p.slave_nodes[facet], p.master_nodes[partner]], axis=1)
    return _sum_by_pair(facet * masters + partner, nodes, vectors, matrices)


def plane_terms(p: RigidPlane, at: NodalState, *, tangent: bool) -> ContactTerms:
    """The terms of a plane, which is evaluated for them."""
    terms = _sum_by_pair(*p.evaluate(at, tangent=tangent))
    # A plane has no nodes: the second half of the pair of facets is the slave's again, where nothing is added.
    n, matrices = terms.nodes.shape[1], terms.matrices
    if matrices is not None:
        matrices = np.pad(matrices, ((0, 0), *((0, matrices.shape[1]),) * 2))
    nodes = np.concatenate([terms.nodes, terms.nodes], axis=1)
    return ContactTerms(nodes, np.pad(terms.vectors, ((0, 0), (0, n), (0, 0))), matrices)


def _sum_by_pair(
    pair: NDArray[np.int64], nodes: NDArray[np.int64], vectors: Array, matrices: Array | None
) -> ContactTerms:
    """Sums over the points of each facet pair: the matrix is scattered once a pair, not once a point."""
    if not len(pair):
        return ContactTerms(nodes, vectors, matrices)
    order = np.argsort(pair, kind="stable")
    first = np.unique(pair[order], return_index=True)[1]
    summed = None if matrices is None else np.add.reduceat(matrices[order], first)
    return ContactTerms(nodes[order[first]], np.add.reduceat(vectors[order], first), summed)
