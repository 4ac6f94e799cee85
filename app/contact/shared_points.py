"""Points near an edge of the master surface, which several of its facets share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.contact.detected_facets import DetectedFacets
from piezomat.contact.nodal_state import NodalState
from piezomat.contact.terms import ContactTerms
from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.blending import WIDTH, FacetShare, blended_vectors, mean_values
from piezomat.forms.contact.gap import Projection, project
from piezomat.forms.contact.integrals import FacetPairs, PointForces
from piezomat.meshes.contact.joined_facets import may_reach

REACH = 0.5  # of a facet: how far off a curved facet a point may seem to be and yet be over it


@dataclass(frozen=True)
class SharedPoints:
    """Points and the facets that share each of them: k pairs of b points, ordered by point, then by the facet's key.

    row (b,): number of the point
    point (k,): number of the pair's point, from 0 to b - 1
    facet (k,), projection (k,), share (k,): master facet, projection onto it, and its share
    """

    row: Integers
    point: Integers
    facet: Integers
    projection: Projection
    share: FacetShare

    @classmethod
    def of(
        cls,
        facets: DetectedFacets,
        position: Array,
        points: Array,
        slave: Integers,
        facet: Integers,
        blending: float,
    ) -> SharedPoints:
        """The facets over which points have a share, also where it is one alone.

        position (n, d): of the seen nodes; points (m, d), um, on slave facets (m,); facet (m,): one of the facets;
        those that are joined to it are tried; blending: width of the shares, over `WIDTH`. Deep behind a convex edge,
        points are well over both of its facets.
        """
        kind = facets.kind
        width = blending * WIDTH[1 if facets.master.rounding.shape[1] else kind.order]
        row, other = facets.joined.of_facets(facet)
        may = facets.may_meet(slave[row], other) if facets.self_contact is not None else np.ones(len(row), bool)
        row, other = row[may], other[may]
        tried, place = np.unique(other, return_inverse=True)
        nodes = facets.master_at(position, tried)
        close, start = may_reach(kind, points, nodes, row, place, width if kind.affine else REACH)
        row, other, place = row[close], other[close], place[close]
        projection = project(kind, points[row], nodes[place], facets.master.orientation[other], start)
        share = FacetShare.at(kind, projection.xi, width * facets.joined.height[other])
        some = np.flatnonzero(share.value > 0.0)
        some = some[np.lexsort((facets.master.key[other[some]], row[some]))]
        shared, point = np.unique(row[some], return_inverse=True)
        return cls(shared, point, other[some], projection[some], share[some])

    @classmethod
    def none(cls, projection: Projection) -> SharedPoints:
        """None of the points with these projections."""
        empty, t = np.zeros(0, np.int64), projection.xi.shape[1]
        share = FacetShare(np.zeros(0), np.zeros((0, t)), np.zeros((0, t, t)))
        return cls(empty, empty, empty, projection[empty], share)

    def largest(self) -> Integers:
        """The pair (b,) with the largest share of each point."""
        order = np.lexsort((-self.share.value, self.point))
        return order[np.unique(self.point[order], return_index=True)[1]]

    def of_several(self) -> SharedPoints:
        """The points that more than one facet shares."""
        return self[np.flatnonzero(np.bincount(self.point, minlength=len(self.row)) > 1)]

    def __getitem__(self, points: Integers) -> SharedPoints:
        place = np.full(len(self.row), -1)
        place[points] = np.arange(len(points))
        pairs = np.flatnonzero(place[self.point] >= 0)
        facet, projection, share = (part[pairs] for part in (self.facet, self.projection, self.share))
        return SharedPoints(self.row[points], place[self.point[pairs]], facet, projection, share)

    def mean_potentials(self, facets: DetectedFacets, potentials: Array, slave: Integers) -> Array:
        """Mean potentials (b,) of the masters; slave: the slave facet of each point that `row` numbers."""
        there = facets.potentials_at(potentials, slave[self.row][self.point], self.facet)[1]
        there = np.einsum("mk,mk->m", facets.kind.shape(self.projection.xi), there)
        return mean_values(self.point, self.share.value, there)

    def pairs(
        self, facets: DetectedFacets, at: NodalState, slave: Integers, shape: Array, *, charged: bool
    ) -> FacetPairs:
        """The pairs of each point with each facet, given slave facet and shape functions of each point in `row`."""
        points = self.row[self.point]
        return facets.pairs(at, slave[points], self.facet, self.projection, shape[points], charged=charged)

    def terms(
        self,
        facets: DetectedFacets,
        at: NodalState,
        slave: Integers,
        shape: Array,
        forces: PointForces,
        *,
        tangent: bool,
    ) -> tuple[list[ContactTerms], Array]:
        """Terms of each point with each facet and, with `tangent`, between these facets; forces (k, d) on them.

        slave, shape, forces: of each point that `row` numbers.
        """
        pairs = self.pairs(facets, at, slave, shape, charged=forces.residual.shape[1] > 1)
        facet, master = slave[self.row][self.point], self.facet
        found = blended_vectors(pairs, self.share, self.point, forces[self.row], tangent=tangent)
        terms = [ContactTerms(facets.nodes_of(facet, master), found.vectors, found.matrices)]
        if tangent:
            one, other = (facets.master_nodes[master[pair]] for pair in (found.one, found.other))
            none = np.zeros((len(one), *found.vectors.shape[1:]))
            terms.append(ContactTerms(np.concatenate([one, other], axis=1), none, found.coupling))
        return terms, force_on_master(found.vectors, at.position.shape[1])


def force_on_master(vectors: Array, dim: int) -> Array:
    """Forces (k, dim) on the master of the vectors (k, 2 n, c) of points and facets, slave nodes first."""
    return -vectors[:, : vectors.shape[1] // 2, :dim].sum(axis=1)
