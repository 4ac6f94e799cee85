"""Detection: which facets each rank sees, what of all surface pairs and planes is near, and how long that holds."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.contact.contact_points import ContactPoints
from piezomat.contact.gap_exchange import AHEAD
from piezomat.contact.plate_capacitor import PlateCapacitor
from piezomat.contact.rigid_plane import RigidPlane
from piezomat.contact.search import ContactSearch
from piezomat.contact.seen_nodes import SeenNodes
from piezomat.contact.segmented_pair import SegmentedPair
from piezomat.contact.surface_pair import SurfacePair
from piezomat.forms.arrays import Array, Integers
from piezomat.meshes import parallel
from piezomat.meshes.contact.global_search import share_facets


class Detection:
    """All surface pairs and rigid planes of a run on this rank. Every method is collective.

    surface_pairs, planes: the contact points of each, and `point_sets` those of both
    plates: the capacitors that planes are with each other
    nodes_per_pair: number of nodes of a pair of facets
    nodes: the nodes that this rank sees, after a detection
    interaction_range: largest gap at which the points of surface pairs have a traction or a charge, um
    last_penetration: deepest penetration at the end of the last converged step, um
    """

    def __init__(
        self,
        comm: MPI.Comm,
        space: Any,
        coordinates: PETSc.Vec,
        surface_pairs: Sequence[SurfacePair],
        planes: Sequence[RigidPlane],
        bodies: int,
        geodesic: PETSc.Vec | None = None,
        plates: Sequence[PlateCapacitor] = (),
    ) -> None:
        """Contact in a function space whose nodes have these undeformed `coordinates`, a vector like the state.

        geodesic: with self-contact, the nodes' geodesic distances over the neighbourhood, the first components of a
        vector like the state.
        """
        self.comm = comm
        self.surface_pairs = list(surface_pairs)
        self.planes = list(planes)
        self.plates = list(plates)
        self.point_sets: list[ContactPoints] = [*self.surface_pairs, *self.planes]
        self.space = space  # its mesh owns the communicator
        self.dim: int = space.mesh.geometry.dim
        self.block_size: int = space.dofmap.index_map_bs
        self.nodes_per_pair: int = 2 * self.point_sets[0].slave.nodes.shape[1]
        self.segmented_pairs = [p for p in self.surface_pairs if isinstance(p, SegmentedPair)]
        # Planes know all their points: their closest points are not searched for.
        ranges = (law.interaction_range for p in self.surface_pairs for law in p.possible_laws)
        self.interaction_range = comm.allreduce(max(ranges, default=0.0), op=MPI.MAX)
        sizes = [np.log(p.facet_size) for p in self.point_sets]
        total = parallel.total(comm, np.array([sum(s.sum() for s in sizes), sum(len(s) for s in sizes)]))
        mean_size = float(np.exp(total[0] / total[1]))
        self._search = ContactSearch(comm, self.surface_pairs, max(bodies, 2), self.interaction_range, mean_size)
        self._coordinates, self._geodesic = coordinates, geodesic
        # This rank's own slave and master facets; the ghost facets that it sees change with every detection.
        self._own_nodes = self._seen([facets.nodes for p in self.surface_pairs for facets in (p.slave, p.master)])
        self.last_penetration = 0.0

    def detect(self, state: PETSc.Vec, search_radius: float) -> None:
        """Global search at a state: which facets each rank must see and which points are near others.

        search_radius: largest distance (um) of what is found; the detection is valid until a node has moved by more
        than half of it.
        """
        own, d = self._own_nodes, self.dim
        position = own.reference + own.gather(state)[:, :d]
        masters = []
        for p in self.surface_pairs:
            slave, master = (position[own.places(facets.nodes)] for facets in (p.slave, p.master))
            margin = max(search_radius, p.search_range)
            masters.append(share_facets(self.comm, slave, p.slave.component, p.master, master, margin, p.rule))
        needed = [
            facets.nodes for p, seen in zip(self.surface_pairs, masters, strict=True) for facets in (p.slave, seen)
        ]
        needed += [p.slave.nodes for p in self.planes[:1]]  # all planes meet the same surface
        needed += [np.array(p.reference_nodes, np.int64) for p in self.planes]
        self.nodes = self._seen(needed)
        geodesic = self.nodes.gather(self._geodesic)[:, 0] if self._geodesic is not None else None
        displacement = self.nodes.gather(state)[:, :d]
        position = self.nodes.reference + displacement
        # Facets that come nearer than this in a step are cut when it has ended.
        cut_distance = self.interaction_range + 0.5 * self._search.mean_facet_size + 4.0 * self.last_penetration
        for p, seen in zip(self.surface_pairs, masters, strict=True):
            given = search_radius, cut_distance, self._accepted_penetration
            p.detect(seen, self.nodes, position, geodesic, *given)
        for plane in self.planes:
            plane.detect(self.nodes, position, max(search_radius, AHEAD * plane.law.interaction_range))
        self._search.restart(displacement, search_radius)
        self._partners_at = position

    def renew_partners(self, state: PETSc.Vec) -> bool:
        """Find anew what faces what across open gaps, at a state within the search radius; False: it is as it was."""
        pairs = [p for p in self.surface_pairs if p.exchange is not None]
        if not pairs:
            return False
        position = self.nodes.reference + self.nodes.gather(state)[:, : self.dim]
        moved = parallel.largest(self.comm, np.abs(position - self._partners_at).max(initial=0.0)[None])[0]
        if moved == 0.0:
            return False
        self._partners_at = position
        for p in pairs:
            p.exchange.detect(p.facets, position, self._accepted_penetration)
        return True

    @property
    def _accepted_penetration(self) -> float:
        """Depth up to which points of closed gaps have partners, um: on the way to equilibrium they may be deeper."""
        return max(2.0 * self.last_penetration, 0.5 * self.mean_facet_size)

    @property
    def detected_positions(self) -> Array:
        """Positions (n, d) of the seen nodes at the last detection, um."""
        return self.nodes.reference + self._search.detected_at

    @property
    def mean_facet_size(self) -> float:
        """Geometric mean of the sizes of all facets, um."""
        return self._search.mean_facet_size

    def _seen(self, facets: Iterable[Integers]) -> SeenNodes:
        return SeenNodes(self._coordinates, self.block_size, self.dim, facets)

    @property
    def search_radius_exceeded(self) -> bool:
        """Whether the last evaluation was beyond the validity of the detection."""
        return self._search.radius_exceeded

    def least_search_radius(self) -> float:
        """Search radius if nothing moved (um): two facets, the interaction range and twice the present penetration.

        It is at least twice the distance that `set_candidate_distance` has set.
        """
        search = self._search
        least = 2.0 * search.mean_facet_size + self.interaction_range + 4.0 * self.last_penetration
        return max(least, 2.0 * search.candidate_distance)

    def set_candidate_distance(self, distance: float) -> None:
        """Let `candidate_nodes` find what is as far as this from touching, um."""
        self._search.set_candidate_distance(distance)

    def has_stale_segments(self) -> bool:
        """Whether segments no longer begin and end at the edges of master facets, at the last evaluation."""
        if not self.segmented_pairs:
            return False
        before = self.detected_positions
        stale = any(p.has_stale_segments(before, self.interaction_range) for p in self.segmented_pairs)
        return self.comm.allreduce(stale, op=MPI.LOR)

    def candidate_nodes(self, distance: float = 0.0) -> Integers:
        """Global nodes (k, n) of the facet pairs in contact, or nearer to it than `distance` (um), when last evaluated.

        What is further off than half a facet and than `set_candidate_distance` says is not found.
        """
        pairs = [p.facet_pairs_within(self.interaction_range + distance) for p in self.surface_pairs]
        planes = [p.facet_pairs_within(max(distance, AHEAD * p.law.interaction_range)) for p in self.planes]
        plates = [p.nodes(self.nodes_per_pair) for p in self.plates]
        return self.nodes.number[np.concatenate([*pairs, *planes, *plates])]

    def new_vector(self) -> PETSc.Vec:
        """A vector like the state, with zeros."""
        vector = self._coordinates.duplicate()
        vector.set(0.0)
        return vector
