"""The contact pairs of a run: paired across ranks, evaluated at a state, remembered from step to step."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from piezomat.contact.nodal_state import NodalState
from piezomat.contact.rigid_plane import RigidPlane
from piezomat.contact.search import KEEP, KEPT, Search, update_projections
from piezomat.contact.surface_pair import LARGEST_SHAPE, Pairs, SurfacePair
from piezomat.contact.terms import ContactTerms, no_terms, plane_terms, surface_terms
from piezomat.forms.arrays import Array
from piezomat.forms.contact.augmentation import corner_kind
from piezomat.forms.contact.laws.viscous import ViscousBonds
from piezomat.meshes import parallel
from piezomat.meshes.contact.global_search import CandidatePairs, share_facets
from piezomat.meshes.contact.local_search import near_points
from piezomat.meshes.contact.overlap import deepest_overlap
from piezomat.meshes.ghost_scatter import GhostScatter

log = logging.getLogger("piezomat")

# Points that meet nothing are looked at again once a surface has moved by this share of a facet since the last time.
DRIFT = 0.05
NEAR = 0.5  # facets: points nearer to touch than this may soon do so
# Relative residual below which the tangent is exact. Further from equilibrium tractions and potential jumps are wrong
# by much more than they are worth: that tractions turn with their facets, and that the electric contact pulls the
# harder, the nearer surfaces come, would make the tangent indefinite for nothing.
EXACT = 1e-2
# The same where bodies are loose: on some of them nothing but that pull acts, whose forces are a small part of all.
EXACT_LOOSE = 1e-3


class Interfaces:
    """All contact passes of a run on this rank. Every method is collective."""

    def __init__(
        self,
        comm: MPI.Comm,
        space: Any,
        coordinates: PETSc.Vec,
        passes: Sequence[SurfacePair],
        planes: Sequence[RigidPlane],
        pairs: Pairs,
        potential_scale: float | None,
        geodesic: PETSc.Vec | None = None,
    ) -> None:
        """`geodesic`: with self-contact, the nodes' geodesic distances over the neighbourhood, first components."""
        self.comm = comm
        self.pairs = pairs
        self.surface_pairs = list(passes)
        self.planes = list(planes)
        self.point_sets: list[SurfacePair | RigidPlane] = [*passes, *planes]
        self.space = space
        self.dim = space.mesh.geometry.dim
        self.block_size = space.dofmap.index_map_bs
        self.potential_scale = potential_scale
        self.has_segments = any(p.segments for p in self.surface_pairs)
        self.adhesive = any(p.law.adhesion is not None for p in self.surface_pairs)
        self.largest_penalty = comm.allreduce(
            max(float(p.law.penalty.max(initial=0.0)) for p in self.point_sets), op=MPI.MAX
        )
        self.interaction_range = comm.allreduce(max(p.law.interaction_range for p in self.point_sets), op=MPI.MAX)
        sizes = [np.log(p.facet_size) for p in self.point_sets]
        total = parallel.total(comm, np.array([sum(s.sum() for s in sizes), sum(len(s) for s in sizes)]))
        self._mean_facet_size = float(np.exp(total[0] / total[1]))  # geometric mean of the facets' sizes, um
        self._coordinates, self._geodesic = coordinates, geodesic
        # What this rank's slave and master facets are made of; what it sees besides changes with every pairing.
        self._surfaces = self._seen([facets.nodes for p in self.surface_pairs for facets in (p.slave, p.master)])
        self.search_radius = 0.0  # of the last pairing, um
        # Largest distance (um) of the surfaces whose nodes `candidate_nodes` finds; a condensation sets it.
        self.candidate_distance = 0.0
        # Whether, at the last evaluation, a node had moved by more than half of `search_radius` since the detection.
        self.search_radius_exceeded = False
        self.evaluation_failed = False  # whether the last evaluation has failed
        self.attraction = True  # whether the electric contact pulls on the surfaces; see `InterfaceLaw.respond`
        self.viscous_regularization = False  # whether bonds resist their opening
        self.last_penetration = 0.0  # at the end of the last converged step, um
        self._projection_tolerance = KEEP[0][1]
        self._consistent_tangent = True
        self._of_planes: list[ContactTerms] = [no_terms(p, self.block_size, tangent=False) for p in self.planes]

    def detect(self, state: PETSc.Vec, margin: float) -> None:
        """Find anew, at this state, which facets each rank must see and which points are near.

        `margin` (um): how near a point must be to be looked at; the pairing holds as long as no surface has moved by
        more than half of it.
        """
        self.search_radius = margin
        nodes, exchange, reference = self._surfaces
        position = reference + exchange.gather(state).reshape(-1, self.block_size)[:, : self.dim]
        needed = []
        for p in self.surface_pairs:
            slave, master = (position[np.searchsorted(nodes, facets.nodes)] for facets in (p.slave, p.master))
            p.ghost_facets = share_facets(self.comm, slave, p.slave.component, p.master, master, margin, p.rule)
            needed += [p.slave.nodes, p.ghost_facets.nodes]
        # All planes meet the same surface.
        needed += [p.slave.nodes for p in self.planes[:1]]
        self.nodes, self._exchange, self._reference = self._seen(needed)
        geodesic = self.gather(self._geodesic)[:, 0] if self._geodesic is not None else None
        values = self.gather(state)
        self._paired_at = self._searched_at = values[:, : self.dim].copy()
        self._searched, self._partners_at = False, None
        position = self._reference + values[:, : self.dim]
        for p in self.surface_pairs:
            p.slave_nodes = np.searchsorted(self.nodes, p.slave.nodes)
            p.master_nodes = np.searchsorted(self.nodes, p.ghost_facets.nodes)
            p.self_contact = p.reference_self_contact(self._reference, geodesic) if geodesic is not None else None
            if p.segments:
                # Facets that come nearer than this in a step are cut when it has ended.
                p.cut_segments(
                    position, self.interaction_range + 0.5 * self._mean_facet_size + 4.0 * self.last_penetration
                )
            self._detect_near_points(p, position, margin)
            p.master_facet = np.full(len(p.near_points), -1)
            p.master_xi = np.zeros((len(p.near_points), p.slave.kind.dim))
            p.initial_overshoot = np.zeros(len(p.near_points))
            p.distance_bound, p.motion_since_search = np.zeros((2, len(p.near_points)))
        for p in self.planes:
            p.slave_nodes = np.searchsorted(self.nodes, p.slave.nodes)
            p.detect(position, margin)
        self.search_radius_exceeded = False
        self._projection_tolerance, self._consistent_tangent = KEEP[0][1], True

    def _seen(self, numbers: list[NDArray[np.int64]]) -> tuple[NDArray[np.int64], GhostScatter, Array]:
        """Nodes with these global numbers: each once, the exchange of their unknowns, where they are at first."""
        nodes = np.unique(np.concatenate([np.zeros(0, np.int64), *map(np.ravel, numbers)]))
        wanted = PETSc.IS().createBlock(self.block_size, nodes.astype(PETSc.IntType), comm=MPI.COMM_SELF)
        exchange = GhostScatter(self._coordinates, wanted)
        return nodes, exchange, exchange.gather(self._coordinates).reshape(-1, self.block_size)[:, : self.dim]

    def _detect_near_points(self, p: SurfacePair, position: Array, margin: float) -> None:
        """Find the points near facets that they may meet, and which components each of them is near."""
        points = np.einsum("mk,mkd->md", p.points.shape, p.slave_at(position, p.points.facet))
        facets = p.master_at(position)
        boxed = CandidatePairs.near(
            points, p.slave.component[p.points.facet], facets, p.ghost_facets.component, margin, p.rule
        )
        near, p.self_candidates = [], []
        for rows, targets, same_part in zip(boxed.points, boxed.facets, boxed.same_part, strict=True):
            rows = rows[p.covered[rows]]
            slaves = p.points.facet[rows]
            p.self_candidates.append(
                p.near_self_candidates(position, np.unique(slaves), targets, margin) if same_part else None
            )
            close = (
                p.self_candidates[-1].count(slaves) > 0
                if same_part
                else near_points(points[rows], facets[targets], margin)
            )
            near.append(rows[close])
        p.near_points = np.unique(np.concatenate([np.zeros(0, np.int64), *near]))
        p.candidate_pairs = CandidatePairs(
            boxed.component, boxed.same_part, boxed.facets, [np.searchsorted(p.near_points, rows) for rows in near]
        )

    def set_tolerance_and_tangent(self, iteration: int, residual: float, *, loose: bool) -> None:
        """Prepare the tangent of a Newton iteration that starts at this relative residual.

        loose: whether nothing but contact and weak springs holds some of the bodies. Points keep their facets the
        longer, the more iterations a solve has taken.
        """
        self._projection_tolerance = max(share for start, share in KEEP if iteration >= start)
        self._consistent_tangent = residual < (EXACT_LOOSE if loose else EXACT)

    def tighten_projection_tolerance(self) -> bool:
        """Let points keep their facets no longer than is right at the end of a solve; whether they had been let."""
        longer, self._projection_tolerance = self._projection_tolerance > KEPT, min(self._projection_tolerance, KEPT)
        self._partners_at = None
        return longer

    def evaluate(self, state: PETSc.Vec, *, tangent: bool, search: bool = True) -> ContactTerms:
        """Contact's share of residual and tangent at a state; sets `outgrown` when the pairing holds no longer.

        Without `search` points that met nothing at the last evaluation meet nothing.
        """
        values = self.gather(state)
        position = self._reference + values[:, : self.dim]
        displacement = values[:, : self.dim]
        motions = [np.abs(displacement - since).max(initial=0.0) for since in (self._paired_at, self._searched_at)]
        moved, drift = parallel.largest(self.comm, np.array(motions))
        self.search_radius_exceeded = moved > 0.5 * self.search_radius
        everywhere = search and (not self._searched or drift > DRIFT * self._mean_facet_size)
        if everywhere:
            self._add_motion(displacement - self._searched_at)
            self._searched, self._searched_at, drift = True, displacement.copy(), 0.0
        # What is further off than `reach` can do nothing before all is searched anew; solvers ask for what may soon
        # touch.
        nearer = 2.0 * np.sqrt(self.dim) * LARGEST_SHAPE[2]  # that two points can come if no component moves by more
        reach = self.interaction_range + nearer * DRIFT * self._mean_facet_size
        far = max(reach + NEAR * self._mean_facet_size, self.candidate_distance)
        look = Search(
            self._projection_tolerance,
            everywhere,
            reach,
            far,
            self.interaction_range,
            2.0 * self.last_penetration,
            nearer * drift,
        )
        # A tangent is mostly asked for where the residual was evaluated last: partners and projections are at hand.
        same = not everywhere and self._partners_at is not None and np.array_equal(position, self._partners_at)
        self._partners_at = position
        potentials = values[:, self.dim] if self.potential_scale is not None else None
        at = self.at = NodalState(
            position, potentials, self.block_size, self.potential_scale, self.attraction, self._consistent_tangent
        )
        try:
            if not same:
                for p in self.surface_pairs:
                    update_projections(p, position, look)
            of_passes = [
                surface_terms(p, at, tangent=tangent, viscous=self.viscous_regularization) for p in self.surface_pairs
            ]
            of_planes = [plane_terms(p, at, tangent=tangent) for p in self.planes]
            failed = False
        except (np.linalg.LinAlgError, ValueError) as error:
            log.debug("contact cannot be evaluated at this state: %s", error)
            failed, self._partners_at = True, None
        # One rank's facets may have collapsed in a wild Newton step: all ranks give that state up.
        self.evaluation_failed = self.comm.allreduce(failed, op=MPI.LOR)
        if self.evaluation_failed:
            self._searched = False
            of_passes, of_planes = (
                [no_terms(p, self.block_size, tangent=tangent) for p in passes]
                for passes in (self.surface_pairs, self.planes)
            )
        self._of_planes = of_planes
        terms = [*of_passes, *of_planes]
        size = 2 * self.point_sets[0].slave.nodes.shape[1]
        nodes = np.concatenate([t.nodes for t in terms]).reshape(-1, size)
        vectors = np.concatenate([t.vectors for t in terms])
        return ContactTerms(nodes, vectors, np.concatenate([t.matrices for t in terms]) if tangent else None)

    def _add_motion(self, change: Array) -> None:
        """Note by how much things may have come nearer to each other, nodes having moved by `change` (n, d)."""
        bodies = max(len(self.pairs.bodies), 2)
        motions = parallel.largest(self.comm, np.array([p.largest_motions(change, bodies) for p in self.surface_pairs]))
        for p, moved in zip(self.surface_pairs, motions, strict=True):
            p.add_motion(moved)

    def has_stale_segments(self) -> bool:
        """Whether segments no longer begin and end where master facets do, at the last evaluation."""
        if not self.has_segments:
            return False
        before = self._reference + self._paired_at
        slid = any(p.segments and p.has_slid(before, self.interaction_range) for p in self.surface_pairs)
        return self.comm.allreduce(slid, op=MPI.LOR)

    def add_residual(self, terms: ContactTerms, residual: PETSc.Vec) -> None:
        """Add the terms' vectors to a distributed residual."""
        self._add(terms.nodes, terms.vectors, residual)

    def add_product(self, terms: ContactTerms, change: PETSc.Vec, result: PETSc.Vec) -> None:
        """Add the terms' matrices times a change of state to a distributed vector."""
        local = self.gather(change)[terms.nodes]
        product = np.einsum("mij,mj->mi", terms.matrices, local.reshape(terms.matrices.shape[:2]))
        self._add(terms.nodes, product.reshape(local.shape), result)

    def global_nodes(self, terms: ContactTerms) -> NDArray[np.int64]:
        """Global node numbers of each facet pair of the terms."""
        return self.nodes[terms.nodes]

    def candidate_nodes(self, ahead: float = 0.0) -> NDArray[np.int64]:
        """Global nodes of the facet pairs in contact, or nearer to it than `ahead` (um), at the last evaluation.

        Further than `candidate_distance` or half a facet nothing is seen.
        """
        sets = []
        for p in self.surface_pairs:
            near = p.projection.gap < self.interaction_range + ahead + NEAR * p.facet_size[p.projected_points]
            facets, partners = p.points.facet[p.near_points[p.projected[near]]], p.master_facet[p.projected[near]]
            pairs = np.unique(np.stack([facets, partners], axis=1), axis=0)
            sets.append(np.concatenate([p.slave_nodes[pairs[:, 0]], p.master_nodes[pairs[:, 1]]], axis=1))
        for p in self.planes:
            near = p.projection.gap < self.interaction_range + ahead + NEAR * p.facet_size[p.near_points]
            nodes = p.slave_nodes[np.unique(p.points.facet[p.near_points[near]])]
            sets.append(np.concatenate([nodes, nodes], axis=1))
        return self.nodes[np.concatenate(sets)]

    def described(self) -> str:
        """What may meet what, in words."""
        planes = f" and {len(self.planes)} planes" if self.planes else ""
        if self.pairs.listed or not self.surface_pairs:
            return f"{len(self.pairs.listed)} contact pairs{planes}"
        return f"contact between any of {len(self.pairs.bodies)} bodies{planes}"

    def move_planes(self, factors: dict[str, float]) -> None:
        """Bring the planes to a load level."""
        for p in self.planes:
            p.move(factors)

    def add_forces_of_planes(self, residual: PETSc.Vec) -> None:
        """Add the planes' share of the last evaluation to a distributed residual."""
        for terms in self._of_planes:
            self._add(terms.nodes, terms.vectors, residual)

    def start_viscous_regularization(self, share: float) -> None:
        """Let bonds resist their opening from the last evaluation on, `share` times as stiffly as they soften at most.

        With a share of 1 no point of the interface softens, and a part of a step has one solution.
        """
        self.viscous_regularization = True
        for p in self.point_sets:
            if p.law.adhesion is None:
                continue
            rows = p.projected_points
            live = p.law.bonded(p.history) | (p.law.adhesion.always & ~p.history.touched)
            p.viscous_bonds.start[rows] = p.projection.gap
            p.viscous_bonds.stiffness[:] = 0.0
            p.viscous_bonds.stiffness[rows] = (share * p.law.adhesion.steepness * live)[rows]

    def end_viscous_regularization(self) -> None:
        """End `hold_back`."""
        self.viscous_regularization = False
        for p in self.point_sets:
            p.viscous_bonds = ViscousBonds.none(len(p.points.weight))

    def commit(self) -> None:
        """Let the history take in the last evaluation, the end of a converged step or of a part of one."""
        self.last_penetration = self.penetration()
        for p in self.point_sets:
            near, gap = p.projected_points, p.gap
            advanced = p.history[near].advanced(gap, p.law[near].touching(gap))
            p.history = p.law.on_loss_of_contact(p.history)
            p.history.touched[near] = advanced.touched
            p.history.opening[near] = advanced.opening
            p.mark_converged()

    def corner_sums(self, p: SurfacePair | RigidPlane, rows: NDArray[np.int64], values: Array) -> Array:
        """Sums (f, k, ...) over all facets at the corners of this rank's: corner functions times values (m, ...)."""
        shape = corner_kind(p.slave.kind).shape(p.points.xi[rows])
        corners = p.slave_nodes[:, : shape.shape[1]]
        sums = np.zeros((*corners.shape, values.shape[1]))
        total = self._coordinates.duplicate()
        for column in range(values.shape[1]):
            total.set(0.0)
            each = np.zeros((*shape.shape, self.block_size))
            each[..., 0] = shape * values[:, column, None]
            self._add(corners[p.points.facet[rows]], each, total)
            sums[..., column] = self.gather(total)[corners, 0]
        return sums

    def restore_multipliers(self) -> None:
        """Forget the multipliers of a solve that failed."""
        for p in self.point_sets:
            p.restore_multipliers()

    def points_per_facet(self) -> int:
        """Largest number of points of a facet."""
        most = max((int(p.points.place.max(initial=-1)) for p in self.surface_pairs), default=-1)
        return self.comm.allreduce(most + 1, op=MPI.MAX)

    def least_search_radius(self) -> float:
        """How far to look if nothing moved (um): two facets, the law's reach and twice the present penetration.

        And twice as far as `ahead`, if a solver asks for all that may soon touch.
        """
        return max(
            2.0 * self._mean_facet_size + self.interaction_range + 4.0 * self.last_penetration,
            2.0 * self.candidate_distance,
        )

    def overlap(self) -> float:
        """How deep slave surfaces lie inside the master's bodies at the state of the last pairing, um."""
        position = self._reference + self._paired_at
        deepest = 0.0
        for p in self.surface_pairs:
            centers, facets = position[p.slave_nodes].mean(axis=1), p.master_at(position)
            for near, targets, same_part in zip(
                p.candidate_pairs.points, p.candidate_pairs.facets, p.candidate_pairs.same_part, strict=True
            ):
                if same_part:
                    continue  # a surface lies on its own body
                slaves = np.unique(p.points.facet[p.near_points[near]])
                depth = deepest_overlap(
                    p.slave.kind, centers[slaves], facets[targets], p.ghost_facets.orientation[targets]
                )
                deepest = max(deepest, depth)
        return self.comm.allreduce(deepest, op=MPI.MAX)

    def penetration(self) -> float:
        """Deepest penetration of the last evaluation, um."""
        return self._deepest(-p.projection.gap for p in self.point_sets if p.projection is not None)

    def penetration_in_facets(self) -> float:
        """Deepest penetration of the last evaluation in sizes of the facets that it is found on."""
        every = (p for p in self.point_sets if p.projection is not None)
        return self._deepest(-p.projection.gap / p.facet_size[p.projected_points] for p in every)

    def _deepest(self, depths: Iterable[Array]) -> float:
        return self.comm.allreduce(max((float(d.max(initial=0.0)) for d in depths), default=0.0), op=MPI.MAX)

    def energies(self) -> dict[str, float]:
        """Energies of the last evaluation (pJ; 2D: per um of depth): contact, adhesion, electric, dissipated.

        Points that are not near the other surface count too: they hold the adhesion of bonds that are not formed
        and what broken ones have dissipated.
        """
        sums = np.zeros(4)
        for p in self.point_sets:
            far = np.ones(len(p.points.weight), bool)
            far[p.projected_points] = False
            apart = np.full(int(far.sum()), 1e30)
            responses = [(p.response, p.projected_points)]
            if p.law.adhesion is not None:
                responses.append((p.law[far].respond(apart, None, p.history[far]), np.flatnonzero(far)))
            for r, rows in responses:
                weight = p.share * p.points.weight[rows]
                sums += [float(weight @ e) for e in (r.contact, r.adhesion, r.electric, r.dissipated)]
        total = parallel.total(self.comm, sums)
        return dict(zip(("contact", "adhesion", "electric", "dissipated"), total.tolist(), strict=True))

    def gather(self, vector: PETSc.Vec) -> Array:
        """Values (n, block_size) of a distributed vector at the nodes of all passes that this rank sees."""
        return self._exchange.gather(vector).reshape(-1, self.block_size)

    def _add(self, nodes: NDArray[np.int64], vectors: Array, result: PETSc.Vec) -> None:
        unknowns = nodes[..., None] * self.block_size + np.arange(self.block_size)
        size = len(self.nodes) * self.block_size
        self._exchange.add(np.bincount(unknowns.ravel(), vectors.ravel(), size), result)
