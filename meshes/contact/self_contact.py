"""Self-contact: which facets of its own connected part a point may meet.

Neighbouring facets and the far side of the same fiber are always near a point. In the deformed state neither distances
nor normals distinguish them from a surface that has come into contact; in the undeformed state they do. Two facets may
meet if they face each other there across open space, as the legs of a hairpin, or if their geodesic distance is large,
as in a fiber that bends back on itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.forms.contact.facets import FacetKind
from piezomat.forms.contact.gap import point_normals
from piezomat.meshes.contact.facet_bounds import FACING

# Geodesic distance, in thicknesses, up to which facets are neighbours. The path through a fiber to its far side is
# shorter, although it follows edges of cells. The path along a fiber that bends until it touches itself is longer,
# unless its bend is narrower than two diameters.
NEIGHBOURHOOD = 3.0


@dataclass(frozen=True)
class ReferenceFacets:
    """Facets in the undeformed state.

    middle, normal (f, d); geodesic (f,): geodesic distance over `NEIGHBOURHOOD` thicknesses; nodes (f, n): numbers;
    key (f,).
    """

    middle: Array
    normal: Array
    geodesic: Array
    nodes: Integers
    key: Integers

    @classmethod
    def of(
        cls, kind: FacetKind, facets: Array, orientation: Array, geodesic: Array, nodes: Integers, key: Integers
    ) -> ReferenceFacets:
        """From facets (f, n, d) and the `geodesic_distance` (f, n) of their nodes, over the neighbourhood's."""
        xi = np.tile(kind.middle, (len(facets), 1))
        middle = np.einsum("mk,mkd->md", kind.shape(xi), facets)
        # Nodes between corners have no distance.
        return cls(middle, point_normals(kind, xi, facets, orientation), geodesic.min(axis=1), nodes, key)


@dataclass(frozen=True)
class SelfContact:
    """Which slave and master facets of one part may meet, from their undeformed state."""

    slave: ReferenceFacets
    master: ReferenceFacets

    def may_meet(self, i: Integers, j: Integers) -> Booleans:
        """Whether points of slave facets i may meet master facets j, (k,) each."""
        far = np.abs(self.slave.geodesic[i] - self.master.geodesic[j]) > 1.0
        near = np.flatnonzero(~far)
        i, j = i[near], j[near]
        away = self.master.middle[j] - self.slave.middle[i]
        ours, theirs = self.slave.normal[i], self.master.normal[j]
        faces = np.einsum("md,md->m", ours, theirs) < FACING
        faces &= (np.einsum("md,md->m", away, ours) > 0.0) & (np.einsum("md,md->m", away, theirs) < 0.0)
        across = np.flatnonzero(faces)
        adjacent = (self.slave.nodes[i[across]][:, :, None] == self.master.nodes[j[across]][:, None]).any(axis=(1, 2))
        far[near[across[~adjacent]]] = True
        return far

    def precedes(self, i: Integers, j: Integers) -> Booleans:
        """Whether slave facets i are nearer to the end of their part than master facets j, (k,) each."""
        ours, theirs = self.slave.geodesic[i], self.master.geodesic[j]
        return (ours < theirs) | ((ours == theirs) & (self.slave.key[i] < self.master.key[j]))


@dataclass(frozen=True)
class Candidates:
    """Facets that points of each slave facet may meet: of slave facet f, facet[start[f] : start[f + 1]]."""

    start: Integers
    facet: Integers

    @classmethod
    def of(cls, slave: Integers, facet: Integers, slaves: int) -> Candidates:
        """From pairs (slave facet, facet), (k,) each."""
        order = np.argsort(slave, kind="stable")
        start = np.concatenate([[0], np.cumsum(np.bincount(slave, minlength=slaves))])
        return cls(start, facet[order])

    def of_points(self, slave: Integers) -> tuple[Integers, Integers]:
        """Pairs (point, facet) of points on these slave facets (m,)."""
        count = self.count(slave)
        row = np.repeat(np.arange(len(slave)), count)
        before = np.cumsum(count) - count
        return row, self.facet[self.start[slave][row] + np.arange(len(row)) - before[row]]

    def count(self, slave: Integers) -> Integers:
        """Number (m,) of facets that points on these slave facets (m,) may meet."""
        return self.start[slave + 1] - self.start[slave]
