"""Pairing: which master facets a rank must see, and which of them each slave point meets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from forms.contact.facets import FacetKind
from forms.contact.gap import facet_normal, project

Array = NDArray[np.float64]

BOX_FACETS = 64  # facets in a box of the coarse search
END_TOLERANCE = 0.1  # how far, in facet lengths, a point may slide off the end of a surface before it is let go
FACING = -0.05  # cosine between two surfaces' outward normals below which they can press on each other
TIE = 1e-9  # facets equally near within this share of their size are told apart by their key


@dataclass(frozen=True)
class VisibleFacets:
    """Master facets that a rank can see, from every rank: nodes (f, n) global, orientation (f,), key (f,)."""

    nodes: NDArray[np.int64]
    orientation: Array
    key: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.nodes)


def boxes(positions: Array, facets_per_box: int = BOX_FACETS) -> Array:
    """Boxes (b, 2, d) around groups of neighbouring facets with node positions (f, n, d)."""
    if not len(positions):
        return np.zeros((0, 2, positions.shape[2]))
    low, high = positions.min(axis=1), positions.max(axis=1)
    middle = 0.5 * (low + high)
    groups = [np.arange(len(positions))]
    done = []
    while groups:
        group = groups.pop()
        if len(group) <= facets_per_box:
            done.append(np.stack([low[group].min(axis=0), high[group].max(axis=0)]))
            continue
        axis = np.ptp(middle[group], axis=0).argmax()
        order = group[np.argsort(middle[group, axis], kind="stable")]
        groups += [order[: len(order) // 2], order[len(order) // 2 :]]
    return np.stack(done)


def share_facets(
    comm: MPI.Comm,
    slave_positions: Array,
    master: VisibleFacets,
    master_positions: Array,
    margin: float,
) -> VisibleFacets:
    """Master facets of all ranks that come within `margin` of this rank's slave facets. Collective.

    slave_positions (f, n, d) and master_positions (f, n, d): current nodes of this rank's own facets; `master` are
    this rank's own. Facets are sent where they are near a box of slave facets, so a rank sees little more than its
    own neighbourhood.
    """
    slave_boxes = comm.allgather(boxes(slave_positions))
    low, high = master_positions.min(axis=1) - margin, master_positions.max(axis=1) + margin
    parcels = []
    for theirs in slave_boxes:
        near = np.zeros(len(master), bool)
        for box in theirs:
            near |= np.all((low <= box[1]) & (high >= box[0]), axis=1)
        parcels.append((master.nodes[near], master.orientation[near], master.key[near]))
    received = comm.alltoall(parcels)
    nodes, orientation, key = (np.concatenate(parts) for parts in zip(*received, strict=True))
    return VisibleFacets(nodes, orientation, key)


def near_points(points: Array, facets: Array, margin: float) -> NDArray[np.bool_]:
    """Which points (m, d) may lie within `margin` of a facet with nodes (f, n, d); never misses one."""
    near = np.zeros(len(points), bool)
    for _, center, radius in _size_classes(facets):
        distance, _ = cKDTree(center).query(points, distance_upper_bound=margin + radius)
        near |= np.isfinite(distance)
    return near


def closest_facets(
    kind: FacetKind,
    points: Array,
    normals: Array,
    facets: Array,
    orientation: Array,
    key: NDArray[np.int64],
    margin: float,
    depth: float = np.inf,
) -> tuple[NDArray[np.int64], Array]:
    """The facet (m,) that each point meets, -1 for none, and where (m, t).

    The nearest of those that face the point's own surface, by the distance to the facet itself (not its extension);
    a point behind them must be inside the body. points (m, d) with normals (m, d), facets (f, n, d). Two facets
    equally near are told apart by their key, so that the answer does not depend on their order. A point beyond the
    end of the surface meets nothing, nor does one deeper than `depth` (um): it would be nearer to the far side.
    """
    found = np.full(len(points), -1)
    where = np.zeros((len(points), kind.dim))
    row, facet = _candidates(kind, points, facets, margin)
    if not len(row):
        return found, where
    p = project(kind, points[row], facets[facet], orientation[facet])
    nearest = np.einsum("mk,mkd->md", kind.shape(kind.clamp(p.xi)), p.nodes)
    distance = np.linalg.norm(points[row] - nearest, axis=1)
    size = np.linalg.norm(np.ptp(p.nodes, axis=1), axis=1)
    facing = np.einsum("md,md->m", p.normal, normals[row]) < FACING
    # A point behind a facet is inside the body only if the nearest facet of all says so too: the far side of a body
    # faces the far side of the other.
    closest = np.lexsort((~facing, distance, row))
    rows, first = np.unique(row[closest], return_index=True)
    outside = np.zeros(len(points), bool)
    outside[rows] = (p.gap > END_TOLERANCE * size)[closest[first]]
    facing &= (p.gap > 0.0) | (~outside[row] & (p.gap > -depth))
    row, facet, xi, distance, size = (values[facing] for values in (row, facet, p.xi, distance, size))
    if not len(row):
        return found, where
    least = np.full(len(points), np.inf)
    np.minimum.at(least, row, distance)
    best = distance <= least[row] + TIE * size
    row, facet, xi = row[best], facet[best], xi[best]
    order = np.lexsort((key[facet], row))
    row, first = np.unique(row[order], return_index=True)
    chosen = order[first]
    on = kind.overshoot(xi[chosen]) <= END_TOLERANCE
    found[row[on]] = facet[chosen[on]]
    where[row[on]] = xi[chosen[on]]
    return found, where


def brute_force_facets(
    kind: FacetKind, points: Array, normals: Array, facets: Array, orientation: Array
) -> NDArray[np.int64]:
    """The slow, readable reference of `closest_facets`: every point against every facet."""
    found = np.full(len(points), -1)
    m, f = len(points), len(facets)
    row, facet = np.repeat(np.arange(m), f), np.tile(np.arange(f), m)
    p = project(kind, points[row], facets[facet], orientation[facet])
    nearest = np.einsum("mk,mkd->md", kind.shape(kind.clamp(p.xi)), p.nodes)
    distance = np.linalg.norm(points[row] - nearest, axis=1).reshape(m, f)
    facing = (np.einsum("md,md->m", p.normal, normals[row]) < FACING).reshape(m, f)
    gap = p.gap.reshape(m, f)
    overshoot = kind.overshoot(p.xi).reshape(m, f)
    size = np.linalg.norm(np.ptp(facets, axis=1), axis=1)
    for i in range(m):
        closest = np.lexsort((~facing[i], distance[i]))[0]
        usable = facing[i] & ((gap[i] > 0.0) | (gap[i, closest] <= END_TOLERANCE * size[closest]))
        if usable.any():
            best = np.where(usable, distance[i], np.inf).argmin()
            found[i] = best if overshoot[i, best] <= END_TOLERANCE else -1
    return found


def point_normals(kind: FacetKind, xi: Array, nodes: Array, orientation: Array) -> Array:
    """Outward normals (m, d) of slave facets with current nodes (m, n, d) at xi (m, t)."""
    tangents = np.stack([np.einsum("mk,mkd->md", kind.shape(xi, (a,)), nodes) for a in range(kind.dim)], axis=1)
    return facet_normal(tangents, orientation)


def _size_classes(facets: Array) -> list[tuple[NDArray[np.int64], Array, float]]:
    """Facets by size, within a factor of two: members, centres, largest radius."""
    if not len(facets):
        return []
    center = facets.mean(axis=1)
    radius = np.linalg.norm(facets - center[:, None], axis=2).max(axis=1)
    level = np.floor(np.log2(radius / radius.min() * (1.0 + 1e-12))).astype(int)
    return [
        (members, center[members], float(radius[members].max()))
        for members in (np.flatnonzero(level == i) for i in np.unique(level))
    ]


def _candidates(kind: FacetKind, points: Array, facets: Array, margin: float) -> tuple[NDArray, NDArray]:
    """Pairs (point, facet) among which each point's nearest facet is: the nearest centres of every size class."""
    neighbours = 6 if kind.dim == 1 else 16
    rows, columns = [], []
    for members, center, radius in _size_classes(facets):
        count = min(neighbours, len(members))
        _, index = cKDTree(center).query(points, k=range(1, count + 1), distance_upper_bound=margin + radius)
        row, column = np.nonzero(index < len(members))
        rows.append(row)
        columns.append(members[index[row, column]])
    if not rows:
        return np.zeros(0, int), np.zeros(0, int)
    return np.concatenate(rows), np.concatenate(columns)
