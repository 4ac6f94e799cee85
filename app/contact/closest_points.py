"""Closest points: the master facet of each slave point, kept from one evaluation to the next (local search)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from piezomat.contact.detected_facets import DetectedFacets
from piezomat.contact.shared_points import SharedPoints
from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.forms.contact.blending import mean_values
from piezomat.forms.contact.facets import Facets
from piezomat.forms.contact.gap import Projection, point_normals, project
from piezomat.forms.contact.integrals import SlavePoints
from piezomat.meshes.contact.facet_bounds import TIE, near_points
from piezomat.meshes.contact.global_search import CandidatePairs
from piezomat.meshes.contact.local_search import closest_facets
from piezomat.meshes.contact.self_contact import Candidates

# A point keeps its master facet until its projection has left it by this share of the facet.
PROJECTION_TOLERANCE = 0.02
LARGEST_OVERSHOOT = 0.1  # the same, at most, of a point without contact that was outside its facet when found


@dataclass(frozen=True)
class SearchLimits:
    """How long points keep their master facets and how far new ones are searched for; lengths in um.

    everywhere: whether points without a closest point are searched for too
    detection_range: a facet may come as near as this before all points are searched for again
    candidate_range: largest gap of a closest point
    interaction_range: largest gap with a traction or a charge
    depth: penetration up to which a closest point is accepted, also where bodies are thinner
    approach: how much nearer to each other two points may have come since the last search everywhere
    """

    everywhere: bool
    detection_range: float
    candidate_range: float
    interaction_range: float
    depth: float
    approach: float


class ClosestPoints:
    """The near points (p,) of a surface pair after a detection, and their closest points. No method is collective.

    Invariant: all that a point may meet, other than its master facet's component, is further from it than
    `distance_bound - motion`.

    near (p,): the near points, numbered as in `points`
    candidates: for each component of master facets, its facets and the near points that may meet it
    self_candidates: for each of these, the facets that points of the same part may meet, or None for other parts
    facet (p,): master facet, -1 without a closest point
    xi (p, t): the closest point's coordinates in its facet
    overshoot (p,): share of the facet by which the projection was outside it when found, for points without contact
    apart (p,): whether the point was not behind its master facet at the last update
    distance_bound (p,): at the last search, um
    motion (p,): how much nearer things may have come by the last search everywhere, um; it grows from search to search
    """

    def __init__(
        self,
        facets: DetectedFacets,
        points: SlavePoints,
        covered: Booleans,
        depth: tuple[float, float],
        position: Array,
        radius: float,
        *,
        blending: float = 0.0,
        shared: Booleans | None = None,
    ) -> None:
        """Find the near points.

        covered (m,): points that can meet something; depth: penetrations (um) up to which closest points are accepted,
        of another part and of the same part; position (n, d): of the seen nodes; radius: search radius, um; blending:
        width over which several facets share a point near an edge, see `SharedPoints`, 0 without; shared (f,): slave
        facets whose points they may share.
        """
        self.facets, self.points, self._blending = facets, points, blending
        self._shared = np.zeros(len(facets.slave), bool) if shared is None or not blending else shared
        self._depth, self._self_depth = depth
        here = np.einsum("mk,mkd->md", points.shape, facets.slave_at(position, points.facet))
        masters = facets.master_at(position)
        component, rule = facets.slave.component[points.facet], facets.rule
        boxed = CandidatePairs.near(here, component, masters, facets.master.component, radius, rule)
        near: list[Integers] = []
        self.self_candidates: list[Candidates | None] = []
        for rows, targets, same_part in zip(boxed.points, boxed.facets, boxed.same_part, strict=True):
            rows = rows[covered[rows]]
            slaves = points.facet[rows]
            own = facets.self_candidates(position, np.unique(slaves), targets, radius) if same_part else None
            close = near_points(here[rows], masters[targets], radius) if own is None else own.count(slaves) > 0
            near.append(rows[close])
            self.self_candidates.append(own)
        self.near = np.unique(np.concatenate([np.zeros(0, np.int64), *near]))
        places = [np.searchsorted(self.near, rows) for rows in near]
        self.candidates = CandidatePairs(boxed.component, boxed.same_part, boxed.facets, places)
        count = len(self.near)
        self.facet = np.full(count, -1)
        self.xi = np.zeros((count, facets.kind.dim))
        self.overshoot, self.apart = np.zeros(count), np.zeros(count, bool)
        self.distance_bound, self.motion = np.zeros((2, count))

    def add_motion(self, motions: Array) -> None:
        """Bodies have moved by these distances (bodies,), um, since the last search everywhere."""
        rule, slave = self.facets.rule, self.facets.slave
        others = np.zeros(len(self.near))
        for near, component in zip(self.candidates.points, self.candidates.component, strict=True):
            others[near] = np.maximum(others[near], motions[rule.body(component)])
        self.motion += motions[rule.body(slave.component[self.points.facet[self.near]])] + others

    def update(self, position: Array, limits: SearchLimits) -> tuple[Integers, Array, Projection, SharedPoints]:
        """Keep master facets as long as points project onto them, search for the others', and project all points.

        position (n, d): of the seen nodes. The projected ones among the near points (r,), their positions (r, d), their
        projections (r,) on the facet with the largest share, and those of them that several facets share.
        """
        facets, kind = self.facets, self.facets.kind
        own = self.points.facet[self.near]
        points = np.einsum("mk,mkd->md", self.points.shape[self.near], facets.slave_at(position, own))
        bound = np.full(len(self.near), limits.detection_range)  # what comes nearer than this is to be seen
        have = np.flatnonzero(self.facet >= 0)
        left = entering = np.zeros(0, np.int64)
        if len(have):
            projection = self._project(position, points[have], have)
            self.xi[have] = projection.xi
            # Outside a convex edge the nearest facet is one that the point is beyond already: it leaves from there.
            allowed = np.minimum(np.maximum(self.overshoot[have], 0.0) + PROJECTION_TOLERANCE, LARGEST_OVERSHOOT)
            beyond = kind.overshoot(projection.xi)
            leaves = beyond > allowed
            left = have[leaves]
            # A point that gets behind the end of its facet may be beside the body: the search knows.
            entering = have[self.apart[have] & (projection.gap < 0.0) & (beyond > -TIE) & ~leaves]
            # Something else may have come nearer than a closest point without contact.
            apart = projection.gap > limits.interaction_range
            bound[have] = np.where(apart, np.minimum(projection.gap, limits.detection_range), -np.inf)
        lost = ~(self.distance_bound > self.motion + bound) & limits.everywhere  # true for what is not a number
        lost[left] = lost[entering] = True
        if lost.any():
            facet, xi, overshoot = (kept[entering] for kept in (self.facet, self.xi, self.overshoot))
            self._search(points, position, lost, limits)
            # One that meets the body keeps its facet. At the neighbouring one the end of a solve would be another.
            component, found = facets.master.component, self.facet[entering]
            meets = (found >= 0) & (component[found] == component[facet])
            stay = entering[meets]
            self.facet[stay], self.xi[stay], self.overshoot[stay] = facet[meets], xi[meets], overshoot[meets]
        projected = np.flatnonzero(self.facet >= 0)
        points = points[projected]
        if lost.any() or not len(have):
            projection = self._project(position, points, projected)
            self.xi[projected] = projection.xi
        shared = self._share(position, points, projected, projection, limits.detection_range)
        self.apart[projected] = projection.gap >= 0.0
        return projected, points, projection, shared

    def _share(
        self, position: Array, points: Array, projected: Integers, projection: Projection, within: float
    ) -> SharedPoints:
        """Points with a gap below `within` (um) that several facets share. Each takes the facet with the largest share.

        Of that facet are facet, xi and projection then, but the gap is the mean one.
        """
        near = np.flatnonzero((projection.gap <= within) & self._shared[self.points.facet[self.near[projected]]])
        slave, facet = self.points.facet[self.near[projected[near]]], self.facet[projected[near]]
        every = SharedPoints.of(self.facets, position, points[near], slave, facet, self._blending)
        rows, largest = near[every.row], every.largest()
        for name in projection.__dataclass_fields__:
            getattr(projection, name)[rows] = getattr(every.projection, name)[largest]
        point = projected[rows]
        self.overshoot[point[self.facet[point] != every.facet[largest]]] = 0.0
        self.facet[point], self.xi[point] = every.facet[largest], projection.xi[rows]
        several = every.of_several()
        shared = replace(several, row=near[several.row])
        projection.gap[shared.row] = mean_values(shared.point, shared.share.value, shared.projection.gap)
        return shared

    def _project(self, position: Array, points: Array, some: Integers) -> Projection:
        """Projections of some near points, at `points` (r, d), onto their master facets, from where they were."""
        facet = self.facet[some]
        nodes, orientation = self.facets.master_at(position, facet), self.facets.master.orientation[facet]
        return project(self.facets.kind, points, nodes, orientation, self.xi[some])

    def _search(self, points: Array, position: Array, lost: Booleans, limits: SearchLimits) -> None:
        """Find new master facets for the `lost` ones of the near points."""
        facets, kind = self.facets, self.facets.kind
        own = self.points.facet[self.near[lost]]
        normals, middles = np.zeros((2, *points.shape))
        slave_nodes, xi = facets.slave_at(position, own), self.points.xi[self.near[lost]]
        normals[lost] = point_normals(kind, xi, slave_nodes, facets.slave.orientation[own])
        middles[lost] = np.einsum("k,mkd->md", kind.shape(kind.middle[None])[0], slave_nodes)
        self.facet[lost], self.distance_bound[lost] = -1, -np.inf
        least = np.full(len(self.near), np.inf)  # gap of the closest point
        away = np.full(len(self.near), np.inf)  # least distance of its component, plus motion
        clear = np.full(len(self.near), np.inf)  # and of all others
        candidates = zip(self.candidates.points, self.candidates.facets, self.self_candidates, strict=True)
        for near, targets, same_part in candidates:
            tried = near[lost[near]]
            if not len(tried):
                continue
            nodes, orientation = facets.master_at(position, targets), facets.master.orientation[targets]
            pairs, depth = None, max(self._depth, limits.depth)
            if same_part is not None:
                depth = max(self._self_depth, limits.depth)
                pairs = same_part.of_points(self.points.facet[self.near[tried]])
            masters = Facets(kind, nodes, orientation, facets.master.key[targets])
            reach = max(limits.candidate_range, depth)
            given = points[tried], normals[tried], masters, reach, depth, pairs, middles[tried], limits.depth
            found, xi, off = closest_facets(*given)
            off += self.motion[tried] - limits.approach
            met = np.flatnonzero(found >= 0)
            gap = np.full(len(tried), np.inf)
            gap[met] = project(kind, points[tried[met]], nodes[found[met]], orientation[found[met]], xi[met]).gap
            # Of several bodies a point meets the one that it is deepest in, or nearest to.
            nearer = (gap < least[tried]) & (gap <= limits.candidate_range)
            clear[tried] = np.minimum(clear[tried], np.where(nearer, away[tried], off))
            tried, found, xi, gap = tried[nearer], found[nearer], xi[nearer], gap[nearer]
            least[tried], away[tried], self.facet[tried], self.xi[tried] = gap, off[nearer], targets[found], xi
            self.overshoot[tried] = np.where(gap > limits.interaction_range, kind.overshoot(xi), 0.0)
        self.distance_bound[lost] = clear[lost]
