"""Contact integrals: integration points with their weights, and the residual and tangent of each point.

`node`, `point` (and `segment`) contact differ only in points and weights; the integrand is the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.facets import FacetKind
from piezomat.forms.contact.gap import Projection, variations
from piezomat.forms.contact.laws.response import Response
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


def contact_vectors(
    kind: FacetKind,
    projection: Projection,
    slave_shape: Array,
    weight: Array,
    first: tuple[Array, Array],
    response: Response,
    components: int,
    potentials: Array | None,
    *,
    tangent: bool,
    geometric_stiffness: bool = True,
    roundings: tuple[Array, Array] | None = None,
) -> tuple[Array, Array | None]:
    """Residual vectors (m, n_pair, c) and, with `tangent`, matrices (m, n_pair * c, n_pair * c) of contact points.

    Derivatives of weight * enthalpy by the unknowns of the pair, slave nodes first.

    kind, projection: master facets and the closest points of the m points on them
    slave_shape (m, n): shape functions of the slave facets at the points
    weight (m,): of the integral
    first: traction and charge (m,) of the residual; the response's unless that is a predicted one
    response: derivatives by gap and jump, the jump being that of the potential unknown
    components: unknowns of a node, c
    potentials (m, n): nodal values of the potential unknown on the master facets; None without electric contact
    tangent: whether to compute matrices
    geometric_stiffness: whether the tangent includes the rotation of tractions with the facets
    roundings: offsets (m, k, d) of smoothed slave and master facets, whose nodes in the pair are the corners only
    """
    v = variations(kind, projection, slave_shape, components, potentials, second=tangent)
    along = first[0][:, None] * v.gap
    if v.jump is not None:
        along = along + first[1][:, None] * v.jump
    rows = over_unknowns(kind, v.rows, roundings)
    m, r, nodes, _ = rows.shape
    rows = rows.reshape(m, r, nodes * components)
    vectors = np.einsum("m,mr,mrn->mn", weight, along, rows).reshape(m, nodes, components)
    if not tangent:
        return vectors, None
    matrix = response.slope[:, None, None] * v.gap2 if geometric_stiffness else np.zeros_like(v.gap2)
    matrix += response.curvature[:, None, None] * v.gap[:, :, None] * v.gap[:, None, :]
    if v.jump is not None:
        cross = v.gap[:, :, None] * v.jump[:, None, :]
        matrix += response.mixed[:, None, None] * (cross + np.swapaxes(cross, 1, 2))
        matrix += response.electric_curvature[:, None, None] * v.jump[:, :, None] * v.jump[:, None, :]
        matrix += response.charge[:, None, None] * v.jump2
    matrix *= weight[:, None, None]
    return vectors, np.swapaxes(rows, 1, 2) @ (matrix @ rows)


def first_changes(
    kind: FacetKind,
    projection: Projection,
    slave_shape: Array,
    change: Array,
    potentials: Array | None,
    *,
    roundings: tuple[Array, Array] | None = None,
) -> Array:
    """First-order changes (2, m) of gap and jump for changes (m, n_pair, c) of the pair's unknowns, slave nodes first.

    The jump is that of the potential unknown; without the master's `potentials` (m, n) its change is zero. Other
    arguments as of `contact_vectors`.
    """
    v = variations(kind, projection, slave_shape, change.shape[2], potentials, second=False)
    along = np.einsum("mrnc,mnc->mr", over_unknowns(kind, v.rows, roundings), change)
    jump = np.zeros_like(v.gap) if v.jump is None else v.jump
    return np.stack([np.einsum("mr,mr->m", first, along) for first in (v.gap, jump)])


def over_unknowns(kind: FacetKind, rows: Array, roundings: tuple[Array, Array] | None) -> Array:
    """Rows (m, r, n_pair, c) in terms of the nodes with unknowns, which are the corners of smoothed facets."""
    if roundings is None or not roundings[0].shape[1]:
        return rows
    n = len(kind.nodes)
    sides = zip((rows[:, :, :n], rows[:, :, n:]), roundings, strict=True)
    return np.concatenate([to_corners(kind, side, offsets) for side, offsets in sides], axis=2)
