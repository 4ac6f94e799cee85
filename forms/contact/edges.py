"""Edges that cross: gap and closest points of two straight edges of facets in three dimensions.

For edges a(s) and b(t) with directions u and v the gap is g = (a(s) - b(t)) . n at the closest points, where
n = u x v / |u x v| points out of the master. The closest points are stationary, so that the variation of the gap is
(da - db) . n at fixed s and t.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.forms.arrays import Array, Booleans
from piezomat.forms.contact.facets import FacetKind

PARALLEL = 0.1  # sine of the angle below which edges do not cross


def sides(kind: FacetKind) -> list[tuple[int, int]]:
    """The corners at the ends of the sides of a facet of a body in three dimensions."""
    return [(0, 1), (1, 2), (0, 2)] if kind.simplex else [(0, 1), (0, 2), (1, 3), (2, 3)]


@dataclass(frozen=True)
class Crossings:
    """Crossings of k pairs of edges: s, t (k,) from 0 to 1 along each, gap (k,), um, normal (k, d) out of the master.

    crosses (k,): whether the closest points are on the edges, and the normal points out of both bodies there
    """

    s: Array
    t: Array
    gap: Array
    normal: Array
    crosses: Booleans


def crossings(slave: Array, master: Array, slave_normals: Array, master_normals: Array) -> Crossings:
    """Crossings of edges with ends (k, 2, d); normals (k, 2, d) of the facets that meet at each."""
    u, v, apart = slave[:, 1] - slave[:, 0], master[:, 1] - master[:, 0], master[:, 0] - slave[:, 0]
    across = np.cross(u, v)
    area = np.linalg.norm(across, axis=1)
    lengths = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1)
    straight = area > PARALLEL * lengths
    normal = across / np.where(straight, area, 1.0)[:, None]
    normal *= np.where(np.einsum("kid,kd->k", master_normals, normal) < 0.0, -1.0, 1.0)[:, None]
    square = np.where(straight, area, 1.0) ** 2
    s = np.einsum("kd,kd->k", np.cross(apart, v), across) / square
    t = np.einsum("kd,kd->k", np.cross(apart, u), across) / square
    gap = -np.einsum("kd,kd->k", apart, normal)
    crosses = straight & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    for normals, outward in ((master_normals, normal), (slave_normals, -normal)):
        angle = np.einsum("kd,kd->k", normals[:, 0], normals[:, 1])
        crosses &= (np.einsum("kid,kd->ki", normals, outward) > angle[:, None]).all(axis=1)
    return Crossings(s, t, gap, normal, crosses)
