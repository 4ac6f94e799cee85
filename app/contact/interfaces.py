"""All contact of a run: detected across ranks, evaluated at a state, its history kept from step to step."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.contact.contact_points import ContactPoints, Snapshot
from piezomat.contact.gap_exchange import AHEAD
from piezomat.contact.nodal_state import COMPLETE, EvaluationMode, NodalState
from piezomat.contact.pairs import Pairs
from piezomat.contact.plate_capacitor import PlateCapacitor
from piezomat.contact.rigid_plane import RigidPlane
from piezomat.contact.search import ContactSearch
from piezomat.contact.seen_nodes import SeenNodes
from piezomat.contact.surface_pair import PenetratingNodes, SurfacePair
from piezomat.contact.terms import ContactTerms
from piezomat.discretization.state import ReadPoints, SavedHistory
from piezomat.discretization.term import Term
from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.laws.response import ENERGIES
from piezomat.meshes import parallel
from piezomat.meshes.contact.global_search import share_facets

log = logging.getLogger("piezomat")


@dataclass(frozen=True)
class ContactHistory:
    """The history of all contact points at the end of a converged step, and their deepest penetration, um."""

    snapshots: tuple[Snapshot, ...]
    last_penetration: float


class Interfaces(Term):
    """All surface pairs and rigid planes of a run on this rank. Every method is collective.

    surface_pairs, planes: the contact points of each, and `point_sets` those of both
    plates: the capacitors that planes are with each other
    pairs: numbers and names of the pairs
    nodes: the nodes that this rank sees, after a detection
    state: nodal state of the last evaluation
    adhesive: whether there is adhesion
    augmented: whether the multipliers belong to the history
    largest_penalty: MPa/um
    interaction_range: largest gap at which the points of surface pairs have a traction or a charge, um
    evaluation_failed: whether facets had collapsed at the last evaluation, on any rank
    viscous_regularization: whether bonds resist their opening
    last_penetration: deepest penetration at the end of the last converged step, um
    """

    def __init__(
        self,
        comm: MPI.Comm,
        space: Any,
        coordinates: PETSc.Vec,
        surface_pairs: Sequence[SurfacePair],
        planes: Sequence[RigidPlane],
        pairs: Pairs,
        potential_scale: float | None,
        geodesic: PETSc.Vec | None = None,
        plates: Sequence[PlateCapacitor] = (),
        *,
        augmented: bool = False,
    ) -> None:
        """Contact in a function space whose nodes have these undeformed `coordinates`, a vector like the state.

        geodesic: with self-contact, the nodes' geodesic distances over the neighbourhood, the first components of a
        vector like the state.
        """
        self.comm = comm
        self.pairs = pairs
        self.augmented = augmented
        self.surface_pairs = list(surface_pairs)
        self.planes = list(planes)
        self.plates = list(plates)
        self.point_sets: list[ContactPoints] = [*self.surface_pairs, *self.planes]
        self.space = space  # its mesh owns the communicator
        self.dim: int = space.mesh.geometry.dim
        self.block_size: int = space.dofmap.index_map_bs
        self.potential_scale = potential_scale
        self.has_segments = any(p.segments for p in self.surface_pairs)
        self.adhesive = any(p.law.softens for p in self.surface_pairs)
        penalties = (float(np.max(p.law.penalties[0], initial=0.0)) for p in self.point_sets)
        self.largest_penalty = comm.allreduce(max(penalties), op=MPI.MAX)
        # Planes know all their points: their closest points are not searched for.
        ranges = [p.law.interaction_range for p in self.surface_pairs]
        self.interaction_range = comm.allreduce(max(ranges, default=0.0), op=MPI.MAX)
        sizes = [np.log(p.facet_size) for p in self.point_sets]
        total = parallel.total(comm, np.array([sum(s.sum() for s in sizes), sum(len(s) for s in sizes)]))
        mean_size = float(np.exp(total[0] / total[1]))
        bodies = max(len(pairs.bodies), 2)
        self._search = ContactSearch(comm, self.surface_pairs, bodies, self.interaction_range, mean_size)
        self._coordinates, self._geodesic = coordinates, geodesic
        # This rank's own slave and master facets; the ghost facets that it sees change with every detection.
        self._own_nodes = self._seen([facets.nodes for p in self.surface_pairs for facets in (p.slave, p.master)])
        self.evaluation_failed = False
        self.viscous_regularization = False
        self.last_penetration = 0.0
        self._nodes_per_pair = 2 * self.point_sets[0].slave.nodes.shape[1]
        self._none = {t: ContactTerms.none(self._nodes_per_pair, self.block_size, tangent=t) for t in (False, True)}
        self._plane_terms: list[ContactTerms] = []
        self._nodes_inside: tuple[NodalState, list[PenetratingNodes]] | None = None

    # --- Search ---

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

    def renew_partners(self, state: PETSc.Vec) -> bool:
        """Find anew what faces what across open gaps, at a state within the search radius; False if nothing can."""
        position = self.nodes.reference + self.nodes.gather(state)[:, : self.dim]
        pairs = [p for p in self.surface_pairs if p.exchange is not None]
        for p in pairs:
            p.exchange.detect(p.facets, position, self._accepted_penetration)
        return len(pairs) > 0

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

    def set_iteration(self, iteration: int) -> None:
        """Set the projection tolerance of a solve's Newton iteration: it grows, against cycling between facets."""
        self._search.set_iteration(iteration)

    def tighten_projection_tolerance(self) -> bool:
        """Lower the projection tolerance to that of the end of a solve; whether it was larger."""
        return self._search.tighten()

    def has_stale_segments(self) -> bool:
        """Whether segments no longer begin and end at the edges of master facets, at the last evaluation."""
        if not self.has_segments:
            return False
        before = self.detected_positions
        stale = any(p.has_stale_segments(before, self.interaction_range) for p in self.surface_pairs)
        return self.comm.allreduce(stale, op=MPI.LOR)

    def candidate_nodes(self, distance: float = 0.0) -> Integers:
        """Global nodes (k, n) of the facet pairs in contact, or nearer to it than `distance` (um), when last evaluated.

        What is further off than half a facet and than `set_candidate_distance` says is not found.
        """
        pairs = [p.facet_pairs_within(self.interaction_range + distance) for p in self.surface_pairs]
        planes = [p.facet_pairs_within(max(distance, AHEAD * p.law.interaction_range)) for p in self.planes]
        plates = [p.nodes(self._nodes_per_pair) for p in self.plates]
        return self.nodes.number[np.concatenate([*pairs, *planes, *plates])]

    # --- Evaluation ---

    def evaluate(self, state: PETSc.Vec, mode: EvaluationMode = COMPLETE, *, tangent: bool) -> ContactTerms:
        """Contact's share of residual and tangent at a state.

        `search_radius_exceeded` and `evaluation_failed` say whether the terms can be used; they are none after a
        failure.
        """
        values = self.nodes.gather(state)
        limits = self._search.limits(values[:, : self.dim], search=mode.search, depth=2.0 * self.last_penetration)
        at = self.state = self.nodal_state(values, mode)
        position = at.position
        terms: list[ContactTerms] = []
        try:
            self._search.update(position, limits)
            terms = [p.evaluate(at, tangent=tangent) for p in self.point_sets]
            terms += [p.evaluate(at, self._nodes_per_pair, tangent=tangent) for p in self.plates]
            failed = False
        except (np.linalg.LinAlgError, ValueError) as error:
            log.debug("contact cannot be evaluated at this state: %s", error)
            failed = True
            self._search.discard_projections()
        # One rank's facets may have collapsed in a wild Newton step: all ranks give that state up.
        self.evaluation_failed = self.comm.allreduce(failed, op=MPI.LOR)
        if self.evaluation_failed:
            self._search.discard_search()
            terms = []
        self._plane_terms = terms[len(self.surface_pairs) :]
        return ContactTerms.joined([self._none[tangent], *terms])

    def nodal_state(self, values: Array, mode: EvaluationMode) -> NodalState:
        """The state at these unknowns (n, block) of the seen nodes, evaluated in this mode."""
        position = self.nodes.reference + values[:, : self.dim]
        potentials = values[:, self.dim] if self.potential_scale is not None else None
        mode = replace(mode, viscous=mode.viscous and self.viscous_regularization)
        return NodalState(position, potentials, self.block_size, self.potential_scale, mode)

    def predict(self, change: PETSc.Vec) -> Array:
        """Let contact respond from now on as after this change of the state of its last evaluation.

        Norms (2,) of the forces and charges that the last response, linearized, misses; not numbers where facets have
        collapsed, infinite where a change is wild.
        """
        nodal, sums = self.nodes.gather(change), np.zeros(2)
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                for p in self.point_sets:
                    sums += p.predict(self.state, nodal)
        except np.linalg.LinAlgError:
            sums[:] = np.nan
        return np.sqrt(parallel.total(self.comm, sums))

    def end_prediction(self) -> None:
        """Let contact respond at the states that are evaluated again."""
        for p in self.point_sets:
            p.end_prediction()

    def add_residual(self, terms: ContactTerms, residual: PETSc.Vec) -> None:
        """Add the terms' vectors to a distributed residual."""
        self.nodes.add(terms.nodes, terms.vectors, residual)

    def add_product(self, terms: ContactTerms, change: PETSc.Vec, result: PETSc.Vec) -> None:
        """Add the terms' matrices times a change of state to a distributed vector."""
        local = self.nodes.gather(change)[terms.nodes]
        product = np.einsum("mij,mj->mi", terms.matrices, local.reshape(terms.matrices.shape[:2]))
        self.nodes.add(terms.nodes, product.reshape(local.shape), result)

    def add_forces_of_planes(self, residual: PETSc.Vec) -> None:
        """Add the planes' share of the last evaluation to a distributed residual."""
        for terms in self._plane_terms:
            self.nodes.add(terms.nodes, terms.vectors, residual)

    def new_vector(self) -> PETSc.Vec:
        """A vector like the state, with zeros."""
        vector = self._coordinates.duplicate()
        vector.set(0.0)
        return vector

    def global_nodes(self, terms: ContactTerms) -> Integers:
        """Global node numbers (k, n) of each facet pair of the terms."""
        return self.nodes.number[terms.nodes]

    def set_loads(self, factors: dict[str, float]) -> None:
        """Move the planes to a load level."""
        for p in self.planes:
            p.move(factors)

    # --- History ---

    def commit(self) -> None:
        """Advance the history by the last evaluation, which is the end of a converged step or of a part of one."""
        self.last_penetration = self.penetration()
        for p in self.point_sets:
            p.commit()

    def history(self) -> ContactHistory:
        """The history at the end of the last converged step."""
        return ContactHistory(tuple(p.snapshot() for p in self.point_sets), self.last_penetration)

    def restore(self, history: ContactHistory) -> None:
        """Return to an earlier history; multipliers and points of a solve that failed are worth nothing."""
        self.last_penetration = history.last_penetration
        for p, snapshot in zip(self.point_sets, history.snapshots, strict=True):
            p.restore(snapshot)

    def saved(self) -> SavedHistory:
        """The history for a checkpoint."""
        each = [p.saved(augmented=self.augmented) for p in self.point_sets]
        points = {}
        for name in dict.fromkeys(name for found in each for name in found):
            keys, values = zip(*(found[name] for found in each if name in found), strict=True)
            points[name] = np.concatenate(keys), np.concatenate(values)
        return SavedHistory(points, {"penetration": self.last_penetration, "places": float(self._points_per_facet())})

    def resume(self, read: ReadPoints, scalars: Mapping[str, float]) -> None:
        """Take up the history that a checkpoint holds, whatever ranks wrote it."""
        self.last_penetration = scalars["penetration"]
        for p in self.surface_pairs:
            p.resume_points(read, int(scalars["places"]))
        for p in self.point_sets:
            p.resume(read, augmented=self.augmented)

    def _points_per_facet(self) -> int:
        """Largest number of points of a facet of the surface pairs."""
        most = max((int(p.points.place.max(initial=-1)) for p in self.surface_pairs), default=-1)
        return self.comm.allreduce(most + 1, op=MPI.MAX)

    def start_viscous_regularization(self, share: float) -> None:
        """Resist the opening of bonds from the last evaluation on, with `share` times their steepest softening.

        With a share of 1 no point of the interface softens, and a part of a step has one solution.
        """
        self.viscous_regularization = True
        for p in self.point_sets:
            p.start_viscous_regularization(share)

    def end_viscous_regularization(self) -> None:
        """Open bonds without viscous resistance."""
        self.viscous_regularization = False
        for p in self.point_sets:
            p.end_viscous_regularization()

    # --- Reports ---

    def touching_bodies(self) -> set[int]:
        """Numbers of the bodies in contact with others or with planes at the last evaluation."""
        found = set().union(*(p.touching_bodies(self.pairs) for p in self.point_sets))
        return set().union(*self.comm.allgather(found))

    def penetration(self) -> float:
        """Deepest penetration of the last evaluation, um."""
        return self._deepest(-p.projection.gap for p in self.point_sets if p.projection is not None)

    def penetrating_nodes(self) -> list[PenetratingNodes]:
        """Nodes of this rank's slave facets that lie inside other bodies at the last evaluation. Not collective."""
        if self._nodes_inside is None or self._nodes_inside[0] is not self.state:
            given = self.pairs, self.state.position, 2.0 * self.last_penetration
            found = [p.penetrating_nodes(*given) for p in self.surface_pairs]
            self._nodes_inside = self.state, found
        return self._nodes_inside[1]

    def penetration_in_facets(self) -> float:
        """Deepest penetration of the last evaluation in sizes of the facets that it is found on."""
        every = (p for p in self.point_sets if p.projection is not None)
        return self._deepest(-p.projection.gap / p.facet_size[p.projected_points] for p in every)

    def _deepest(self, depths: Iterable[Array]) -> float:
        return self.comm.allreduce(max((float(d.max(initial=0.0)) for d in depths), default=0.0), op=MPI.MAX)

    def energies(self, x: PETSc.Vec | None = None) -> dict[str, float]:
        """The `ENERGIES` of the last evaluation, pJ (2D: per um of depth)."""
        every = (*self.point_sets, *self.plates)
        total = parallel.total(self.comm, sum((p.energies() for p in every), np.zeros(len(ENERGIES))))
        return dict(zip(ENERGIES, total.tolist(), strict=True))
