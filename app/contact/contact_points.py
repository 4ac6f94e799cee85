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
from piezomat.forms.contact.integrals import PointForces, SlavePoints
from piezomat.forms.contact.laws.law import ContactLaw
from piezomat.forms.contact.laws.response import ENERGIES, Response
from piezomat.forms.contact.laws.viscous import ViscousBonds
from piezomat.meshes.contact.load_balance import SlaveFacets

NEAR = 0.5  # facet sizes: points nearer to touch than this may soon do so
FAR_GAP = 1e30  # um; gap of a point without a closest point, for the energies of its law


@dataclass(frozen=True)
class Snapshot:
    """Points, history, multipliers and what points met at the end of a converged step; none is changed any more."""

    points: SlavePoints
    history: Array
    multipliers: Multipliers
    met: Integers


@dataclass(kw_only=True)
class ContactPoints(ABC):
    """Points of slave facets, with their law, history and last evaluation. No method is collective.

    m counts all points, r the projected ones, those with a closest point on the other side.

    Given:
    pair: number of the pair, see `Pairs`; planes are counted after the listed pairs
    slave: slave facets (f,) whose points this rank evaluates
    points (m,): the integration points
    law (m,): law of contact
    facet_size (m,): size of each point's slave facet, um
    share: share of the contact enthalpy, 1/2 for each of two passes

    Kept from step to step:
    history (m, h): of the law, at the end of the last converged step
    met (m,): kind of the body that each point had met last by then, on which the law depends; 0 of a plane
    multipliers: shifts of gap and jump at the corners of the slave facets, by augmentation
    viscous_bonds (m,): viscous regularization; without stiffness where there is none

    Valid after a detection:
    slave_nodes (f, n): nodes of the slave facets, numbered as in `SeenNodes`
    near_points: points within the search radius of the other side

    Valid after an evaluation:
    projected_points (r,): the points with a closest point, by their number in `points`
    position (r, d): um
    projection (r,): gaps and normals, um; None before the first evaluation
    q (r, k): kinematics: gap of the projection, um, and where charges pass potential jump, V
    shift (r, k): the multipliers' additions to q
    response (r,): response of the law, at the predicted kinematics if there is a prediction
    predicted (r, k): predicted change of q; None without a prediction
    """

    pair: int
    slave: SlaveFacets
    points: SlavePoints
    law: ContactLaw
    facet_size: Array
    share: float = 1.0
    history: Array = field(init=False)
    met: Integers = field(init=False)
    multipliers: Multipliers = field(init=False)
    viscous_bonds: ViscousBonds = field(init=False)
    slave_nodes: Integers = field(init=False)
    near_points: Integers = field(init=False)
    projected_points: Integers = field(init=False)
    position: Array = field(init=False)
    projection: Projection | None = field(init=False, default=None)
    q: Array = field(init=False)
    shift: Array = field(init=False)
    response: Response | None = field(init=False, default=None)
    predicted: Array | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        self.history = self.law.virgin(len(self.points.weight))
        self.met = np.zeros(len(self.points.weight), int)
        self.multipliers = Multipliers.none(self.slave.kind, len(self.slave))
        self.end_viscous_regularization()
        self._keep()

    @property
    def possible_laws(self) -> list[ContactLaw]:
        """The laws (m,) that points may have."""
        return [self.law]

    @property
    @abstractmethod
    def side(self) -> int:
        """Number of the set of points among those of its pair, for `keys`."""

    @abstractmethod
    def evaluate(self, at: NodalState, *, tangent: bool) -> ContactTerms:
        """Terms of the points at a state. LinAlgError, ValueError: facets have collapsed."""

    @abstractmethod
    def first_changes(self, at: NodalState, change: Array) -> Array:
        """First-order changes (r, k) of the kinematics with those (n, block_size) of the unknowns."""

    @abstractmethod
    def facet_pairs_within(self, distance: float) -> Integers:
        """Nodes (k, 2 n) of the pairs of facets with a gap below `distance` (um) plus half a facet."""

    @abstractmethod
    def numbers_in_results(self, pairs: Pairs) -> Integers:
        """Number (r,) that the pair of each projected point has in the results."""

    @abstractmethod
    def touching_bodies(self, pairs: Pairs) -> set[int]:
        """Bodies in contact with others or with a plane."""

    @property
    def gap(self) -> Array:
        """Gap (r,) of the law, with the multipliers' shift, um."""
        return self.q[:, 0] + self.shift[:, 0]

    @property
    def jump(self) -> Array | None:
        """Potential jump (r,), V; None where no charges pass."""
        return self.q[:, 1] if self.q.shape[1] > 1 else None

    # --- Response of the law ---

    def _respond_at(self, at: NodalState, jump: Array | None) -> None:
        """Let the law respond at the gaps of the projection and at these jumps (r,), V; None without."""
        gap, rows = self.projection.gap, self.projected_points
        self.q = gap[:, None] if jump is None else np.stack([gap, jump], axis=1)
        shift = self.multipliers.at(self.slave.kind, self.points.facet[rows], self.points.xi[rows])
        self.shift = shift[:, : self.q.shape[1]]
        self.response = self._response(at)

    def _response(self, at: NodalState) -> Response:
        """Response at the kinematics or at the predicted ones, with the multipliers' shifts."""
        rows = self.projected_points
        q = self.q if self.predicted is None else self.q + self.predicted
        law = self.law + self.viscous_bonds if at.mode.viscous else self.law
        return augmented_response(law[rows], q, self.history[rows], self.shift, at.mode)

    def _point_forces(self, at: NodalState) -> PointForces:
        """What the response gives to residual and tangent, by the gap and the jump of the potential unknown.

        With a prediction the residual is extrapolated backwards from the response there.
        """
        r, weight = self.response, self.share * self.points.weight[self.projected_points]
        units = self._units(at)
        tangent = r.gradient * units
        residual = tangent if self.predicted is None else r.extrapolated(-self.predicted) * units
        if not at.mode.consistent:
            tangent = tangent * ([0.0, 1.0][: len(units)])
        return PointForces(weight, residual, tangent, r.hessian * np.outer(units, units))

    def _units(self, at: NodalState) -> Array:
        """The unit (k,) of each of the kinematics in that of the unknowns: a jump is counted in V."""
        return np.array([1.0] if self.q.shape[1] == 1 else [1.0, at.scale])

    def predict(self, at: NodalState, change: Array) -> Array:
        """Respond from now on as after this change (n, block_size) of the unknowns since the last evaluation.

        Sums (2,) over the points of the squared forces and charges that the last response, linearized, misses.
        LinAlgError: facets have collapsed.
        """
        last, before = self.response, self.predicted
        self.predicted = self.first_changes(at, change)
        expected = last.extrapolated(self.predicted if before is None else self.predicted - before)
        weight = self.share * self.points.weight[self.projected_points]
        missed = weight[:, None] * (self._response(at).gradient - expected) * self._units(at)
        return np.pad((missed**2).sum(axis=0), (0, 2 - missed.shape[1]))

    def end_prediction(self) -> None:
        """Respond at the states that are evaluated again."""
        self.predicted = None

    def _near_contact(self, distance: float) -> Booleans:
        """Whether the gap of points (r,) is below `distance` (um) plus half a facet."""
        return self.projection.gap < distance + NEAR * self.facet_size[self.projected_points]

    # --- History ---

    def commit(self) -> None:
        """Advance the history by the last evaluation, which is the end of a converged step or of a part of one."""
        near = self.projected_points
        history = self.law[near].committed(self.q + self.shift, self.history[near])
        self.history = self.law.on_loss_of_contact(self.history).copy()
        self.history[near] = history
        self._keep()

    def snapshot(self) -> Snapshot:
        """Points, history and multipliers of the last converged step."""
        return self._converged

    def restore(self, snapshot: Snapshot) -> None:
        """Return to a snapshot, as the end of the last converged step."""
        self._set_points(snapshot.points)
        self.history, self.multipliers = snapshot.history.copy(), snapshot.multipliers.copy()
        self.met = snapshot.met.copy()
        self._converged = snapshot

    def saved(self, *, augmented: bool) -> Points:
        """The history of the points for a checkpoint, and with augmentation the multipliers, by their keys."""
        known = self.history.any(axis=1)
        points = {"history": (self.keys()[known], self.history[known])} if self.law.history_size else {}
        if augmented:
            shifts = np.stack([self.multipliers.gap, self.multipliers.jump], axis=2)
            points["shift"] = self.corner_keys(), shifts.reshape(-1, 2)
        return points

    def resume(self, read: ReadPoints, *, augmented: bool) -> None:
        """Take up the history that a checkpoint holds. Collective."""
        if self.law.history_size:
            values, found = read("history", self.keys(), self.law.history_size)
            self.history[:] = np.where(found[:, None], values, 0.0)
        if augmented:
            values, _ = read("shift", self.corner_keys(), 2)
            self.multipliers.gap[:], self.multipliers.jump[:] = values.T.reshape(2, *self.multipliers.gap.shape)
        self._keep()

    def _keep(self) -> None:
        self._converged = Snapshot(self.points, self.history.copy(), self.multipliers.copy(), self.met.copy())

    def set_multipliers(self, multipliers: Multipliers) -> None:
        """Take up the multipliers of a step of augmentation."""
        self.multipliers = multipliers

    def _set_points(self, points: SlavePoints) -> None:
        self.points = points
        self.end_viscous_regularization()

    def start_viscous_regularization(self, share: float) -> None:
        """Resist the opening of bonds from the present gaps on, with `share` times their steepest softening."""
        rows = self.projected_points
        start, stiffness = np.zeros((2, len(self.points.weight)))
        start[rows], stiffness[rows] = self.gap, share * self.law.softening(self.history)[rows]
        self.viscous_bonds = ViscousBonds(start, stiffness)

    def end_viscous_regularization(self) -> None:
        """Open bonds without viscous resistance."""
        self.viscous_bonds = ViscousBonds.none(len(self.points.weight))

    def energies(self) -> Array:
        """The `ENERGIES` (4,) of the last evaluation, pJ (2D: per um of depth).

        Points that are not projected count too: they hold the adhesion of bonds that are not formed and what broken
        ones have dissipated.
        """
        sums = np.zeros(len(ENERGIES))
        far = np.ones(len(self.points.weight), bool)
        far[self.projected_points] = False
        responses = [(self.response, self.projected_points)]
        if self.law.softens:
            apart = np.zeros((int(far.sum()), 2))
            apart[:, 0] = FAR_GAP
            responses.append((self.law[far].respond(apart, self.history[far]), np.flatnonzero(far)))
        for r, rows in responses:
            weight = self.share * self.points.weight[rows]
            sums += [float(weight @ r.energy(name)) for name in ENERGIES]
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
