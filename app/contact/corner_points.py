"""Contact points at the sharp corners of a surface, where points inside facets do not see what comes first."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.corners import corner_share, facet_frames
from piezomat.forms.contact.facets import corner_kind
from piezomat.forms.contact.integrals import SlavePoints, nodal_points
from piezomat.meshes.contact.load_balance import SlaveFacets
from piezomat.meshes.contact.sharp_corners import SharpCorners


@dataclass(frozen=True)
class CornerPoints:
    """Which contact points are sharp corners, and how much they act.

    corner (m,): number of the corner of each point, -1 for points that are none
    normals (c, k, d): normals of the facets that meet at a corner, see `SharpCorners`
    """

    corner: Integers
    normals: Array

    def share(self, facets: SlaveFacets, nodes: Array, points: SlavePoints, some: Integers, other: Array) -> Array:
        """Share (r,) to which some points act, see `corner_share`; 1 for points that are no corners.

        nodes (r, n, d): of their facets, um; other (r, d): normals of the other side
        """
        share, corner = np.ones(len(some)), self.corner[some]
        rows = np.flatnonzero(corner >= 0)
        if len(rows):
            xi, orientation = points.xi[some[rows]], facets.orientation[points.facet[some[rows]]]
            frames = facet_frames(facets.kind, xi, nodes[rows], orientation)
            share[rows] = corner_share(self.normals[corner[rows]], frames, other[rows])
        return share


def corner_points(facets: SlaveFacets, corners: SharpCorners) -> tuple[SlavePoints, CornerPoints]:
    """The points at the sharp corners of slave facets, with the area of a node."""
    flat = corner_kind(facets.kind)
    count = len(flat.nodes)
    every = nodal_points(flat, facets.reference[:, :count])
    some = corners.facet * count + corners.place
    points = SlavePoints(*(getattr(every, name)[some] for name in every.__dataclass_fields__))
    return replace(points, shape=facets.kind.shape(points.xi)), CornerPoints(np.arange(len(some)), corners.normals)


def joined(points: SlavePoints, corners: tuple[SlavePoints, CornerPoints]) -> tuple[SlavePoints, CornerPoints]:
    """Points of facets and, behind them, those at their corners."""
    more, which = corners
    place = more.place + int(points.place.max(initial=-1)) + 1
    names = SlavePoints.__dataclass_fields__
    both = (getattr(points, name) for name in names), (getattr(replace(more, place=place), name) for name in names)
    none = np.full(len(points.weight), -1)
    return SlavePoints(*map(np.concatenate, zip(*both, strict=True))), replace(
        which, corner=np.concatenate([none, which.corner])
    )
