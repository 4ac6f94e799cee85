"""Closest points, gaps and potential jumps on facet pairs, with their first and second variations.

A batch holds m slave points, each paired with one master facet of n nodes. The gap is g = (x_s - x_m(xi)) . n
with xi the closest point, so that its variation needs no variation of xi (Wriggers 2006, ch. 4.1), and the
potential jump is j = phi_s - phi_m(xi), which does move with xi.

Every second variation is written as W^T Q W: W stacks a few vectors over the pair's unknowns (normal, tangents,
rotations of the facet), Q is a small matrix per point. `Variations` holds W and the indices of its rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezomat.forms.arrays import Array
from piezomat.forms.contact.facets import FacetKind, FacetMaps

CURVED_ITERATIONS = 20  # largest number of Newton iterations to the closest point of a curved facet
CLOSEST_POINT_TOLERANCE = 1e-13  # of the last step, in reference lengths


@dataclass
class Projection:
    """Closest points of m slave points, each on its master facet.

    nodes (m, n, d): of the master facets, um
    xi (m, t): closest points in reference coordinates
    gap (m,): signed distance along the normal, um
    normal (m, d): outward unit normal of the master
    tangents (m, t, d): x_,a; second (m, t, t, d): x_,ab, zero on affine facets
    curvature (m, t, t): n . x_,ab
    """

    nodes: Array
    xi: Array
    gap: Array
    normal: Array
    tangents: Array
    second: Array
    curvature: Array

    def __getitem__(self, rows: NDArray) -> Projection:
        return Projection(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


def _at(kind: FacetKind, xi: Array, values: Array, *derivative: int) -> Array:
    """Nodal values (m, n, ...), or their derivative, of each facet at its point xi (m, t)."""
    return np.einsum("mk,mk...->m...", kind.shape(xi, derivative), values)


def _gradient(kind: FacetKind, xi: Array, values: Array, *derivative: int) -> Array:
    """Derivatives along every axis, (m, t, ...)."""
    return np.stack([_at(kind, xi, values, *derivative, axis) for axis in range(kind.dim)], axis=1)


def _hessian(kind: FacetKind, xi: Array, values: Array, *derivative: int) -> Array:
    """Second derivatives along every two axes, (m, t, t, ...)."""
    return np.stack([_gradient(kind, xi, values, *derivative, axis) for axis in range(kind.dim)], axis=1)


def facet_normal(tangents: Array, orientation: Array) -> Array:
    """Unit normals (m, d) of tangents (m, t, d), times the orientation (m,), which turns them outward."""
    if tangents.shape[2] == 2:
        t = tangents[:, 0]
        normal = np.stack([t[:, 1], -t[:, 0]], axis=1)
    else:
        normal = np.cross(tangents[:, 0], tangents[:, 1])
    return normal * (orientation / np.linalg.norm(normal, axis=1))[:, None]


def point_normals(kind: FacetKind, xi: Array, nodes: Array, orientation: Array) -> Array:
    """Outward unit normals (m, d) of facets with nodes (m, n, d), each at its point xi (m, t)."""
    return facet_normal(_gradient(kind, xi, nodes), orientation)


def project(
    kind: FacetKind,
    points: Array,
    nodes: Array,
    orientation: Array,
    xi: Array | None = None,
    iterations: int = CURVED_ITERATIONS,
) -> Projection:
    """Closest point of each point (m, d), um, on one facet with current nodes (m, n, d), not limited to the facet.

    Newton's method on the squared distance, without the curvature term where it would not lead to a minimum.

    orientation (m,): +1 or -1, the sign that turns the facet's normal outward
    xi (m, t): start on curved facets, default the middle
    iterations: their largest number on curved facets
    """
    xi = np.tile(kind.middle, (len(points), 1)) if xi is None else np.array(xi, float)
    axes, maps = range(kind.dim), FacetMaps(kind, nodes)
    active, some, goal = np.arange(len(points)), maps, points.T
    for _ in range(1 if kind.affine else iterations):
        if not len(active):
            break
        here = xi[active].T
        away = goal - some.at(here)
        tangents = [some.at(here, a) for a in axes]
        slope = np.array([(t * away).sum(axis=0) for t in tangents])
        matrix = np.array([[(t * other).sum(axis=0) for other in tangents] for t in tangents])
        if not kind.affine:
            bend = np.array([[(some.at(here, *sorted((a, b))) * away).sum(axis=0) for b in axes] for a in axes])
            safe = _least_eigenvalue(matrix - bend) > 0.1 * _least_eigenvalue(matrix)
            matrix = np.where(safe, matrix - bend, matrix)
        step = _solve(matrix, slope)
        length = np.abs(step).max(axis=0)
        if not kind.affine:
            step /= np.maximum(length, 1.0)
        xi[active] += step.T
        left = np.flatnonzero(length > CLOSEST_POINT_TOLERANCE)
        if len(left) < len(active):
            active, some, goal = active[left], some[left], goal[:, left]
    here = np.ascontiguousarray(xi.T)
    tangents = np.stack([maps.at(here, a).T for a in axes], axis=1)
    normal = facet_normal(tangents, orientation)
    gap = np.einsum("md,md->m", points - maps.at(here).T, normal)
    second = np.zeros((len(xi), kind.dim, kind.dim, points.shape[1]))
    if not kind.affine:
        for a in axes:
            for b in range(a + 1):
                second[:, a, b] = second[:, b, a] = maps.at(here, b, a).T
    curvature = np.einsum("mabd,md->mab", second, normal)
    return Projection(nodes, xi, gap, normal, tangents, second, curvature)


def _solve(matrix: Array, right: Array) -> Array:
    """Solutions (t, m) with symmetric matrices (t, t, m), t = 1 or 2. Raises LinAlgError where one is singular."""
    with np.errstate(divide="ignore", invalid="ignore"):
        if len(matrix) == 1:
            result = right / matrix[0]
        else:
            (a, b), (_, c) = matrix
            result = np.stack([c * right[0] - b * right[1], a * right[1] - b * right[0]]) / (a * c - b * b)
    if not np.isfinite(result).all():
        raise np.linalg.LinAlgError("a facet has collapsed")
    return result


def _least_eigenvalue(matrix: Array) -> Array:
    """Least eigenvalues (m,) of symmetric matrices (1, 1, m) or (2, 2, m)."""
    if len(matrix) == 1:
        return matrix[0, 0]
    half = 0.5 * (matrix[0, 0] + matrix[1, 1])
    return half - np.hypot(0.5 * (matrix[0, 0] - matrix[1, 1]), matrix[0, 1])


@dataclass
class Variations:
    """Variations of gap and potential jump of m pairs, in terms of a few vectors over the pair's unknowns.

    rows (m, r, n_pair, c): r vectors over the pair's nodes, slave nodes first, with c unknowns each
    gap, jump (m, r): first variations, coefficients of the rows; jump is None without potentials
    xi (m, t, r): first variation of the closest point
    gap2, jump2 (m, r, r): second variations, matrices between the rows; None if not computed
    function2 (m, r, r): second variation of a function of the closest point, the same; None if none was given
    """

    rows: Array
    gap: Array
    xi: Array
    jump: Array | None = None
    gap2: Array | None = None
    jump2: Array | None = None
    function2: Array | None = None

    @property
    def first(self) -> list[Array]:
        """First variations (m, r) of the gap and, with potentials, of the jump."""
        return [self.gap] if self.jump is None else [self.gap, self.jump]

    @property
    def second(self) -> list[Array]:
        """Second variations (m, r, r) of the same."""
        return [self.gap2] if self.jump is None else [self.gap2, self.jump2]


def variations(
    kind: FacetKind,
    projection: Projection,
    slave_shape: Array,
    components: int,
    potentials: Array | None = None,
    function: tuple[Array, Array] | None = None,
    *,
    second: bool = True,
) -> Variations:
    """First and second variations of the gap and, with potentials, of the potential jump.

    projection: of m slave points on master facets of this kind
    slave_shape (m, n_s): shape functions of the slave facet at the points
    components: unknowns of a node: displacements and, with potentials, the potential last
    potentials (m, n): nodal values of the master facets
    function: first and second derivatives (m, t), (m, t, t) of a function of the closest point
    second: whether to compute second variations
    """
    p, t = projection, kind.dim
    axes = range(t)
    none = np.zeros_like(slave_shape)
    both = np.concatenate([slave_shape, -kind.shape(p.xi)], axis=1)  # value at the slave minus value at the master
    slope = [np.concatenate([none, kind.shape(p.xi, (i,))], axis=1) for i in axes]
    space = _Rows(len(both), both.shape[1], components)

    n = space.displacement(both, p.normal)  # approach
    a = [space.displacement(both, p.tangents[:, i]) for i in axes]  # relative sliding
    c = [space.displacement(slope[i], p.normal) for i in axes]  # tilt of the facet
    b = space.potential(both) if potentials is not None else None
    q = [space.potential(slope[i]) for i in axes] if potentials is not None and second else []
    if second and (potentials is not None or function is not None):
        e = [[space.displacement(slope[i], p.tangents[:, j]) for j in axes] for i in axes]  # stretch of the facet
        if not kind.affine:
            bend = [[np.concatenate([none, kind.shape(p.xi, (i, j))], axis=1) for j in axes] for i in axes]
            f = [[space.displacement(bend[i][j], p.normal) for j in axes] for i in axes]

    metric = p.tangents @ np.swapaxes(p.tangents, 1, 2)
    inverse = inverse_metric = _inverse(metric)
    gap = p.gap[:, None, None]
    if not kind.affine:
        inverse = np.linalg.inv(metric - gap * p.curvature)
    n_, a_, c_ = space.unit(n), space.unit(a), space.unit(c)
    xi_ = inverse @ (a_ + gap * c_)  # variation of the closest point

    result = Variations(space.rows(), np.broadcast_to(n_, (len(both), n_.shape[1])), xi_)
    if b is not None:
        phi_1 = _gradient(kind, p.xi, potentials)
        result.jump = space.unit(b) - np.einsum("ma,mar->mr", phi_1, xi_)
    if not second:
        return result

    # -(a A^-1 k m^-1 a + c A^-1 a + a A^-1 c + g c A^-1 c), symmetric because A = m - g k
    result.gap2 = -_outer(c_, inverse @ a_ + gap * (inverse @ c_)) - _outer(a_, inverse @ c_)
    if not kind.affine:
        result.gap2 -= _outer(a_, inverse @ p.curvature @ inverse_metric @ a_)
    if b is None and function is None:
        return result

    e_ = space.unit(e)
    turn = inverse_metric @ c_  # minus the rotation of the normal, in tangents
    if not kind.affine:
        f_ = space.unit(f)
        turn = turn + inverse_metric @ (p.curvature @ xi_)
        christoffel = np.einsum("mabd,mgd->mabg", p.second, p.tangents)
        third = np.stack([_hessian(kind, p.xi, p.nodes, i) for i in axes], axis=1)

    def second_of_xi(first: Array) -> Array:
        """Second variation of xi contracted with `first` (m, t), from the derivative of A dxi = a + g c."""
        mu = np.einsum("ma,mab->mb", first, inverse)
        mu_c = np.einsum("ma,mar->mr", mu, c_)[:, None]
        mu_e, e_mu = np.einsum("ma,magr->mgr", mu, e_), np.einsum("ma,mbar->mbr", mu, e_)
        follow, change = -e_mu, mu_e + e_mu
        if not kind.affine:
            mu_k = np.einsum("ma,mab->mb", mu, p.curvature)[:, :, None] * n_[:, None]
            mu_g, mu_f = np.einsum("ma,mabg->mbg", mu, christoffel), np.einsum("ma,mabr->mbr", mu, f_)
            follow += mu_k + mu_g @ inverse_metric @ a_ + gap * mu_f
            change += np.einsum("ma,magb,mgr->mbr", mu, christoffel, xi_) - mu_k
            change += np.einsum("ma,mbga,mgr->mbr", mu, christoffel, xi_) + gap * (mu_g @ turn)
            change -= gap * (mu_f + np.einsum("ma,mabgd,md,mgr->mbr", mu, third, p.normal, xi_))
        xi2 = _outer(mu_c, n_[:, None]) + _outer(n_[:, None], mu_c)
        xi2 += _outer(inverse_metric @ mu_e, a_) + _outer(xi_, follow)
        return xi2 - _outer(turn, gap * mu_e) - _outer(change, xi_)

    if function is not None:
        result.function2 = second_of_xi(function[0]) + _outer(xi_, function[1] @ xi_)
    if b is not None:
        q_ = space.unit(q)
        phi_2 = _hessian(kind, p.xi, potentials)
        result.jump2 = -_outer(q_, xi_) - _outer(xi_, q_) - _outer(xi_, phi_2 @ xi_) - second_of_xi(phi_1)
    return result


def _outer(left: Array, right: Array) -> Array:
    """Sum over axis 1 of the outer products of (m, k, r) and (m, k, r)."""
    return np.swapaxes(left, 1, 2) @ right


def _inverse(matrix: Array) -> Array:
    """Inverses (m, t, t) of symmetric matrices that are not singular, t = 1 or 2."""
    if matrix.shape[1] == 1:
        return 1.0 / matrix
    (a, b), (_, c) = matrix.transpose(1, 2, 0)
    return (np.array([[c, -b], [-b, a]]) / (a * c - b * b)).transpose(2, 0, 1)


class _Rows:
    """Collection of vectors over the unknowns of m pairs, each represented by a unit vector."""

    def __init__(self, pairs: int, nodes: int, components: int) -> None:
        self._shape = (pairs, nodes, components)
        self._rows: list[tuple[Array, Array | None]] = []

    def displacement(self, shape: Array, direction: Array) -> int:
        """Number of the vector shape (m, nodes) times direction (m, d) in the displacements."""
        self._rows.append((shape, direction))
        return len(self._rows) - 1

    def potential(self, shape: Array) -> int:
        """Number of the vector shape (m, nodes) in the potential."""
        self._rows.append((shape, None))
        return len(self._rows) - 1

    def unit(self, index: int | list) -> Array:
        """Unit vectors (1, ..., r) of some rows, which are the same for all pairs."""
        return np.eye(len(self._rows))[np.asarray(index)][None]

    def rows(self) -> Array:
        """All rows (m, r, nodes, components)."""
        pairs, nodes, components = self._shape
        every = np.zeros((pairs, len(self._rows), nodes, components))
        for row, (shape, direction) in enumerate(self._rows):
            if direction is None:
                every[:, row, :, -1] = shape
            else:
                every[:, row, :, : direction.shape[1]] = shape[:, :, None] * direction[:, None, :]
        return every
