"""Lagrange facets: shape functions, reference domains and quadrature for every kind of contact facet."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezomat.forms.arrays import Array, Integers

_LINE = [(0.0,), (1.0,), (0.5,)]
_TRIANGLE = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.5, 0.5), (0.0, 0.5), (0.5, 0.0)]
_SQUARE = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)]
_SQUARE2 = [*_SQUARE, (0.5, 0.0), (0.0, 0.5), (1.0, 0.5), (0.5, 1.0), (0.5, 0.5)]


# Gauss points of a line of order 2. With three, the quadrature error on the other side's facets loads its vertices and
# side nodes unevenly: at pressures of a tenth of the modulus fine surfaces become wavy, bodies slide, and Newton's
# method does not converge.
CURVED_LINE = 6


@dataclass(frozen=True)
class FacetKind:
    """Lagrange facet on the unit interval, triangle or square.

    nodes (n, t): reference coordinates in DOLFINx (Basix) order: vertices, edges, interior; powers (n, t): exponents of
    the monomials; coefficients (n, n): shape functions in terms of the monomials; simplex: whether it is no square.
    """

    name: str
    nodes: Array
    powers: Integers
    coefficients: Array
    simplex: bool

    @property
    def affine(self) -> bool:
        """Whether the facet's map is affine, so that its normal is constant."""
        return self.name in ("line2", "tri3")

    @property
    def dim(self) -> int:
        """Topological dimension of the facet."""
        return self.nodes.shape[1]

    @property
    def middle(self) -> Array:
        """Middle (t,) of the reference facet."""
        return np.full(self.dim, 1.0 / (self.dim + 1) if self.simplex else 0.5)

    @property
    def order(self) -> int:
        """Polynomial order of the facet."""
        return 1 if self.name in ("line2", "tri3", "quad4") else 2

    def shape(self, xi: Array, derivative: tuple[int, ...] = ()) -> Array:
        """Shape functions (m, n) at points xi (m, t), or their derivative along these axes."""
        monomials = np.empty((len(xi), len(self.powers)))
        for column, (factor, axes) in enumerate(_monomials(self.name, derivative)):
            value: Any = factor
            for axis in axes:
                value = value * xi[:, axis]
            monomials[:, column] = value
        return monomials @ self.coefficients

    @property
    def sides(self) -> tuple[Array, Array]:
        """Distances a + b . xi from the sides of the reference facet, one at the opposite end: a (s,), b (s, t)."""
        rise = np.eye(self.dim)
        if self.simplex and self.dim == 2:
            return np.array([0.0, 0.0, 1.0]), np.vstack([rise, [[-1.0, -1.0]]])
        return np.repeat([0.0, 1.0], self.dim), np.vstack([rise, -rise])

    @property
    def corner_sides(self) -> Integers:
        """Corners (s, 2) at the ends of the sides of a facet of a body in three dimensions; none of a line."""
        if self.dim == 1:
            return np.zeros((0, 2), np.int64)
        return np.array([(0, 1), (1, 2), (0, 2)] if self.simplex else [(0, 1), (0, 2), (1, 3), (2, 3)])

    def overshoot(self, xi: Array) -> Array:
        """Distance (m,) of points xi (m, t) beyond the sides of the reference facet; negative inside."""
        upper = 1.0 - (xi.sum(axis=1, keepdims=True) if self.simplex else xi)
        return -np.minimum(xi.min(axis=1), upper.min(axis=1))

    def clamp(self, xi: Array, metric: Array) -> Array:
        """Points (m, t) of the reference facet nearest to points xi (m, t), each in its metric (m, t, t)."""
        if self.dim == 1:
            return np.clip(xi, 0.0, 1.0)
        nearest = xi.copy()
        least = np.where(self.overshoot(xi) <= 0.0, 0.0, np.inf)
        corners = self.nodes[[0, 1, 2] if self.simplex else [0, 1, 3, 2]]
        for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            along = metric @ (end - start)
            share = np.einsum("ma,ma->m", xi - start, along) / (along @ (end - start))
            point = start + np.clip(share, 0.0, 1.0)[:, None] * (end - start)
            distance = np.einsum("ma,mab,mb->m", point - xi, metric, point - xi)
            nearer = distance < least
            nearest[nearer], least[nearer] = point[nearer], distance[nearer]
        return nearest

    def quadrature(self) -> tuple[Array, Array]:
        """Points (m, t) and weights (m,) of the Gauss rule for `point` contact, of degree about 2 p + 1."""
        if self.simplex and self.dim == 2:
            return triangle_rule(self.order)
        x, w = np.polynomial.legendre.leggauss(CURVED_LINE if self.name == "line3" else self.order + 1)
        x, w = 0.5 * (x + 1.0), 0.5 * w
        if self.dim == 1:
            return x[:, None], w
        points = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2)
        return points, np.outer(w, w).ravel()


@dataclass(frozen=True)
class Facets:
    """Facets of one kind in their current positions.

    nodes (f, n, d), um; orientation (f,): +1 or -1, the sign that turns the normal outward; key (f,): a number
    independent of the partition.
    """

    kind: FacetKind
    nodes: Array
    orientation: Array
    key: Integers

    def __len__(self) -> int:
        return len(self.nodes)

    def __getitem__(self, rows: NDArray) -> Facets:
        return Facets(self.kind, self.nodes[rows], self.orientation[rows], self.key[rows])


class FacetMaps:
    """Maps of facets with nodes (m, n, d) as polynomials, each evaluated at one point."""

    def __init__(self, kind: FacetKind, nodes: Array) -> None:
        self._kind = kind
        m, n, d = nodes.shape
        terms = kind.coefficients @ nodes.transpose(1, 2, 0).reshape(n, d * m)
        self._terms = terms.reshape(len(kind.powers), d, m)

    def __getitem__(self, rows: NDArray) -> FacetMaps:
        some = object.__new__(FacetMaps)
        some._kind, some._terms = self._kind, self._terms[:, :, rows]
        return some

    def at(self, xi: Array, *derivative: int) -> Array:
        """Positions (d, m) at points xi (t, m), or derivatives along the given axes."""
        result = np.zeros(self._terms.shape[1:])
        for (factor, axes), term in zip(_monomials(self._kind.name, derivative), self._terms, strict=True):
            for axis in axes:
                term = term * xi[axis]
            if factor:
                result += term if factor == 1 else factor * term
        return result


@cache
def _monomials(name: str, derivative: tuple[int, ...]) -> list[tuple[int, list[int]]]:
    """Derivative of each monomial along these axes: a factor, and the axes whose coordinates are multiplied."""
    found = []
    for powers in facet_kind(name).powers.tolist():
        factor = 1
        for axis in derivative:
            factor *= powers[axis]
            powers[axis] -= 1
        found.append((factor, [axis for axis, power in enumerate(powers) for _ in range(power)] if factor else []))
    return found


def triangle_rule(order: int) -> tuple[Array, Array]:
    """Points (q, 2) and weights (q,), Strang and Fix (1973): order 1: 3 points, degree 2; order 2: 6, degree 4."""
    if order == 1:
        return np.array([[1, 1], [4, 1], [1, 4]]) / 6.0, np.full(3, 1.0 / 6.0)
    a, b = 0.445948490915965, 0.091576213509771
    points = [[a, a], [1 - 2 * a, a], [a, 1 - 2 * a], [b, b], [1 - 2 * b, b], [b, 1 - 2 * b]]
    return np.array(points), 0.5 * np.repeat([0.223381589678011, 0.109951743655322], 3)


def closed_triangle_rule() -> tuple[Array, Array]:
    """Points (7, 2) and weights (7,) of a rule with points at the corners: those of tri6 and the middle, degree 3."""
    points = np.array([*_TRIANGLE, (1.0 / 3.0, 1.0 / 3.0)])
    return points, np.array([3.0, 3.0, 3.0, 8.0, 8.0, 8.0, 27.0]) / 120.0


@cache
def facet_kind(name: str) -> FacetKind:
    """Facet kind by name: line2, line3, tri3, tri6, quad4 or quad9."""
    nodes, powers = {
        "line2": (_LINE[:2], [(0,), (1,)]),
        "line3": (_LINE, [(0,), (1,), (2,)]),
        "tri3": (_TRIANGLE[:3], [(0, 0), (1, 0), (0, 1)]),
        "tri6": (_TRIANGLE, [(0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (0, 2)]),
        "quad4": (_SQUARE, [(0, 0), (1, 0), (0, 1), (1, 1)]),
        "quad9": (_SQUARE2, [(i, j) for i in range(3) for j in range(3)]),
    }[name]
    x, p = np.array(nodes), np.array(powers)
    vandermonde = np.prod(x[:, None, :] ** p[None], axis=2)
    return FacetKind(name, x, p, np.linalg.inv(vandermonde), not name.startswith("quad"))


def facet_kind_of(cell_type: str, order: int) -> FacetKind:
    """Kind of the facets of a triangle, quadrilateral, tetrahedron or hexahedron of order 1 or 2."""
    names = {
        "triangle": ("line2", "line3"),
        "quadrilateral": ("line2", "line3"),
        "tetrahedron": ("tri3", "tri6"),
        "hexahedron": ("quad4", "quad9"),
    }
    return facet_kind(names[cell_type][order - 1])


def corner_kind(kind: FacetKind) -> FacetKind:
    """Kind of order 1 on the corners of a facet, which are its first nodes."""
    return facet_kind("line2" if kind.dim == 1 else "tri3" if kind.simplex else "quad4")
