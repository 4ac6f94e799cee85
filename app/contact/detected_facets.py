"""Result of a detection: the slave facets of a rank and the master facets that their points may meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.contact.nodal_state import NodalState
from piezomat.contact.seen_nodes import SeenNodes
from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.forms.contact.facets import FacetKind, corner_kind
from piezomat.forms.contact.gap import Projection
from piezomat.forms.contact.integrals import FacetPairs
from piezomat.forms.contact.smoothing import rounded, spread
from piezomat.meshes.contact.facet_bounds import near_pairs
from piezomat.meshes.contact.global_search import GhostFacets, PairingRule
from piezomat.meshes.contact.joined_facets import JoinedFacets
from piezomat.meshes.contact.load_balance import SlaveFacets
from piezomat.meshes.contact.self_contact import Candidates, ReferenceFacets, SelfContact

# How much further than its nodes a point of a facet may move, by the facet's order: Lebesgue's constant of triangles.
LARGEST_SHAPE = {1: 1.0, 2: 5.0 / 3.0}
EVERY = slice(None)


@dataclass(frozen=True)
class DetectedFacets:
    """Slave facets (f,) and master facets (g,) of all ranks within the search radius of them.

    slave_nodes (f, n), master_nodes (g, n): nodes of the facets, numbered as in `SeenNodes`
    self_contact: which facets of the same connected part may meet; None without self-contact
    joined: the master facets that meet at a node
    """

    rule: PairingRule
    slave: SlaveFacets
    master: GhostFacets
    slave_nodes: Integers
    master_nodes: Integers
    self_contact: SelfContact | None
    joined: JoinedFacets

    @classmethod
    def of(
        cls, slave: SlaveFacets, master: GhostFacets, rule: PairingRule, nodes: SeenNodes, geodesic: Array | None
    ) -> DetectedFacets:
        """The facets with the places of their nodes; geodesic (n,): the nodes' distances, with self-contact."""
        slave_nodes, master_nodes = nodes.places(slave.nodes), nodes.places(master.nodes)
        self_contact = None
        if geodesic is not None:
            self_contact = SelfContact(
                *(
                    ReferenceFacets.of(
                        slave.kind,
                        rounded(slave.kind, nodes.reference[places], facets.rounding),
                        facets.orientation,
                        geodesic[places],
                        places,
                        facets.key,
                    )
                    for facets, places in ((slave, slave_nodes), (master, master_nodes))
                )
            )
        corners = master_nodes[:, : len(corner_kind(slave.kind).nodes)]
        reference = rounded(slave.kind, nodes.reference[master_nodes], master.rounding)
        joined = JoinedFacets.of(slave.kind, corners, reference, master.orientation)
        return cls(rule, slave, master, slave_nodes, master_nodes, self_contact, joined)

    @property
    def kind(self) -> FacetKind:
        """Kind of all facets."""
        return self.slave.kind

    def slave_at(self, position: Array, facet: Integers | slice = EVERY) -> Array:
        """Nodes (f, n, d) of slave facets with the seen nodes at `position`; of curved facets all nodes."""
        return rounded(self.kind, position[self.slave_nodes[facet]], self.slave.rounding[facet])

    def master_at(self, position: Array, facet: Integers | slice = EVERY) -> Array:
        """Nodes (g, n, d) of master facets with the seen nodes at `position`; of curved facets all nodes."""
        return rounded(self.kind, position[self.master_nodes[facet]], self.master.rounding[facet])

    def potentials_at(self, potentials: Array, slave: Integers, master: Integers) -> tuple[Array, Array]:
        """Nodal potentials (k, n) of slave and of master facets (k,)."""
        return (
            spread(self.kind, potentials[self.slave_nodes[slave]], self.slave.rounding[slave]),
            spread(self.kind, potentials[self.master_nodes[master]], self.master.rounding[master]),
        )

    def nodes_of(self, slave: Integers, master: Integers) -> Integers:
        """Nodes (k, 2 n) of pairs of facets, slave first."""
        return np.concatenate([self.slave_nodes[slave], self.master_nodes[master]], axis=1)

    def roundings_of(self, slave: Integers, master: Integers) -> tuple[Array, Array]:
        """Roundings (k, ., d) of slave and of master facets."""
        return self.slave.rounding[slave], self.master.rounding[master]

    def pairs(
        self,
        at: NodalState,
        slave: Integers,
        master: Integers,
        projection: Projection,
        shape: Array,
        *,
        charged: bool,
    ) -> FacetPairs:
        """Pairs of slave and master facets (k,) with points that have these projections and shape functions (k, n).

        charged: whether charges pass.
        """
        potentials = self.potentials_at(at.potentials, slave, master)[1] if charged else None
        return FacetPairs(self.kind, projection, shape, at.block_size, potentials, self.roundings_of(slave, master))

    def may_meet(self, slave: Integers, master: Integers) -> Booleans:
        """Whether points of slave facets may meet master facets, (k,) each."""
        ours, theirs = self.slave.component[slave], self.master.component[master]
        may = self.rule.allows(ours, theirs)
        if self.self_contact is not None:
            joined = np.flatnonzero(may & self.rule.same_part(ours, theirs))
            pairs = slave[joined], master[joined]
            may[joined] = self.self_contact.may_meet(*pairs)
            if self.rule.ordered:
                may[joined] &= (ours != theirs)[joined] | self.self_contact.precedes(*pairs)
        return may

    def same_part(self, slave: Integers, master: Integers) -> Booleans:
        """Whether slave and master facets (k,) belong to the same connected part."""
        return self.rule.same_part(self.slave.component[slave], self.master.component[master])

    def self_candidates(self, position: Array, slave: Integers, master: Integers, margin: float) -> Candidates:
        """Master facets of their own part that points of slave facets may meet and that come within `margin` (um)."""
        i, j = near_pairs(self.slave_at(position, slave), self.master_at(position, master), margin)
        may = self.may_meet(slave[i], master[j])
        return Candidates.of(slave[i[may]], j[may], len(self.slave))

    def largest_motions(self, change: Array, bodies: int) -> Array:
        """Largest motion (bodies,) of the facets of each body, um, when the seen nodes move by `change` (n, d)."""
        length = LARGEST_SHAPE[self.kind.order] * np.linalg.norm(change, axis=1)
        found = np.zeros(bodies)
        for facets, nodes in ((self.slave, self.slave_nodes), (self.master, self.master_nodes)):
            np.maximum.at(found, self.rule.body(facets.component), length[nodes].max(axis=1, initial=0.0))
        return found
