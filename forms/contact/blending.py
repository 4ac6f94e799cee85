"""Blending: gap and jump of a point near an edge of the master, as a mean over the facets that meet there.

The surface of flat facets has edges, where the closest point jumps from one facet to the next and the normal with it.
Which of the two a converged point is on would then depend on the path of Newton's method. Here the gap of a point near
an edge is

    g = sum_i s_i g_i / sum_i s_i

over the facets i that meet at the edge or vertex. g_i is the distance from the plane of facet i, and s_i, the facet's
share, falls smoothly from one to zero between `WIDTH` inside and outside its sides. The potential jump is the
same mean. Both are functions of the state alone, with continuous first derivatives. Over an edge both facets have the
same share, whatever their order, and the force acts along the mean of their normals. Flat facets give what one facet
gives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.facets import FacetKind
from piezomat.forms.contact.integrals import FacetPairs, PointForces

# Half the width of the band around an edge, over the least height of the facets that meet there, by the order of the
# mesh. In the array of twelve fibers, 137 Newton iterations without blending, 0.03 takes 133 and a cut step, 0.06 136,
# 0.1 147. The points of facets of order 2, 0.034 from their ends, are outside where meshes match.
WIDTH = {1: 0.06, 2: 0.03}


@dataclass(frozen=True)
class FacetShare:
    """Shares s of facets as functions of k projections: value (k,), first (k, t) and second (k, t, t) derivatives."""

    value: Array
    first: Array
    second: Array

    @classmethod
    def at(cls, kind: FacetKind, xi: Array, width: Array) -> FacetShare:
        """Shares at reference coordinates xi (k, t): a product over the sides of a step of the distance from each.

        width (k, sides): half that of the step, over the facet's height on the side.
        """
        start, slopes = kind.sides
        u = np.clip((start + xi @ slopes.T) / width, -1.0, 1.0)
        within = np.abs(u) < 1.0
        step = 0.5 + 0.75 * u - 0.25 * u**3
        rise, bend = within * 0.75 * (1.0 - u**2) / width, within * -1.5 * u / width**2
        value = step.prod(axis=1)
        first, second = np.zeros(xi.shape), np.zeros((*xi.shape, kind.dim))
        every = range(len(slopes))
        for i in every:
            others = np.delete(step, i, axis=1).prod(axis=1)
            first += (rise[:, i] * others)[:, None] * slopes[i]
            second += (bend[:, i] * others)[:, None, None] * np.outer(slopes[i], slopes[i])
            for j in every:
                if j != i:
                    others = np.delete(step, [i, j], axis=1).prod(axis=1)
                    second += (rise[:, i] * rise[:, j] * others)[:, None, None] * np.outer(slopes[i], slopes[j])
        return cls(value, first, second)

    def __getitem__(self, pairs: Integers) -> FacetShare:
        return FacetShare(self.value[pairs], self.first[pairs], self.second[pairs])


def mean_values(point: Integers, share: Array, values: Array) -> Array:
    """Means (b,) over the facets of each point of values (k,), with shares (k,); point (k,) counts from 0."""
    return np.bincount(point, share * values) / np.bincount(point, share)


@dataclass(frozen=True)
class BlendedTerms:
    """Residual and tangent of b points with k facets in all.

    vectors (k, n, c): of each point and facet, nodes of the slave first
    matrices (k, n * c, n * c): of each point and facet; None without tangent
    one, other (l,): two facets of the same point, as numbers of pairs of point and facet
    coupling (l, n * c, n * c): tangent between the nodes of the two, zero but for them
    """

    vectors: Array
    matrices: Array | None
    one: Integers
    other: Integers
    coupling: Array | None


def blended_vectors(
    pairs: FacetPairs, share: FacetShare, point: Integers, forces: PointForces, *, tangent: bool
) -> BlendedTerms:
    """Residual and tangent of points whose gap and jump are means over several facets.

    pairs, share (k,): of each point and facet, ordered by point; point (k,): number of the point; forces (b,): of each
    """
    v = pairs.vary((share.first, share.second) if tangent else None, second=tangent)
    total = np.bincount(point, share.value)[point]
    values = _values(pairs)
    change_of_share = np.einsum("ma,mar->mr", share.first, v.xi)
    k, r, nodes, components = v.rows.shape
    rows = v.rows.reshape(k, r, nodes * components)
    # First variations of the two means, and that of the share over the sum of shares.
    coefficients, apart, along = [], [], np.zeros_like(change_of_share)
    for value, change, force in zip(values, v.first, forces.residual.T, strict=True):
        apart.append(value - mean_values(point, share.value, value)[point])
        part = (share.value[:, None] * change + apart[-1][:, None] * change_of_share) / total[:, None]
        coefficients.append(part)
        along = along + force[point][:, None] * part
    weight, each = forces.weight, forces.weight[point]
    vectors = np.einsum("m,mr,mrn->mn", each, along, rows).reshape(k, nodes, components)
    if not tangent:
        return BlendedTerms(vectors, None, *np.zeros((2, 0), np.int64), None)
    coefficients.append(change_of_share / total[:, None])
    stack = np.stack(coefficients, axis=1)
    middle = np.zeros((len(weight), len(stack[0]), len(stack[0])))
    middle[:, :-1, :-1] = forces.hessian
    middle[:, :-1, -1] = middle[:, -1, :-1] = -forces.tangent
    middle = weight[:, None, None] * middle
    own = np.zeros((k, r, r))
    for change, change2, off, force in zip(v.first, v.second, apart, forces.tangent.T, strict=True):
        cross = change[:, :, None] * change_of_share[:, None, :]
        bent = share.value[:, None, None] * change2 + off[:, None, None] * v.function2
        own += (each * force[point] / total)[:, None, None] * (bent + cross + np.swapaxes(cross, 1, 2))
    matrices = np.swapaxes(rows, 1, 2) @ (own @ rows)
    # The first variations of a point are sums over its facets. The nodes of the slave are the same for all of these.
    full, half = stack @ rows, rows.shape[2] // 2
    first_pair = np.searchsorted(point, np.arange(len(weight)))
    slave, master = np.add.reduceat(full[:, :, :half], first_pair), full[:, :, half:]
    on_slave = np.swapaxes(slave, 1, 2) @ middle
    on_master = np.swapaxes(master, 1, 2) @ middle[point]
    matrices[first_pair, :half, :half] += on_slave @ slave
    across = on_slave[point] @ master
    matrices[:, :half, half:] += across
    matrices[:, half:, :half] += np.swapaxes(across, 1, 2)
    matrices[:, half:, half:] += on_master @ master
    one, other = _pairs_of_facets(point)
    between, coupling = on_master[one] @ master[other], np.zeros((len(one), 2 * half, 2 * half))
    coupling[:, :half, half:], coupling[:, half:, :half] = between, np.swapaxes(between, 1, 2)
    return BlendedTerms(vectors, matrices, one, other, coupling)


def _values(pairs: FacetPairs) -> list[Array]:
    """Gap (k,) and, with potentials, minus the master's potential (k,), whose means are varied."""
    gap, potentials = pairs.projection.gap, pairs.potentials
    if potentials is None:
        return [gap]
    return [gap, -np.einsum("mk,mk->m", pairs.kind.shape(pairs.projection.xi), potentials)]


def blended_changes(pairs: FacetPairs, share: FacetShare, point: Integers, change: Array) -> Array:
    """First-order changes (b, q) of mean gaps and jumps for changes (k, n, c) of each pair's unknowns.

    Arguments as of `blended_vectors`.
    """
    v = pairs.vary(second=False)
    along = np.einsum("mrnc,mnc->mr", v.rows, change)
    shift = np.einsum("ma,mar,mr->m", share.first, v.xi, along)
    total, changes = np.bincount(point, share.value), []
    for value, varied in zip(_values(pairs), v.first, strict=True):
        apart = value - mean_values(point, share.value, value)[point]
        part = share.value * np.einsum("mr,mr->m", varied, along) + apart * shift
        changes.append(np.bincount(point, part) / total)
    return np.stack(changes, axis=1)


def _pairs_of_facets(point: Integers) -> tuple[Integers, Integers]:
    """All two facets (l,) of each point, as numbers of pairs of point and facet; point (k,) is sorted."""
    count = np.bincount(point)
    last = np.cumsum(count)[point]
    rest = last - np.arange(len(point)) - 1
    one = np.repeat(np.arange(len(point)), rest)
    before = np.cumsum(rest) - rest
    return one, one + 1 + np.arange(len(one)) - before[one]
