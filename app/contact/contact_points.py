"""What the points of a slave surface have in common, whether they meet other surfaces or a rigid plane."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np

from piezomat.contact.nodal_state import NodalState
from piezomat.contact.pairs import Pairs
from piezomat.contact.terms import ContactTerms
from piezomat.discretization.state import Points, ReadPoints
from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.forms.contact.augmentation import Multipliers, augmented_response
from piezomat.forms.contact.gap import Projection
from piezomat.forms.contact.integrals import SlavePoints
from piezomat.forms.contact.laws.interface import InterfaceLaw
from piezomat.forms.contact.laws.response import History, Response
from piezomat.forms.contact.laws.viscous import ViscousBonds
from piezomat.meshes.contact.load_balance import SlaveFacets

NEAR = 0.5  # facet sizes: points nearer to touch than this may soon do so
FAR_GAP = 1e30  # um; gap of a point without a closest point, for the energies of its law


@dataclass(frozen=True)
class Snapshot:
    """Points, history and multipliers at the end of a converged step; none of them is changed any more."""

    points: SlavePoints
    history: History
    multipliers: Multipliers


@dataclass(kw_only=True)
class ContactPoints(ABC):
    """Points of slave facets, with their law, history and last evaluation. No method is collective.

    m counts all points, r the projected ones, those with a closest point on the other side.

    Given:
    pair: number of the pair, see `Pairs`; planes are counted after the listed pairs
    slave: slave facets (f,) whose points this rank evaluates
    points (m,): the integration points
    law (m,): interface law
    facet_size (m,): size of each point's slave facet, um
    share: share of the contact enthalpy, 1/2 for each of two passes

    Kept from step to step:
    history (m,): state of the law at the end of the last converged step
    multipliers: shifts of gap and jump at the corners of the slave facets, by augmentation
    viscous_bonds (m,): viscous regularization; without stiffness where there is none

    Valid after a detection:
    slave_nodes (f, n): nodes of the slave facets, numbered as in `SeenNodes`
    near_points: points within the search radius of the other side

    Valid after an evaluation:
    projected_points (r,): the points with a closest point, by their number in `points`
    position (r, d): um
    projection (r,): gaps and normals, um; None before the first evaluation
    gap (r,): gap of the law, that of the projection and the multipliers' shift, um
    jump (r,): potential jump, V; None without electric contact
    response (r,): response of the law, at the predicted gaps and jumps if there is a prediction
    predicted (2, r): predicted changes of gap and jump, um and V; None without a prediction
    """

    pair: int
    slave: SlaveFacets
    points: SlavePoints
    law: InterfaceLaw
    facet_size: Array
    share: float = 1.0
    history: History = field(init=False)
    multipliers: Multipliers = field(init=False)
    viscous_bonds: ViscousBonds = field(init=False)
    slave_nodes: Integers = field(init=False)
    near_points: Integers = field(init=False)
    projected_points: Integers = field(init=False)
    position: Array = field(init=False)
    projection: Projection | None = field(init=False, default=None)
    gap: Array = field(init=False)
    jump: Array | None = field(init=False, default=None)
    response: Response | None = field(init=False, default=None)
    predicted: Array | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        self.history = History.virgin(len(self.points.weight))
        self.multipliers = Multipliers.none(self.slave.kind, len(self.slave))
        self.end_viscous_regularization()
        self._keep()

    @property
    @abstractmethod
    def side(self) -> int:
        """Number of the set of points among those of its pair, for `keys`."""

    @abstractmethod
    def evaluate(self, at: NodalState, *, tangent: bool) -> ContactTerms:
        """Terms of the points at a state. LinAlgError, ValueError: facets have collapsed."""

    @abstractmethod
    def first_changes(self, at: NodalState, change: Array) -> Array:
        """First-order changes (2, r), um and V, of gaps and jumps with those (n, block_size) of the unknowns."""

    @abstractmethod
    def facet_pairs_within(self, distance: float) -> Integers:
        """Nodes (k, 2 n) of the pairs of facets with a gap below `distance` (um) plus half a facet."""

    @abstractmethod
    def numbers_in_results(self, pairs: Pairs) -> Integers:
        """Number (r,) that the pair of each projected point has in the results."""

    @abstractmethod
    def touching_bodies(self, pairs: Pairs) -> set[int]:
        """Bodies in contact with others or with a plane."""

    # --- Response of the law ---

    def predict(self, at: NodalState, change: Array) -> Array:
        """Respond from now on as after this change (n, block_size) of the unknowns since the last evaluation.

        Sums (2,) over the points of the squared forces and charges that the last response, linearized, misses.
        LinAlgError: facets have collapsed.
        """
        last, before = self.response, self.predicted
        self.predicted = self.first_changes(at, change)
        slope, charge = last.linearized(self.predicted if before is None else self.predicted - before)
        rows = self.projected_points
        r = self._respond(at, self._shift(self.points.facet[rows], self.points.xi[rows]))
        weight = self.share * self.points.weight[rows]
        scale = 1.0 if at.scale is None else at.scale
        return np.array(
            [((weight * (r.slope - slope)) ** 2).sum(), ((scale * weight * (r.charge - charge)) ** 2).sum()]
        )

    def end_prediction(self) -> None:
        """Respond at the states that are evaluated again."""
        self.predicted = None

    def _shift(self, facet: Integers, xi: Array) -> tuple[Array, Array]:
        """The multipliers' shifts of gap and jump (r,) at points of slave facets."""
        return self.multipliers.at(self.slave.kind, facet, xi)

    def _respond(self, at: NodalState, shift: tuple[Array, Array]) -> Response:
        """Response at the gaps and jumps of the projection or at the predicted ones, with the multipliers' shifts."""
        rows, gap, jump = self.projected_points, self.projection.gap, self.jump
        if self.predicted is not None:
            gap, jump = gap + self.predicted[0], None if jump is None else jump + self.predicted[1]
        mode = {"attraction": at.mode.attraction, "consistent": at.mode.consistent}
        return augmented_response(self.law[rows], gap, jump, self.history[rows], shift, **mode)

    def _forces(self) -> tuple[Array, Array]:
        """Slope and charge (r,) at the present gaps: with a prediction, extrapolated backwards from its response."""
        if self.predicted is None:
            return self.response.slope, self.response.charge
        return self.response.linearized(-self.predicted)

    def _near_contact(self, distance: float) -> Booleans:
        """Whether the gap of points (r,) is below `distance` (um) plus half a facet."""
        return self.projection.gap < distance + NEAR * self.facet_size[self.projected_points]

    # --- History ---

    def commit(self) -> None:
        """Advance the history by the last evaluation, which is the end of a converged step or of a part of one."""
        near, gap = self.projected_points, self.gap
        advanced = self.history[near].advanced(gap, self.law[near].touching(gap))
        self.history = self.law.on_loss_of_contact(self.history)
        self.history.touched[near] = advanced.touched
        self.history.opening[near] = advanced.opening
        self._keep()

    def snapshot(self) -> Snapshot:
        """Points, history and multipliers of the last converged step."""
        return self._converged

    def restore(self, snapshot: Snapshot) -> None:
        """Return to a snapshot, as the end of the last converged step."""
        self._set_points(snapshot.points)
        self.history, self.multipliers = snapshot.history.copy(), snapshot.multipliers.copy()
        self._converged = snapshot

    def saved(self, *, augmented: bool) -> Points:
        """The history of the points for a checkpoint, and with augmentation the multipliers, by their keys."""
        known = self.history.touched
        points = {"opening": (self.keys()[known], self.history.opening[known][:, None])}
        if augmented:
            shifts = np.stack([self.multipliers.gap, self.multipliers.jump], axis=2)
            points["shift"] = self.corner_keys(), shifts.reshape(-1, 2)
        return points

    def resume(self, read: ReadPoints, *, augmented: bool) -> None:
        """Take up the history that a checkpoint holds. Collective."""
        values, found = read("opening", self.keys(), 1)
        self.history.touched[:] = found
        self.history.opening[:] = np.where(found, values[:, 0], 0.0)
        if augmented:
            values, _ = read("shift", self.corner_keys(), 2)
            self.multipliers.gap[:], self.multipliers.jump[:] = values.T.reshape(2, *self.multipliers.gap.shape)
        self._keep()

    def _keep(self) -> None:
        self._converged = Snapshot(self.points, self.history.copy(), self.multipliers.copy())

    def set_multipliers(self, multipliers: Multipliers) -> None:
        """Take up the multipliers of a step of augmentation."""
        self.multipliers = multipliers

    def _set_points(self, points: SlavePoints) -> None:
        self.points = points
        self.end_viscous_regularization()

    def start_viscous_regularization(self, share: float) -> None:
        """Resist the opening of bonds from the present gaps on, with `share` times their steepest softening."""
        if self.law.adhesion is None:
            return
        rows, adhesion = self.projected_points, self.law.adhesion
        live = self.law.bonded(self.history) | (adhesion.always & ~self.history.touched)
        self.viscous_bonds.start[rows] = self.projection.gap
        self.viscous_bonds.stiffness[:] = 0.0
        self.viscous_bonds.stiffness[rows] = (share * adhesion.steepness * live)[rows]

    def end_viscous_regularization(self) -> None:
        """Open bonds without viscous resistance."""
        self.viscous_bonds = ViscousBonds.none(len(self.points.weight))

    def energies(self) -> Array:
        """Contact, adhesion, electric and dissipated energy (4,) of the last evaluation, pJ (2D: per um of depth).

        Points that are not projected count too: they hold the adhesion of bonds that are not formed and what broken
        ones have dissipated.
        """
        sums = np.zeros(4)
        far = np.ones(len(self.points.weight), bool)
        far[self.projected_points] = False
        responses = [(self.response, self.projected_points)]
        if self.law.adhesion is not None:
            apart = np.full(int(far.sum()), FAR_GAP)
            responses.append((self.law[far].respond(apart, None, self.history[far]), np.flatnonzero(far)))
        for r, rows in responses:
            weight = self.share * self.points.weight[rows]
            sums += [float(weight @ e) for e in (r.contact, r.adhesion, r.electric, r.dissipated)]
        return sums

    # --- Numbers that do not depend on the partition ---

    def keys(self) -> Integers:
        """(m, 4) numbers of the points: pair, side, facet, place."""
        return self._keys(self.points.facet, self.points.place)

    def corner_keys(self) -> Integers:
        """(f * corners, 4) numbers of the corners of the slave facets."""
        return self._keys(*(index.ravel() for index in np.indices(self.multipliers.gap.shape)))

    def _keys(self, facet: Integers, place: Integers) -> Integers:
        same = np.ones(len(facet), np.int64)
        return np.stack([self.pair * same, self.side * same, self.slave.key[facet], place], axis=1)
