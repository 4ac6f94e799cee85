"""How many facets lie across each place of contact: whether the mesh resolves it.

A place of contact is what hangs together of the pressed facets of one body. Its width is that of an ellipse with the
same second moments, in two dimensions its length. Across fewer than six facets a pressure like that of Hertz has no
shape; its largest value and the voltage are then those of the mesh. Places on flat faces, which bear the same pressure
everywhere, need no facets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from piezomat.contact.contact_points import ContactPoints
from piezomat.contact.interfaces import Interfaces
from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.gap import point_normals

LEAST_SHARE = 0.05  # of the load: places that carry less do not count
FLAT = 1e-6  # deviation of the normals of undeformed facets, up to which they are those of a flat face


@dataclass(frozen=True)
class Across:
    """The least number of facets across a place of a pair or plane that carries a part of the load, and its force, uN.

    2D: per um of depth.
    """

    facets: float
    force: float


@dataclass(frozen=True)
class _Pressed:
    """Pressed facets (f,): pair, body, nodes (f, n), force, area, its moments (f, k), size.

    moments: area times position x, x x, and normal in the undeformed state
    """

    pair: Integers
    body: Integers
    nodes: Integers
    force: Array
    area: Array
    moments: Array
    size: Array


def facets_across(contact: Interfaces) -> dict[int, Across]:
    """For each pair and plane, by its number in the results, at the last evaluation. Collective; the same on all ranks.

    None is listed that bears nothing but on flat faces, or less than `LEAST_SHARE` of the load: of the largest force of
    a pair or plane.
    """
    here = [_pressed(contact, p) for p in contact.point_sets if p.response is not None]
    every = [facets for some in contact.comm.allgather(here) for facets in some]
    columns = zip(*(vars(facets).values() for facets in every), strict=True) if every else ()
    joined = _Pressed(*(np.concatenate(column) for column in columns)) if every else None
    if joined is None or not len(joined.pair):
        return {}
    place = _places(joined)
    force = np.bincount(place, joined.force)
    pair = np.zeros(len(force), np.int64)
    pair[place] = joined.pair
    load = np.bincount(pair, force).max()
    number = _numbers(joined, place, contact.dim)
    found: dict[int, Across] = {}
    for one in np.flatnonzero((force >= LEAST_SHARE * load) & np.isfinite(number)):
        key, across = int(pair[one]), Across(float(number[one]), float(force[one]))
        found[key] = min(found.get(key, across), across, key=lambda a: a.facets)
    return found


def _pressed(contact: Interfaces, p: ContactPoints) -> _Pressed:
    """The facets of this rank that are pressed, each once for each pair that it meets."""
    rows = p.projected_points
    pressed = np.flatnonzero(p.response.traction < 0.0)
    rows, traction, x = rows[pressed], p.response.traction[pressed], p.position[pressed]
    number, facet = p.numbers_in_results(contact.pairs)[pressed], p.points.facet[rows]
    normal = point_normals(p.slave.kind, p.points.xi[rows], p.slave.reference[facet], p.slave.orientation[facet])
    area = p.points.area[rows]
    squares = np.einsum("mi,mj->mij", x, x).reshape(len(x), contact.dim**2)
    moments = area[:, None] * np.hstack([x, squares, normal])
    values = np.column_stack([-traction * p.points.weight[rows] * p.share, area, moments])
    keys, group = np.unique(np.stack([number, facet], axis=1), axis=0, return_inverse=True)
    sums = np.zeros((len(keys), values.shape[1]))
    np.add.at(sums, group.ravel(), values)
    size = np.zeros(len(keys))
    size[group.ravel()] = p.facet_size[rows]
    of = keys[:, 1]
    return _Pressed(keys[:, 0], p.slave.body[of], p.slave.nodes[of], sums[:, 0], sums[:, 1], sums[:, 2:], size)


def _places(facets: _Pressed) -> NDArray[np.int32]:
    """Number (f,) of the place that each facet belongs to: facets of one pair and body that share nodes."""
    f, n = facets.nodes.shape
    keys = np.column_stack([np.repeat(facets.pair, n), np.repeat(facets.body, n), facets.nodes.ravel()])
    _, node = np.unique(keys, axis=0, return_inverse=True)
    links = scipy.sparse.coo_matrix((np.ones(f * n), (np.repeat(np.arange(f), n), f + node.ravel())), (2 * f * n,) * 2)
    _, label = scipy.sparse.csgraph.connected_components(links, directed=False)
    return np.unique(label[:f], return_inverse=True)[1]


def _numbers(facets: _Pressed, place: NDArray[np.int32], d: int) -> Array:
    """Number of facets across each place; infinite on flat faces."""
    count = int(place.max()) + 1
    sums = np.zeros((count, facets.moments.shape[1]))
    np.add.at(sums, place, facets.moments)
    area = np.bincount(place, facets.area)
    mean = sums / area[:, None]
    size = np.bincount(place, facets.area * facets.size) / area
    facets_of = np.bincount(place)
    x, squares, normal = mean[:, :d], mean[:, d : d + d * d].reshape(-1, d, d), mean[:, d + d * d :]
    if d == 2:
        width = area
    else:
        moments = np.linalg.eigvalsh(squares - x[:, :, None] * x[:, None, :])
        width = 4.0 * np.sqrt(np.maximum(moments[:, 1], 0.0))
    # The mean of unit normals is shorter the more they differ.
    flat = (np.linalg.norm(normal, axis=1) > 1.0 - FLAT**2) & (facets_of > 1)
    return np.where(flat, np.inf, np.maximum(width / size, 1.0))
