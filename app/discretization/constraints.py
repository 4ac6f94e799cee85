"""Constraints x = T y + g: which unknowns boundaries and electrodes fix, at which values g, and which they tie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from piezomat.discretization.conductors import Conductor
from piezomat.discretization.electrodes import ElectrodeNodes, electrode_nodes, other_conductors
from piezomat.discretization.motions import PushedPlane, RigidBoundary, pushed_planes, rigid_boundaries
from piezomat.discretization.ties import References, Ties
from piezomat.discretization.unknowns import Unknowns
from piezomat.forms.arrays import Array, Booleans
from piezomat.forms.contact.gap import point_normals
from piezomat.forms.contact.integrals import nodal_points, quadrature_points
from piezomat.meshes import parallel
from piezomat.meshes.body_mesh import BodyMesh
from piezomat.meshes.contact.surface import surface
from piezomat.scene.errors import SceneError, shown
from piezomat.scene.scene import Scene
from piezomat.scene.sections import Boundary, Electrode, Plane


@dataclass(frozen=True)
class Condition:
    """A row [[boundaries]] of the scene on the mesh: the unknowns that it fixes, and the measure of its facets.

    boundary: the row of the scene
    facets (f,): this rank's facets of the group
    fixed {component: (k,)}: owned local unknowns that it fixes; where rows meet, which then agree, the first one does
    area (um2; 2D: um): of the undeformed facets, over all ranks
    normal (d,): integral of the outward normal over the undeformed facets, over all ranks
    nodes (m,), weights (m,): this rank's nodes on the facets and the share of the area that belongs to each
    """

    boundary: Boundary
    facets: NDArray[np.int32]
    fixed: dict[int, NDArray[np.int64]]
    area: float
    normal: Array
    nodes: NDArray[np.int32]
    weights: Array


class Constraints:
    """The constraints of a model, and the values of its fixed unknowns at given load factors.

    conditions: the rows [[boundaries]] of the scene, in order
    groups {facet group: conditions on it}
    electrodes: the rows [[electrodes]] of the scene, in order
    conductors: the conductors that belong to none of these
    rigid, pushed: the rigid boundaries and the planes by force of the scene; the reference nodes are those of
        electrodes, conductors, rigid boundaries and planes by force, in this order
    references: all unknowns of reference nodes: potentials of electrodes and conductors, and motions
    potentials (electrodes,): of the electrodes' reference nodes
    travels (pushed,): of the planes by force
    motions (k,): components of the rigid boundaries' translations that are free, and then those travels
    motion_directions (k, d): displacement of the boundary or plane with a unit of each of them
    motion_loads (k,): the row of the scene that loads each of them, and the force at a load factor of 1, uN
    ties: the potentials of an electrode's nodes, and the displacements of a rigid boundary's, equal those of a
        reference node
    tied_on {facet group: {component: local numbers of the owned unknowns on it that are tied}}
    fixed (k,): local numbers of the owned unknowns that are fixed, sorted
    eliminated (k,), eliminated_global (k,): local and global numbers of the owned unknowns that are fixed or tied
    is_fixed (owned, block): whether an unknown of a node of the mesh is fixed
    """

    def __init__(
        self,
        scene: Scene,
        unknowns: Unknowns,
        bodies: BodyMesh,
        dielectric_node: Booleans,
        metal: Sequence[Conductor],
        potential_scale: float | None,
    ) -> None:
        """Fix and tie what the scene says, and fix at zero the potentials (local nodes,) that no permittivity touches.

        Collective. Raises SceneError for a group without facets, for boundaries that prescribe different values at a
        node, and for electrodes with nodes in common.
        """
        self._unknowns = unknowns
        self._potential_scale = potential_scale
        self.is_fixed: Booleans = np.zeros((unknowns.owned, unknowns.block), bool)
        if unknowns.electric:
            self.is_fixed[:, unknowns.dim] = ~dielectric_node[: unknowns.owned]
        self._metal = metal
        # Of the boundaries that prescribe the potential of a conductor, which is then that of all its nodes.
        self._rows_of_metal: list[set[int]] = [set() for _ in metal]
        self.conditions: list[Condition] = []
        for boundary in scene.boundaries:
            self.conditions.append(self._condition(boundary, bodies))
        self.groups: dict[str, list[Condition]] = {}
        for condition in self.conditions:
            self.groups.setdefault(condition.boundary.on, []).append(condition)
        given = np.full(unknowns.owned, -1)
        for row, condition in enumerate(self.conditions):
            given[condition.fixed.get(unknowns.dim, np.zeros(0, np.int64)) // unknowns.block] = row
        for conductor, rows in zip(metal, self._rows_of_metal, strict=True):
            given[conductor.nodes] = max(rows, default=-1)
        self.electrodes: list[ElectrodeNodes] = electrode_nodes(scene, unknowns, bodies, dielectric_node, metal, given)
        self.conductors = other_conductors(scene, unknowns, metal, self._rows_of_metal, self.electrodes)
        number = len(self.equipotentials)
        self.rigid: list[RigidBoundary] = rigid_boundaries(scene, unknowns, bodies, self.is_fixed, number)
        self.pushed: list[PushedPlane] = pushed_planes(scene, number + len(self.rigid))
        potentials = [unknowns.reference_number(e.reference, unknowns.dim) for e in self.equipotentials]
        translations = [unknowns.reference_number(r.reference, i) for r in self.rigid for i in r.tied]
        travels = [unknowns.reference_number(p.reference, 0) for p in self.pushed]
        self.potentials = References(unknowns, potentials[: len(self.electrodes)])
        self.motions = References(unknowns, translations + travels)
        self.references = References(unknowns, potentials + translations + travels)
        self.travels = References(unknowns, travels)
        axes = [i for r in self.rigid for i in r.tied]
        self.motion_directions: Array = np.concatenate(
            [np.eye(unknowns.dim)[axes], np.reshape([p.direction for p in self.pushed], (-1, unknowns.dim))]
        )
        self.motion_loads: list[tuple[Boundary | Plane, float]] = [
            *((r.boundary, r.boundary.force[i]) for r in self.rigid for i in r.tied),
            *((p.plane, p.force) for p in self.pushed),
        ]
        tied = [e.nodes * unknowns.block + unknowns.dim for e in self.equipotentials]
        tied += [numbers for r in self.rigid for numbers in r.tied.values()]
        self.ties = Ties(unknowns, tied, References(unknowns, potentials + translations))
        self.tied_on = {name: self._tied_on(name, bodies.facets[name]) for name in self.groups}
        # Reference nodes have no other unknowns than these; of electrodes some have a given potential.
        at_references = np.ones(unknowns.references_here * unknowns.block, bool)
        open_ = [p for p, e in zip(potentials, self.equipotentials, strict=True) if e.electrode.potential is None]
        for numbers in (self.motions, References(unknowns, open_)):
            at_references[numbers.local - unknowns.owned * unknowns.block] = False
        self.fixed = np.flatnonzero(np.concatenate([self.is_fixed.ravel(), at_references]))
        self.eliminated = np.union1d(self.fixed, self.ties.tied)
        self.eliminated_global = (self.eliminated + unknowns.first_node * unknowns.block).astype(PETSc.IntType)

    def values(self, factors: dict[str, float]) -> Array:
        """Prescribed values (k,) of the fixed unknowns at these load factors, in the order of `fixed`."""
        unknowns = self._unknowns
        values = np.zeros((unknowns.owned + unknowns.references_here) * unknowns.block)
        for condition in self.conditions:
            b = condition.boundary
            factor = load_factor(b, factors)
            for component, fixed in condition.fixed.items():
                potential = component == unknowns.dim
                value = b.potential / self._potential_scale if potential else b.displacement[component]
                values[fixed] = factor * value
        for e in self.equipotentials if unknowns.references_here else ():
            if e.electrode.potential is not None:
                at = (unknowns.owned + e.reference) * unknowns.block + unknowns.dim
                values[at] = load_factor(e.electrode, factors) * e.electrode.potential / self._potential_scale
        return values[self.fixed]

    @property
    def equipotentials(self) -> list[ElectrodeNodes]:
        """Electrodes and conductors: what has one potential each, by the numbers of their reference nodes."""
        return [*self.electrodes, *self.conductors]

    def fixed_displacements(self) -> Booleans:
        """Which of the fixed unknowns (k,) are displacements."""
        return self.fixed % self._unknowns.block < self._unknowns.dim

    def reduce(self, vector: PETSc.Vec) -> None:
        """Replace a vector of forces by those on the unknowns that are left, zero at the eliminated. Collective."""
        self.ties.reduce(vector)
        vector.array[self.fixed] = 0.0

    def expand(self, vector: PETSc.Vec) -> None:
        """Give the tied unknowns of a vector their values, those of the references. Collective."""
        self.ties.expand(vector)

    def eliminate(self, matrix: PETSc.Mat) -> None:
        """Make the rows and columns of the eliminated unknowns those of the unit matrix. Collective."""
        matrix.zeroRowsColumns(self.eliminated_global, diag=1.0)

    def _tied_on(self, name: str, facets: NDArray[np.int32]) -> dict[int, NDArray[np.int64]]:
        """Of a group all potentials that are tied, and the displacements that are because the group itself is rigid.

        The charge that a boundary with a potential gives to a conductor is on the whole of it.
        """
        unknowns = self._unknowns
        found = {i: numbers for r in self.rigid if r.boundary.on == name for i, numbers in r.tied.items()}
        if self.equipotentials:
            rows = {row for row, condition in enumerate(self.conditions) if condition.boundary.on == name}
            whole = [c.nodes for c, of in zip(self._metal, self._rows_of_metal, strict=True) if of & rows]
            nodes = np.unique(np.concatenate([unknowns.nodes_of(facets), *whole]))
            found[unknowns.dim] = np.intersect1d(nodes * unknowns.block + unknowns.dim, self.ties.tied)
        return found

    def _condition(self, boundary: Boundary, bodies: BodyMesh) -> Condition:
        """The next row of the scene; marks the unknowns that it fixes."""
        unknowns, index = self._unknowns, len(self.conditions)
        facets = bodies.facets[boundary.on]
        nodes = unknowns.nodes_of(facets)
        if unknowns.comm.allreduce(len(facets)) == 0:
            raise SceneError(f"boundaries[{index}].on", f'"{boundary.on}", which has no facets', "a group with facets")
        fixed = {}
        for component in _prescribed(boundary, unknowns.dim):
            self._check_contradiction(boundary, component, nodes)
            free = nodes[~self.is_fixed[nodes, component]]
            if component == unknowns.dim:
                free = self._outside_metal(index, free)
            self.is_fixed[free, component] = True
            fixed[component] = free * unknowns.block + component
        return Condition(boundary, facets, fixed, *_measure(unknowns, bodies, facets))

    def _outside_metal(self, row: int, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
        """Those of a boundary's nodes that are on no conductor; notes that the row prescribes the others' potential."""
        for conductor, rows in zip(self._metal, self._rows_of_metal, strict=True):
            on_it = np.isin(nodes, conductor.nodes)
            if self._unknowns.comm.allreduce(bool(on_it.any()), op=MPI.LOR):
                rows.add(row)
            nodes = nodes[~on_it]
        return nodes

    def _check_contradiction(self, boundary: Boundary, component: int, nodes: NDArray[np.int64]) -> None:
        """Raise SceneError if an earlier row prescribes another value of a component at one of its nodes. Collective.

        Rows whose facets share a corner alone count too: one of the two would not be what the scene says.
        """
        unknowns, index = self._unknowns, len(self.conditions)
        value = _prescribed(boundary, unknowns.dim)[component]
        for number, other in enumerate(self.conditions):
            if _prescribed(other.boundary, unknowns.dim).get(component, value) == value:
                continue
            common = np.isin(nodes * unknowns.block + component, other.fixed[component])
            count = unknowns.comm.allreduce(int(common.sum()))
            if count:
                what = "potential" if component == unknowns.dim else "displacement"
                which = what if component == unknowns.dim else f"{what} {'xyz'[component]}"
                there = f"on {shown(boundary.on)} than boundaries[{number}] on {shown(other.boundary.on)}"
                belong = "nodes belong" if count > 1 else "node belongs"
                found = f"another {which} {there}; {count} {belong} to both"
                raise SceneError(f"boundaries[{index}].{what}", found, "one value at each node")


def _prescribed(row: Boundary, dim: int) -> dict[int, tuple[float, str | None]]:
    """Value and factor of each component that a row prescribes, the potential being the last; zero has no factor."""
    given = dict(enumerate(row.displacement or [])) | {dim: row.potential}
    return {i: (value, row.follows if value else None) for i, value in given.items() if value is not None}


def load_factor(row: Boundary | Electrode | Plane, factors: dict[str, float]) -> float:
    """Value of the load factor that a row of the scene follows; 1 without one."""
    return factors[row.follows] if row.follows is not None else 1.0


def reference_nodes(scene: Scene) -> int:
    """Number of reference nodes that a scene needs at most, see `Constraints`."""
    metal = sum(scene.material(body).conductor for body in scene.body_names)
    moving = sum(bool(row.rigid) for row in scene.boundaries) + sum(plane.is_pushed for plane in scene.planes)
    return len(scene.electrodes) + metal + moving


def _measure(
    unknowns: Unknowns, bodies: BodyMesh, facets: NDArray[np.int32]
) -> tuple[float, Array, NDArray[np.int32], Array]:
    """Area, integrated normal, nodes and their shares of the area of a group of facets, see `Condition`."""
    owned = facets[facets < bodies.mesh.topology.index_map(unknowns.dim - 1).size_local]
    group = surface(unknowns.space, "", owned, bodies.order)
    points = quadrature_points(group.kind, group.reference)
    normals = point_normals(group.kind, points.xi, group.reference[points.facet], group.orientation[points.facet])
    local = np.concatenate([[points.weight.sum()], points.weight @ normals])
    total = parallel.total(unknowns.comm, local)
    share = nodal_points(group.kind, group.reference)
    nodes = group.nodes[share.facet, share.place]
    return float(total[0]), total[1:], nodes, share.weight
