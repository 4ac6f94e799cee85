"""Contact of a slave surface whose facets are cut into segments along the edges of the master facets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.contact.surface_pair import SurfacePair
from piezomat.discretization.state import Points, ReadPoints
from piezomat.forms.arrays import Array, Booleans
from piezomat.forms.contact.facets import Facets
from piezomat.forms.contact.gap import project
from piezomat.forms.contact.integrals import SlavePoints, with_closed_points
from piezomat.forms.contact.segments import nearest_points, segment_points
from piezomat.meshes.contact.facet_bounds import facing_pairs

# Segments are cut anew once a point has slid by this share of a facet since: a kink that is missed by so much costs
# the square of it.
CUT_DRIFT = 1e-3


@dataclass(kw_only=True)
class SegmentedPair(SurfacePair):
    """A surface pair with the points of the segments of the slave facets, cut at every detection.

    Master facets count that come nearer than the cut distance. Facets with points at their corners are not cut. A new
    point takes the history of the nearest one that its facet had at the last converged step.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        self._size_of_facets = self.facet_size[np.searchsorted(self.points.facet, np.arange(len(self.slave)))]

    def _cut(self, position: Array, distance: float) -> None:
        """Cut the slave facets along the edges of the master facets that come nearer than `distance`."""
        facets, kind = self.facets, self.slave.kind
        slave = Facets(kind, facets.slave_at(position), self.slave.orientation, self.slave.key)
        master = Facets(kind, facets.master_at(position), facets.master.orientation, facets.master.key)
        pairs = facing_pairs(slave, master, distance)
        allowed = facets.may_meet(*pairs) & ~self.closed[pairs[0]]
        pairs = pairs[0][allowed], pairs[1][allowed]
        points, covered = segment_points(self.slave.reference, slave, master, pairs)
        cut = covered[~self.closed[points.facet]]
        points, covered = with_closed_points(points, kind, self.slave.reference, self.closed)
        covered[~covered] = cut
        bonds = self.viscous_bonds[nearest_points(points.facet, points.xi, self.points)]
        converged = self._converged
        self._set_points(points)
        self.covered, self.viscous_bonds = covered, bonds
        self._uncut = ~np.isin(points.facet, pairs[0]) & ~self.closed[points.facet]
        nearest = nearest_points(points.facet, points.xi, converged.points)
        self.history, self.met = converged.history[nearest], converged.met[nearest]
        self._take_law(self.met)

    def _shared_facets(self) -> Booleans:
        """Segments end at the edges of the master."""
        return self.closed

    def _set_points(self, points: SlavePoints) -> None:
        super()._set_points(points)
        self.facet_size = self._size_of_facets[points.facet]

    def has_stale_segments(self, before: Array, interaction_range: float) -> bool:
        """Whether points in contact have slid since the cut, with the nodes at `before`, or are on uncut facets."""
        acts = (self.projection.gap < interaction_range) | (self.response.traction != 0.0)
        acts &= ~self.closed[self.points.facet[self.projected_points]]
        rows, master, xi = self.projected_points[acts], self.master_facet[acts], self.projection.xi[acts]
        facets, facet = self.facets, self.points.facet[rows]
        points = np.einsum("mk,mkd->md", self.points.shape[rows], facets.slave_at(before, facet))
        nodes, orientation = facets.master_at(before, master), facets.master.orientation[master]
        slide = np.abs(project(facets.kind, points, nodes, orientation, xi).xi - xi).max(initial=0.0)
        return bool(slide > CUT_DRIFT or self._uncut[rows].any())

    def saved(self, *, augmented: bool) -> Points:
        """See `SurfacePair.saved`; also where points lie, which follows from states before this one."""
        return super().saved(augmented=augmented) | {"place": (self.keys(), self.points.xi)}

    def resume_points(self, read: ReadPoints, points_per_facet: int) -> None:
        """Take up the points that a checkpoint holds, their weights left to the next cut. Collective.

        points_per_facet: largest number of points of a facet.
        """
        facet, place = np.divmod(np.arange(len(self.slave) * points_per_facet), points_per_facet)
        xi, found = read("place", self._keys(facet, place), self.points.xi.shape[1])
        facet, place, xi, none = facet[found], place[found], xi[found], np.zeros(found.sum())
        self._set_points(SlavePoints(facet, place, xi, self.slave.kind.shape(xi), none, none))
        self._start_history()
