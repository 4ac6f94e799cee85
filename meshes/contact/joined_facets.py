"""Facets that meet at a node without a sharp edge between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.facets import FacetKind
from piezomat.forms.contact.gap import point_normals
from piezomat.meshes.contact.nodal_normals import SHARP

FLAT = 1e-4  # angle between two normals, below which facets are in one plane


@dataclass(frozen=True)
class JoinedFacets:
    """For each facet (f,) those that share a corner with it and whose normals are within 50 degrees of its own.

    None is joined to a facet whose neighbours are all in its plane. A flat surface has no edges, and the patch test is
    exact there only if each point acts on the facet that it is over.

    start (f + 1,), facet: the joined facets of facet i are facet[start[i] : start[i + 1]]; a facet is joined to itself
    height (f, s): least height of the facets that are joined to one, over its own height on each side, at most 1
    """

    start: Integers
    facet: Integers
    height: Array

    @classmethod
    def of(cls, kind: FacetKind, corners: Integers, reference: Array, orientation: Array) -> JoinedFacets:
        """Joined facets, of nodes `corners` (f, n) at the corners and undeformed nodes `reference` (f, n, d), um."""
        f, n = corners.shape
        if not f:
            return cls(np.zeros(1, np.int64), np.zeros(0, np.int64), np.zeros((0, len(kind.sides[0]))))
        touches = csr_matrix((np.ones(f * n), corners.ravel(), np.arange(0, f * n + 1, n)))
        pairs = (touches @ touches.T).tocoo()
        one, other = pairs.row.astype(np.int64), pairs.col.astype(np.int64)
        normal = point_normals(kind, np.tile(kind.middle, (f, 1)), reference, orientation)
        joins = np.einsum("kd,kd->k", normal[one], normal[other]) > SHARP
        one, other = one[joins], other[joins]
        flat = np.ones(f, bool)
        flat[one[np.linalg.norm(normal[one] - normal[other], axis=1) > FLAT]] = False
        joins = (one == other) | ~(flat[one] | flat[other])
        one, other = one[joins], other[joins]
        order = np.lexsort((other, one))
        start, joined = np.concatenate([[0], np.cumsum(np.bincount(one, minlength=f))]), other[order]
        height = _heights(kind, reference)
        least = np.minimum.reduceat(height.min(axis=1)[joined], start[:-1])
        return cls(start, joined, least[:, None] / height)

    def of_facets(self, some: Integers) -> tuple[Integers, Integers]:
        """The joined facets of some facets (m,): the number (k,) among these, and the joined facet."""
        count = self.start[some + 1] - self.start[some]
        row = np.repeat(np.arange(len(some)), count)
        before = np.cumsum(count) - count
        return row, self.facet[self.start[some][row] + np.arange(len(row)) - before[row]]


def may_reach(
    kind: FacetKind, points: Array, nodes: Array, row: Integers, facet: Integers, beyond: float
) -> tuple[Integers, Array]:
    """Pairs (r,) of points `row` (k,) that are over facets `facet` (k,), or less than `beyond` of a facet off them.

    Also the reference coordinates (r, t) there, of a curved facet the nearest ones in it of the flat facet that is
    tangent to its middle.

    points (m, d), nodes (f, n, d): um
    """
    middle, tangents = kind.middle, _tangents(kind, nodes)
    metric = tangents @ np.swapaxes(tangents, 1, 2)
    dual = np.linalg.solve(metric, tangents)
    start = middle - np.einsum("fad,k,fkd->fa", dual, kind.shape(middle[None])[0], nodes)
    xi = start[facet] + (dual[facet] @ points[row][:, :, None])[:, :, 0]
    close = np.flatnonzero(kind.overshoot(xi) < beyond)
    return close, xi[close] if kind.affine else kind.clamp(xi[close], metric[facet[close]])


def _tangents(kind: FacetKind, nodes: Array) -> Array:
    """Tangents (m, t, d) of facets (m, n, d) in their middle."""
    return np.stack([np.einsum("k,mkd->md", kind.shape(kind.middle[None], (a,))[0], nodes) for a in range(kind.dim)], 1)


def _heights(kind: FacetKind, nodes: Array) -> Array:
    """Heights (m, s) of facets (m, n, d) on each side, um: of a curved one those of the flat one in its middle."""
    tangents, slopes = _tangents(kind, nodes), kind.sides[1]
    inverse = np.linalg.inv(tangents @ np.swapaxes(tangents, 1, 2))
    return 1.0 / np.sqrt(np.einsum("sa,mab,sb->ms", slopes, inverse, slopes))
