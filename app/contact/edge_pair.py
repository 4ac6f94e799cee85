"""Contact of sharp edges that cross, which neither points of facets nor corners see."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from piezomat.contact.closest_points import ClosestPoints, SearchLimits
from piezomat.contact.detected_facets import DetectedFacets
from piezomat.contact.nodal_state import NodalState
from piezomat.contact.seen_nodes import SeenNodes
from piezomat.contact.surface_pair import SurfacePair
from piezomat.contact.terms import ContactTerms
from piezomat.forms.arrays import Array
from piezomat.forms.contact.corners import corner_share, facet_frames
from piezomat.forms.contact.edges import crossings, sides
from piezomat.forms.contact.facets import FacetKind
from piezomat.forms.contact.gap import Projection
from piezomat.forms.contact.integrals import SlavePoints
from piezomat.forms.contact.laws.interface import InterfaceLaw
from piezomat.forms.contact.laws.response import History
from piezomat.meshes.contact.facet_bounds import near_pairs
from piezomat.meshes.contact.sharp_edges import EdgedFacets

DEEPEST = 0.5  # of the smaller facet: what is deeper has not crossed there


@dataclass(kw_only=True)
class EdgePair(SurfacePair):
    """Crossings of sharp edges of the slave facets with those of the master facets, as contact points.

    Its points are those of the last evaluation. They have no history and pass no charge. A crossing is seen from each
    of the two facets at either edge, with a quarter of its weight, the product of the lengths of the edges.

    Given, besides what `SurfacePair` has; the points are none:
    edges (f, e, 2, d): of the slave facets, see `sharp_edges`; those of the master are in `master`
    facet_law: interface law of each slave facet, without adhesion and electric contact
    size (f,): of the slave facets, um
    """

    edges: Array
    facet_law: InterfaceLaw
    size: Array

    @property
    def side(self) -> int:
        """5: neither a surface of the pair nor its corners."""
        return 5

    def detect(
        self,
        masters: EdgedFacets,
        nodes: SeenNodes,
        position: Array,
        geodesic: Array | None,
        radius: float,
        cut_distance: float,
    ) -> None:
        """Find the pairs of edges that come near, see `SurfacePair.detect`."""
        facets = self.facets = DetectedFacets.of(self.slave, masters, self.rule, nodes, geodesic)
        self.slave_nodes = facets.slave_nodes
        self._set_points(no_points(self.slave.kind))
        depth = self.depth, self.self_depth
        self.closest = ClosestPoints(facets, self.points, self.covered, depth, position, radius)
        self.near_points = self.closest.near
        slave, master = near_pairs(facets.slave_at(position), facets.master_at(position), radius)
        may = facets.may_meet(slave, master)
        slave, master = slave[may], master[may]
        ours, theirs = (
            (edges[facet] != 0.0).any(axis=(2, 3)) for edges, facet in ((self.edges, slave), (masters.edges, master))
        )
        pair, here, there = np.nonzero(ours[:, :, None] & theirs[:, None, :])
        self._near = slave[pair], here, master[pair], there

    def update_projections(self, position: Array, limits: SearchLimits) -> None:
        """Find the crossings with the seen nodes at `position` (n, d)."""
        slave, here, master, there = self._near
        kind, pairs = self.slave.kind, np.array(sides(self.slave.kind))
        slave_nodes, master_nodes = self.facets.slave_at(position, slave), self.facets.master_at(position, master)
        row = np.arange(len(slave))[:, None]
        ends = slave_nodes[row, pairs[here]], master_nodes[row, pairs[there]]
        middle = np.tile(kind.middle, (len(slave), 1))
        normals = []
        for facets, facet, nodes, edges in (
            (self.slave, slave, slave_nodes, self.edges[slave, here]),
            (self.facets.master, master, master_nodes, self.facets.master.edges[master, there]),
        ):
            frames = facet_frames(kind, middle, nodes, facets.orientation[facet])
            normals.append(np.einsum("kia,kad->kid", edges, frames))
        found = crossings(*ends, *normals)
        lengths = [np.linalg.norm(end[:, 1] - end[:, 0], axis=1) for end in ends]
        within = (found.gap < limits.candidate_range) & (found.gap > -DEEPEST * np.minimum(*lengths))
        some = np.flatnonzero(found.crosses & within)
        # What lies flat on the other body is seen by the points of its facets.
        eye = np.tile(np.eye(3), (len(some), 1, 1))
        share = corner_share(normals[0][some], eye, found.normal[some])
        share *= corner_share(normals[1][some], eye, -found.normal[some])
        acts = share > 0.0
        some, share = some[acts], share[acts]
        at = []
        for edge, along in ((here, found.s), (there, found.t)):
            low, high = (kind.nodes[pairs[edge[some], end]] for end in (0, 1))
            at.append(low + along[some, None] * (high - low))
        weight = 0.25 * share * lengths[0][some] * lengths[1][some]
        points = SlavePoints(slave[some], here[some], at[0], kind.shape(at[0]), weight, weight)
        self._set_points(points)
        self.projected_points, self.master_facet, self.weight = np.arange(len(some)), master[some], self.share * weight
        nodes = master_nodes[some]
        self.position = np.einsum("mk,mkd->md", points.shape, slave_nodes[some])
        tangents = np.stack([np.einsum("mk,mkd->md", kind.shape(at[1], (axis,)), nodes) for axis in range(2)], axis=1)
        second = np.zeros((len(some), 2, 2, 3))
        self.projection = Projection(
            nodes, at[1], found.gap[some], found.normal[some], tangents, second, second[..., 0]
        )

    def evaluate(self, at: NodalState, *, tangent: bool, viscous: bool) -> ContactTerms:
        """Terms of the crossings; without the rotation of the force with the edges, a thousandth of the tangent."""
        return super().evaluate(replace(at, consistent_tangent=False), tangent=tangent, viscous=viscous)

    def commit(self) -> None:
        """Crossings have no history."""
        self._converged = self.snapshot()

    def _set_points(self, points: SlavePoints) -> None:
        super()._set_points(points)
        self.law, self.facet_size = self.facet_law[points.facet], self.size[points.facet]
        self.history = History.virgin(len(points.facet))


def no_points(kind: FacetKind) -> SlavePoints:
    """No contact points on facets of a kind."""
    none = np.zeros(0)
    number = np.zeros(0, np.int64)
    return SlavePoints(number, number, np.zeros((0, kind.dim)), np.zeros((0, len(kind.nodes))), none, none)
