"""Nodes inside another body, and places where sharp edges cross the edges of its facets inside it.

Contact points need not lie there: what is deepest is looked for at the end of a step alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from piezomat.contact.closest_points import ClosestPoints, SearchLimits
from piezomat.contact.master_nodes import penetrating_master_nodes
from piezomat.contact.pairs import Pairs
from piezomat.contact.surface_pair import SurfacePair
from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.facets import FacetKind
from piezomat.forms.contact.integrals import SlavePoints, nodes_of
from piezomat.meshes.contact.facet_bounds import TIE, near_pairs

# Nodes of the slave, those of its sharp edges and vertices, places where sharp edges cross, nodes of the master.
ROUND, CORNER, CROSSING, MASTER = range(4)
CLOSE = 0.5  # facets: a node may be inside the other body if a point of its facet has a gap below this
PARALLEL = 0.1  # sine of the angle below which edges do not cross


@dataclass(frozen=True)
class PenetratingPlaces:
    """Places inside another body: pair (k,), depth (k,), and size of their facets (k,), um; what they are (k,).

    A depth is negative outside.
    """

    pair: Integers
    depth: Array
    facet_size: Array
    what: Integers

    @classmethod
    def of_master(
        cls, comm: MPI.Comm, p: SurfacePair, pairs: Pairs, position: Array, reach: float
    ) -> PenetratingPlaces:
        """Nodes of the master facets, which have no points of their own; see `penetrating_master_nodes`. Collective."""
        slave, master, depth = penetrating_master_nodes(comm, p, position, reach)
        size = p.facet_size[np.searchsorted(p.points.facet, slave)]
        pair, _ = p.pairs_of_facets(pairs, slave, master)
        return cls(pair, depth, size, np.full(len(slave), MASTER))

    @classmethod
    def of(cls, p: SurfacePair, pairs: Pairs, position: Array, depth: float) -> PenetratingPlaces:
        """Nodes of the slave facets with points in contact or nearly so, and crossings of the slave's sharp edges.

        position (n, d): of the seen nodes, at which the points are projected; depth: see `SearchLimits`.
        """
        points, size = p.points, np.zeros(len(p.slave))
        rows = p.projected_points
        size[points.facet] = p.facet_size
        facets = np.unique(points.facet[rows[p.projection.gap < CLOSE * p.facet_size[rows]]])
        nodes, crossings = nodes_of(p.slave.kind, facets), _crossings(p, position)
        places = nodes.followed_by(crossings)
        depths = p.depth, p.self_depth
        closest = ClosestPoints(p.facets, places, np.ones(len(places.facet), bool), depths, position, max(depths))
        limits = SearchLimits(True, 0.0, 0.0, 0.0, depth, 0.0)
        found, _, projection, _ = closest.update(position, limits)
        at = closest.near[found]
        facet = places.facet[at]
        pair, _ = p.pairs_of_facets(pairs, facet, closest.facet[found])
        corner = nodes.place < p.sharp.shape[1]
        corner[corner] = p.sharp[nodes.facet[corner], nodes.place[corner]]
        what = np.append(np.where(corner, CORNER, ROUND), np.full(len(crossings.facet), CROSSING))
        return cls(pair, -projection.gap, size[facet], what[at])


def _crossings(p: SurfacePair, position: Array) -> SlavePoints:
    """The places on sharp edges of slave facets that are closest to edges of master facets, where both are near."""
    kind, facets, none = p.slave.kind, p.facets, np.zeros(0, np.int64)
    sides = kind.corner_sides
    sharp = p.sharp[:, sides].all(axis=2) if len(sides) else np.zeros((len(p.slave), 0), bool)
    some = np.flatnonzero(sharp.any(axis=1))
    slave, master = near_pairs(facets.slave_at(position, some), facets.master_at(position), 0.0)
    slave = some[slave]
    may = facets.may_meet(slave, master) if len(slave) else np.zeros(0, bool)
    slave, master = slave[may], master[may]
    if not len(slave):
        return _places(kind, none, np.zeros((0, kind.dim)))
    row, here = np.nonzero(sharp[slave])
    row, here, there = np.repeat(row, len(sides)), np.repeat(here, len(sides)), np.tile(np.arange(len(sides)), len(row))
    slave, master = slave[row], master[row]
    every = np.arange(len(row))[:, None]
    share = _closest(
        facets.slave_at(position, slave)[every, sides[here]], facets.master_at(position, master)[every, sides[there]]
    )
    inside = np.flatnonzero(np.isfinite(share))
    low, high = (kind.nodes[sides[here[inside], end]] for end in (0, 1))
    return _places(kind, slave[inside], low + share[inside, None] * (high - low))


def _closest(first: Array, second: Array) -> Array:
    """Place (k,) from 0 to 1 on edges with ends (k, 2, 3) that is closest to others; nan beyond the ends of either."""
    u, v, apart = first[:, 1] - first[:, 0], second[:, 1] - second[:, 0], second[:, 0] - first[:, 0]
    across = np.cross(u, v)
    square = np.einsum("kd,kd->k", across, across)
    lengths = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1)
    cross = square > (PARALLEL * lengths) ** 2
    square = np.where(cross, square, 1.0)
    s = np.einsum("kd,kd->k", np.cross(apart, v), across) / square
    t = np.einsum("kd,kd->k", np.cross(apart, u), across) / square
    on_edges = np.maximum(np.abs(s - 0.5), np.abs(t - 0.5)) <= 0.5 + TIE  # or at a node of either
    return np.where(cross & on_edges, np.clip(s, 0.0, 1.0), np.nan)


def _places(kind: FacetKind, facet: Integers, xi: Array) -> SlavePoints:
    none = np.zeros(len(facet))
    return SlavePoints(facet, np.zeros(len(facet), np.int64), xi, kind.shape(xi), none, none)
