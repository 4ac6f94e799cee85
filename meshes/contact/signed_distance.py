"""Signed distance of points from a body: by the nearest facet, whatever it faces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.forms.contact.facets import FacetKind, Facets
from piezomat.forms.contact.gap import project
from piezomat.meshes.contact.facet_bounds import FACING, TIE, Pairs, all_within, may_be_nearest

SEARCH_ITERATIONS = 6  # of the projection on a curved facet: enough for points over the facet


@dataclass(frozen=True)
class PointFacetPairs:
    """Pairs (point, facet), (k,), with projections, distances, and whether they face each other.

    row, facet (k,): point and facet
    xi (k, t), gap (k,), normal (k, d): of the projection, which may lie on the facet's extension
    distance, size (k,): distance to the facet itself and size of the facet, um
    facing (k,): whether the facet faces the surface that the point is on
    """

    row: Integers
    facet: Integers
    xi: Array
    gap: Array
    normal: Array
    distance: Array
    size: Array
    facing: Booleans

    def __getitem__(self, pairs: Integers | Booleans) -> PointFacetPairs:
        return PointFacetPairs(*(getattr(self, name)[pairs] for name in self.__dataclass_fields__))

    def followed_by(self, more: PointFacetPairs) -> PointFacetPairs:
        """These pairs, then more."""
        both = ((getattr(self, name), getattr(more, name)) for name in self.__dataclass_fields__)
        return PointFacetPairs(*(np.concatenate(parts) for parts in both))

    def least(self, points: int) -> Array:
        """Distance (points,) of each point to the nearest of its facets, inf for none."""
        least = np.full(points, np.inf)
        np.minimum.at(least, self.row, self.distance)
        return least


@dataclass(frozen=True)
class NearestFacets:
    """The facet nearest to each point, whatever it faces; of equally near ones that with the largest gap, or depth.

    gap (m,): negative inside the body, inf where no facet is near, um
    normal (m, d): outward
    over (m,): whether the projection lies on the facet
    faces (m,): whether one of the equally near facets faces the surface that the point is on
    """

    gap: Array
    normal: Array
    over: Booleans
    faces: Booleans

    @classmethod
    def of(cls, kind: FacetKind, seen: PointFacetPairs, points: int) -> NearestFacets:
        """The nearest facets of `points` points out of pairs that include them."""
        tied = seen[seen.distance <= seen.least(points)[seen.row] + TIE * seen.size]
        faces, over = np.zeros((2, points), bool)
        np.logical_or.at(faces, tied.row, tied.facing)
        # The two facets of an edge are equally near to points in front of it. Such a point may be behind the plane of
        # one of them if the edge is sharp, but it is further in front of the other.
        order = np.lexsort((-np.abs(tied.gap), tied.row))
        row, first = np.unique(tied.row[order], return_index=True)
        first = order[first]
        gap, normal = np.full(points, np.inf), np.zeros((points, tied.normal.shape[1]))
        gap[row], normal[row] = tied.gap[first], tied.normal[first]
        over[row] = kind.overshoot(tied.xi[first]) <= 0.0
        return cls(gap, normal, over, faces)

    @property
    def inside(self) -> Booleans:
        """Whether each point (m,) is inside the body, or on its surface."""
        return self.gap <= 0.0


def nearest_facets(
    points: Array, normals: Array, facets: Facets, margin: float = np.inf, pairs: Pairs | None = None
) -> NearestFacets:
    """The nearest facet of each point (m, d) within `margin` (um), whatever it faces; arguments as `relevant_pairs`."""
    seen, _ = relevant_pairs(points, normals, facets, margin, pairs, facing=False)
    return NearestFacets.of(facets.kind, seen, len(points))


def relevant_pairs(
    points: Array, normals: Array, facets: Facets, margin: float, pairs: Pairs | None, *, facing: bool = True
) -> tuple[PointFacetPairs, Array]:
    """Pairs of each point and the nearest facet that faces its surface, and all nearer ones; a lower bound (m,).

    The bound is of the distances of all facets, at most `margin`. Other pairs may be included.

    points, normals (m, d): points and outward normals of the surface that they are on, um
    margin: distance, um, beyond which facets may be left out
    pairs: the only ones that count; default all
    facing: with False, pairs of each point and the nearest facet, whatever it faces
    """
    row, facet, bound, unseen = may_be_nearest(points, normals, facets, margin, pairs, facing=facing)
    seen = projected_pairs(points, normals, facets, row, facet)
    least = (seen[seen.facing] if facing else seen).least(len(points))
    again = np.flatnonzero(np.isfinite(least) & (unseen < least))
    if len(again):
        more_row, more_facet = all_within(points[again], facets.nodes, least[again])
        more = projected_pairs(points, normals, facets, again[more_row], more_facet)
        seen = seen[~np.isin(row, again)].followed_by(more)
    return seen, bound


def projected_pairs(points: Array, normals: Array, facets: Facets, row: Integers, facet: Integers) -> PointFacetPairs:
    """Projections of the points `row` (k,) on the facets `facet` (k,)."""
    kind = facets.kind
    p = project(kind, points[row], facets.nodes[facet], facets.orientation[facet], iterations=SEARCH_ITERATIONS)
    metric = np.einsum("mad,mbd->mab", p.tangents, p.tangents)
    nearest = np.einsum("mk,mkd->md", kind.shape(kind.clamp(p.xi, metric)), p.nodes)
    distance = np.linalg.norm(points[row] - nearest, axis=1)
    size = np.linalg.norm(np.ptp(p.nodes, axis=1), axis=1)
    facing = np.einsum("md,md->m", p.normal, normals[row]) < FACING
    return PointFacetPairs(row, facet, p.xi, p.gap, p.normal, distance, size, facing)
