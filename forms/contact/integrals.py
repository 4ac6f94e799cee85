"""Contact integrals: integration points with their weights, and the residual and tangent of each point.

`node`, `point` (and `segment`) contact differ only in points and weights; the integrand is the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np

from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.forms.contact.facets import FacetKind, closed_triangle_rule
from piezomat.forms.contact.gap import Projection, Variations, variations
from piezomat.forms.contact.smoothing import to_corners


@dataclass(frozen=True)
class SlavePoints:
    """Integration points of a slave surface.

    facet (m,): slave facet; place (m,): number within the facet
    xi (m, t): reference coordinates; shape (m, n): shape functions there
    weight (m,): of the contact integral, um2 (2D: um), or without unit for springs of one node each
    area (m,): undeformed area of the point, um2 (2D: um); the weight unless weights have no unit
    """

    facet: Integers
    place: Integers
    xi: Array
    shape: Array
    weight: Array
    area: Array

    def __getitem__(self, rows: Integers | Booleans) -> SlavePoints:
        return SlavePoints(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))

    def followed_by(self, more: SlavePoints) -> SlavePoints:
        """These points, then more."""
        names = self.__dataclass_fields__
        return SlavePoints(*(np.concatenate([getattr(self, name), getattr(more, name)]) for name in names))


def _surface_metric(kind: FacetKind, xi: Array, nodes: Array) -> Array:
    """Area per reference area (facets, points) of facets with nodes (facets, n, d) at xi (points, t)."""
    tangents = np.stack([np.einsum("qk,fkd->fqd", kind.shape(xi, (a,)), nodes) for a in range(kind.dim)], axis=2)
    return np.sqrt(np.linalg.det(tangents @ np.swapaxes(tangents, 2, 3)))


def facet_areas(kind: FacetKind, nodes: Array) -> Array:
    """Areas (facets,), um2 (2D: lengths, um), of facets with undeformed nodes (facets, n, d), um."""
    xi, weight = kind.quadrature()
    return (_surface_metric(kind, xi, nodes) * weight).sum(axis=1)


def quadrature_points(kind: FacetKind, nodes: Array) -> SlavePoints:
    """Gauss points of facets with undeformed nodes (facets, n, d), um."""
    xi, weight = kind.quadrature()
    area = _surface_metric(kind, xi, nodes) * weight
    return _points(kind, xi, area, area)


def nodal_points(kind: FacetKind, nodes: Array, multiplicity: Array | None = None) -> SlavePoints:
    """Nodes of facets with undeformed nodes (facets, n, d), um, weighted by their area, the integral of N_i.

    A node appears once for each of its facets, with its share of the area. At the corners of 6-node triangles the
    integral of N_i vanishes: their only points are the nodes of the sides.

    multiplicity (facets, n): number of facets that share each node; with it weights are 1 / multiplicity, one spring
        for each node whatever its area, as printed by Maruccio et al. (2020)
    """
    xi, weight = kind.quadrature()
    area = _surface_metric(kind, xi, nodes) * weight
    share = area @ kind.shape(xi)
    if kind.name == "tri6":
        share[:, :3] = 0.0
        share *= area.sum(axis=1, keepdims=True) / share.sum(axis=1, keepdims=True)
    return _points(kind, kind.nodes, share, share if multiplicity is None else 1.0 / multiplicity)


def closed_points(kind: FacetKind, nodes: Array) -> SlavePoints:
    """Points of facets with undeformed nodes (facets, n, d), um, that have some at all corners.

    They are the nodes, and of 6-node triangles the middle too.
    """
    if kind.name != "tri6":
        return nodal_points(kind, nodes)
    xi, weight = closed_triangle_rule()
    area = _surface_metric(kind, xi, nodes) * weight
    return _points(kind, xi, area, area)


def with_closed_points(
    points: SlavePoints, kind: FacetKind, nodes: Array, closed: Booleans
) -> tuple[SlavePoints, Booleans]:
    """The points of facets with undeformed nodes (facets, n, d), with `closed_points` on those that are `closed`.

    They follow each other by facet. Also whether each of them is a new one.
    """
    facets = np.flatnonzero(closed)
    more = closed_points(kind, nodes[facets])
    kept = points[~closed[points.facet]]
    every = kept.followed_by(replace(more, facet=facets[more.facet]))
    order = np.argsort(every.facet, kind="stable")
    return every[order], order >= len(kept.facet)


def nodes_of(kind: FacetKind, facets: Integers) -> SlavePoints:
    """The nodes of some facets (f,), without weights: places where a surface is looked at, not integrated."""
    facet, place = (index.ravel() for index in np.indices((len(facets), len(kind.nodes))))
    none = np.zeros(len(facet))
    return SlavePoints(facets[facet], place, kind.nodes[place], kind.shape(kind.nodes)[place], none, none)


def _points(kind: FacetKind, xi: Array, area: Array, weight: Array) -> SlavePoints:
    facets, places = weight.shape
    facet = np.repeat(np.arange(facets), places)
    place = np.tile(np.arange(places), facets)
    area, weight = area.ravel(), weight.ravel()
    used = area > 0.0
    facet, place = facet[used], place[used]
    return SlavePoints(facet, place, xi[place], kind.shape(xi)[place], weight[used], area[used])


@dataclass(frozen=True)
class FacetPairs:
    """Pairs of slave and master facets (k,), in the unknowns of whose nodes the kinematics of contact points are given.

    kind, projection: master facets and the closest points of the pairs' points on them
    slave_shape (k, n): shape functions of the slave facets at the points
    components: unknowns of a node, c
    potentials (k, n): nodal values of the potential unknown on the master facets; None without a jump
    roundings: offsets (k, i, d) of smoothed slave and master facets, whose nodes in the pair are the corners only
    """

    kind: FacetKind
    projection: Projection
    slave_shape: Array
    components: int
    potentials: Array | None
    roundings: tuple[Array, Array] | None = None

    def vary(self, function: tuple[Array, Array] | None = None, *, second: bool) -> Variations:
        """Variations of gap and jump, see `variations`, in terms of the nodes with unknowns."""
        given = self.kind, self.projection, self.slave_shape, self.components, self.potentials
        v = variations(*given, function, second=second)
        return replace(v, rows=over_unknowns(self.kind, v.rows, self.roundings))


@dataclass(frozen=True)
class PointForces:
    """Gradients and Hessians of m points by their kinematics q (m, k): the gap, and the jump of the potential unknown.

    weight (m,): of the integral
    residual (m, k): gradient that the residual has: at the present gaps and jumps, also where others are predicted
    tangent (m, k): gradient whose changes of direction the tangent has; zero for the gap without geometric stiffness
    hessian (m, k, k): of the tangent
    """

    weight: Array
    residual: Array
    tangent: Array
    hessian: Array

    def __getitem__(self, points: Integers) -> PointForces:
        return PointForces(self.weight[points], self.residual[points], self.tangent[points], self.hessian[points])


def contact_vectors(pairs: FacetPairs, forces: PointForces, *, tangent: bool) -> tuple[Array, Array | None]:
    """Residual vectors (m, n_pair, c) and, with `tangent`, matrices (m, n_pair * c, n_pair * c) of contact points.

    Derivatives of weight * enthalpy by the unknowns of each point's pair, slave nodes first.
    """
    v = pairs.vary(second=tangent)
    along = _sum(forces.residual, v.first)
    m, r, nodes, components = v.rows.shape
    rows = v.rows.reshape(m, r, nodes * components)
    vectors = np.einsum("m,mr,mrn->mn", forces.weight, along, rows).reshape(m, nodes, components)
    if not tangent:
        return vectors, None
    matrix = _sum(forces.tangent, v.second)
    for i, one in enumerate(v.first):
        matrix += forces.hessian[:, i, i, None, None] * one[:, :, None] * one[:, None, :]
        for j, other in enumerate(v.first[:i]):
            cross = one[:, :, None] * other[:, None, :]
            matrix += forces.hessian[:, i, j, None, None] * (cross + np.swapaxes(cross, 1, 2))
    matrix *= forces.weight[:, None, None]
    return vectors, np.swapaxes(rows, 1, 2) @ (matrix @ rows)


def _sum(factors: Array, values: list[Array]) -> Array:
    """Sum over k of factors (m, k) times values (m, ...)."""
    each = (factors[:, k].reshape(-1, *[1] * (value.ndim - 1)) * value for k, value in enumerate(values))
    return reduce(add, each)


def first_changes(pairs: FacetPairs, change: Array) -> Array:
    """First-order changes (m, k) of gap and jump for changes (m, n_pair, c) of each pair's unknowns, slave nodes first.

    The jump is that of the potential unknown.
    """
    v = pairs.vary(second=False)
    along = np.einsum("mrnc,mnc->mr", v.rows, change)
    return np.stack([np.einsum("mr,mr->m", first, along) for first in v.first], axis=1)


def over_unknowns(kind: FacetKind, rows: Array, roundings: tuple[Array, Array] | None) -> Array:
    """Rows (m, r, n_pair, c) in terms of the nodes with unknowns, which are the corners of smoothed facets."""
    if roundings is None or not roundings[0].shape[1]:
        return rows
    n = len(kind.nodes)
    sides = zip((rows[:, :, :n], rows[:, :, n:]), roundings, strict=True)
    return np.concatenate([to_corners(kind, side, offsets) for side, offsets in sides], axis=2)
