"""When the local search looks for new closest points, and when the global search must be repeated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI

from piezomat.contact.closest_points import SearchLimits
from piezomat.contact.detected_facets import LARGEST_SHAPE
from piezomat.contact.surface_pair import SurfacePair
from piezomat.forms.arrays import Array
from piezomat.meshes import parallel

# Points without a closest point are searched for again once a surface has moved by this share of a facet since.
DRIFT = 0.05
MARGIN = 0.5  # facet sizes: gap beyond the detection range up to which closest points are kept


class ContactSearch:
    """Local search of all surface pairs, between two detections.

    Invariant: at every evaluation that may search, each point within the interaction range of something that it may
    meet has a closest point. Points are searched for again only where their distance bounds, less the motions since,
    leave this open, and only once a node has moved by `DRIFT` of a facet.

    mean_facet_size: geometric mean of all facets, um
    interaction_range: largest gap with a traction or a charge, um
    candidate_distance: gap up to which a solver needs closest points, um
    radius: search radius of the last detection, um
    radius_exceeded: whether a node has moved by more than half of it since
    """

    def __init__(
        self, comm: MPI.Comm, pairs: Sequence[SurfacePair], bodies: int, interaction_range: float, facet_size: float
    ) -> None:
        self.comm = comm
        self.pairs = pairs
        self.mean_facet_size, self.interaction_range = facet_size, interaction_range
        self.candidate_distance = 0.0
        self.radius, self.radius_exceeded = 0.0, False
        self._bodies = bodies

    def set_candidate_distance(self, distance: float) -> None:
        """Let the local search find what a solver needs, up to this gap, um."""
        self.candidate_distance = distance

    def restart(self, displacement: Array, radius: float) -> None:
        """Begin after a detection with this search radius, the seen nodes displaced by (n, d)."""
        self.radius, self.radius_exceeded = radius, False
        self.detected_at = self._searched_at = displacement.copy()
        self._searched = False
        self._projected_at: Array | None = None

    def limits(self, displacement: Array, *, search: bool, depth: float) -> SearchLimits:
        """Limits of the next `update`, with the seen nodes displaced by (n, d). Collective.

        search: whether points without a closest point are searched for; depth: penetration that is accepted, um.
        """
        drift = self._moved(displacement)
        everywhere = search and self._due(drift)
        if everywhere:
            self._note_search(displacement)
            drift = 0.0
        # How near two points can come if no component of a node moves by more than 1.
        approach = 2.0 * np.sqrt(displacement.shape[1]) * LARGEST_SHAPE[2]
        # Beyond the detection range nothing acts before all points are searched for again.
        detection = self.interaction_range + approach * DRIFT * self.mean_facet_size
        candidates = max(detection + MARGIN * self.mean_facet_size, self.candidate_distance)
        return SearchLimits(
            everywhere,
            detection,
            candidates,
            self.interaction_range,
            depth,
            approach * drift,
        )

    def update(self, position: Array, limits: SearchLimits) -> None:
        """Find the closest points with the seen nodes at `position` (n, d).

        A tangent is mostly evaluated where the residual was evaluated last: closest points are then at hand.
        LinAlgError, ValueError: facets have collapsed.
        """
        same = self._projected_at is not None and np.array_equal(position, self._projected_at)
        self._projected_at = position
        if limits.everywhere or not same:
            for p in self.pairs:
                p.update_projections(position, limits)

    def discard_projections(self) -> None:
        """Project anew at the next update, even at the same state."""
        self._projected_at = None

    def discard_search(self) -> None:
        """Search everywhere at the next update that may."""
        self._searched = False

    def _moved(self, displacement: Array) -> float:
        """Largest component of a node's motion since the last search everywhere, um; notes that since detection."""
        motions = [np.abs(displacement - since).max(initial=0.0) for since in (self.detected_at, self._searched_at)]
        moved, drift = parallel.largest(self.comm, np.array(motions))
        self.radius_exceeded = bool(moved > 0.5 * self.radius)
        return float(drift)

    def _due(self, drift: float) -> bool:
        """Whether all points are to be searched for."""
        return not self._searched or drift > DRIFT * self.mean_facet_size

    def _note_search(self, displacement: Array) -> None:
        """Add the bodies' motions since the last search everywhere to their points', and start from here."""
        change = displacement - self._searched_at
        motions = [p.facets.largest_motions(change, self._bodies) for p in self.pairs]
        for p, moved in zip(self.pairs, parallel.largest(self.comm, np.array(motions)), strict=True):
            p.closest.add_motion(moved)
        self._searched, self._searched_at = True, displacement.copy()
