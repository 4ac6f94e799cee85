"""Random warped facet pairs, alone and in a batch, for the tests of contact."""

from __future__ import annotations

import numpy as np

from piezomat.forms.arrays import Array
from piezomat.forms.contact.facets import FacetKind, facet_kind
from piezomat.forms.contact.gap import Projection, Variations, project, variations

KINDS = ("line2", "line3", "tri3", "tri6", "quad4", "quad9")


def inner_points(kind: FacetKind, rng: np.random.Generator, count: int) -> Array:
    """Random points (count, t) inside the reference facet, some of them close to its rim."""
    xi = rng.uniform(size=(count, kind.dim))
    if kind.simplex and kind.dim == 2:
        beyond = xi.sum(axis=1) > 1.0
        xi[beyond] = 1.0 - xi[beyond]
    return xi


def rotation(dim: int, rng: np.random.Generator) -> Array:
    """Random rotation (dim, dim)."""
    q, r = np.linalg.qr(rng.standard_normal((dim, dim)))
    q = q * np.sign(np.diag(r))
    return q * np.array([np.sign(np.linalg.det(q))] + [1.0] * (dim - 1))


def warped_facets(kind: FacetKind, rng: np.random.Generator, count: int, warp: float = 0.05) -> Array:
    """Nodes (count, n, d) of facets of unit size, each warped, stretched and turned at random."""
    d = kind.dim + 1
    nodes = np.zeros((count, len(kind.nodes), d))
    nodes[:, :, : kind.dim] = kind.nodes
    nodes += warp * rng.uniform(-1.0, 1.0, nodes.shape)
    turns = np.stack([rotation(d, rng) for _ in range(count)])
    return np.einsum("mnd,med->mne", nodes, turns) + rng.standard_normal((count, 1, d))


class PairBatch:
    """m slave points on warped facets, each opposite an inner point of a warped master facet.

    unknowns (m, 2 n, c): current positions and, last, potentials of the slave's nodes, then of the master's. The gaps
    are random in +-`reach`, the potentials random in +-1; half the masters have orientation -1.
    """

    def __init__(
        self, name: str, rng: np.random.Generator, count: int = 12, reach: float = 0.15, electric: bool = True
    ) -> None:
        self.kind = kind = facet_kind(name)
        self.nodes = len(kind.nodes)
        self.dim = kind.dim + 1
        self.components = self.dim + electric
        self.orientation = np.where(np.arange(count) % 2, 1.0, -1.0)
        self.gap = rng.uniform(-reach, reach, count)
        self.slave_shape = kind.shape(inner_points(kind, rng, count))
        master = warped_facets(kind, rng, count)
        self.xi = inner_points(kind, rng, count)
        start = project(kind, _at(kind, self.xi, master), master, self.orientation, self.xi)
        points = _at(kind, self.xi, master) + self.gap[:, None] * start.normal
        slave = warped_facets(kind, rng, count)
        slave += (points - np.einsum("mk,mkd->md", self.slave_shape, slave))[:, None]
        self.unknowns = np.concatenate([slave, master], axis=1)
        if electric:
            self.unknowns = np.concatenate([self.unknowns, rng.uniform(-1, 1, (count, 2 * self.nodes, 1))], axis=2)

    def points(self, q: Array) -> Array:
        """Slave points (m, d) at these unknowns."""
        return np.einsum("mk,mkd->md", self.slave_shape, q[:, : self.nodes, : self.dim])

    def project(self, q: Array) -> Projection:
        """Closest points at these unknowns, from the middle of the facets."""
        return project(self.kind, self.points(q), q[:, self.nodes :, : self.dim], self.orientation)

    def potentials(self, q: Array) -> Array | None:
        """Potentials (m, n) of the master's nodes."""
        return q[:, self.nodes :, self.dim] if self.components > self.dim else None

    def jump(self, q: Array) -> Array:
        """Potential jumps (m,)."""
        there = np.einsum("mk,mk->m", self.kind.shape(self.project(q).xi), self.potentials(q))
        return np.einsum("mk,mk->m", self.slave_shape, q[:, : self.nodes, self.dim]) - there

    def variations(self, q: Array, *, second: bool = True) -> Variations:
        """What `piezomat.forms.contact.gap.variations` says at these unknowns."""
        return variations(
            self.kind, self.project(q), self.slave_shape, self.components, self.potentials(q), second=second
        )


def _at(kind: FacetKind, xi: Array, values: Array) -> Array:
    return np.einsum("mk,mkd->md", kind.shape(xi), values)
