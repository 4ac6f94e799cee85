"""All contact of a run as a term of its problem: residual, tangent, energies, and its history from step to step."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.contact.contact_points import Snapshot
from piezomat.contact.detection import Detection
from piezomat.contact.nodal_state import NodalState
from piezomat.contact.pairs import Pairs
from piezomat.contact.penetrating_places import PenetratingPlaces
from piezomat.contact.plate_capacitor import PlateCapacitor
from piezomat.contact.rigid_plane import RigidPlane
from piezomat.contact.surface_pair import SurfacePair
from piezomat.contact.terms import ContactTerms
from piezomat.discretization.evaluation_mode import COMPLETE, EvaluationMode
from piezomat.discretization.state import ReadPoints, SavedHistory
from piezomat.discretization.term import BlockTerm
from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.laws.response import ENERGIES
from piezomat.meshes import parallel

log = logging.getLogger("piezomat")


@dataclass(frozen=True)
class ContactHistory:
    """The history of all contact points at the end of a converged step, and their deepest penetration, um."""

    snapshots: tuple[Snapshot, ...]
    last_penetration: float


class Interfaces(Detection, BlockTerm):
    """All contact of a run as a term of its problem. Every method is collective.

    pairs: numbers and names of the pairs
    state: nodal state of the last evaluation
    adhesive: whether there is adhesion
    augmented: whether the multipliers belong to the history
    evaluation_failed: whether facets had collapsed at the last evaluation, on any rank
    viscous_regularization: whether bonds resist their opening
    """

    phase = "contact"

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
        """See `Detection`. augmented: whether there are multipliers."""
        super().__init__(comm, space, coordinates, surface_pairs, planes, len(pairs.bodies), geodesic, plates)
        self.pairs = pairs
        self.augmented = augmented
        self.potential_scale = potential_scale
        self.adhesive = any(p.law.softens for p in self.surface_pairs)
        penalties = (float(np.max(law.penalties[0], initial=0.0)) for p in self.point_sets for law in p.possible_laws)
        self.largest_penalty = comm.allreduce(max(penalties), op=MPI.MAX)
        self.evaluation_failed = False
        self.viscous_regularization = False
        self._none = {t: ContactTerms.none(self.nodes_per_pair, self.block_size, tangent=t) for t in (False, True)}
        self._linearized = self._none[True]
        self._plane_terms: list[ContactTerms] = []
        self._places_inside: tuple[NodalState, list[PenetratingPlaces]] | None = None

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
            terms += [p.evaluate(at, self.nodes_per_pair, tangent=tangent) for p in self.plates]
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

    def add_residual(self, x: PETSc.Vec, result: PETSc.Vec, mode: EvaluationMode = COMPLETE) -> None:
        """See `BlockTerm.add_residual`."""
        terms = self.evaluate(x, mode, tangent=False)
        self.nodes.add(terms.nodes, terms.vectors, result)
        if self.evaluation_failed:
            result.set(np.nan)

    def linearize(self, x: PETSc.Vec, mode: EvaluationMode = COMPLETE) -> None:
        """See `BlockTerm.linearize`."""
        self._linearized = self.evaluate(x, mode, tangent=True)

    def blocks(self) -> tuple[Integers, Array]:
        """See `BlockTerm.blocks`: those of pairs of facets."""
        return self.nodes.number[self._linearized.nodes], self._linearized.matrices

    def reserve(self) -> Integers:
        """See `BlockTerm.reserve`."""
        return self.candidate_nodes()

    def add_linearized_residual(self, result: PETSc.Vec) -> None:
        """See `BlockTerm.add_linearized_residual`."""
        self.nodes.add(self._linearized.nodes, self._linearized.vectors, result)

    def add_product(self, change: PETSc.Vec, result: PETSc.Vec) -> None:
        """See `BlockTerm.add_product`."""
        nodes, matrices = self._linearized.nodes, self._linearized.matrices
        local = self.nodes.gather(change)[nodes]
        product = np.einsum("mij,mj->mi", matrices, local.reshape(matrices.shape[:2]))
        self.nodes.add(nodes, product.reshape(local.shape), result)

    def add_external_forces(self, result: PETSc.Vec) -> None:
        """See `Term.add_external_forces`: those of rigid planes."""
        for terms in self._plane_terms:
            self.nodes.add(terms.nodes, terms.vectors, result)

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
        for p in self.segmented_pairs:
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

    def penetrating_places(self) -> list[PenetratingPlaces]:
        """Nodes and edges of this rank's slave facets inside other bodies at the last evaluation. Collective.

        In one pass also the nodes of the masters.
        """
        if self._places_inside is None or self._places_inside[0] is not self.state:
            given = self.pairs, self.state.position, 2.0 * self.last_penetration
            found = [PenetratingPlaces.of(p, *given) for p in self.surface_pairs]
            given = self.pairs, self.state.position, self.mean_facet_size
            alone = [p for p in self.surface_pairs if p.share == 1.0]
            found += [PenetratingPlaces.of_master(self.comm, p, *given) for p in alone]
            self._places_inside = self.state, found
        return self._places_inside[1]

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
