"""What the boundary conditions prescribe: which unknowns are fixed, and at which values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from piezomat.discretization.unknowns import Unknowns
from piezomat.forms.arrays import Array, Booleans
from piezomat.forms.contact.gap import point_normals
from piezomat.forms.contact.integrals import nodal_points, quadrature_points
from piezomat.meshes import parallel
from piezomat.meshes.body_mesh import BodyMesh
from piezomat.meshes.contact.surface import surface
from piezomat.scene.errors import SceneError
from piezomat.scene.sections import Boundary


@dataclass(frozen=True)
class Condition:
    """A row [[boundaries]] of the scene on the mesh: the unknowns that it fixes, and the measure of its facets.

    boundary: the row of the scene
    facets (f,): this rank's facets of the group
    fixed {component: (k,)}: owned local unknowns that it fixes; where rows meet, the first one fixes the unknown
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
    """The fixed unknowns of a model and their values at given load factors.

    conditions: the rows [[boundaries]] of the scene, in order
    groups {facet group: conditions on it}
    fixed (k,): local numbers of the owned unknowns that are fixed, sorted
    fixed_global (k,): their global numbers
    is_fixed (owned, block): whether an unknown is fixed
    """

    def __init__(
        self,
        boundaries: Sequence[Boundary],
        unknowns: Unknowns,
        bodies: BodyMesh,
        dielectric_node: Booleans,
        potential_scale: float | None,
    ) -> None:
        """Fix what the boundaries prescribe, and at zero the potentials (local nodes,) that no permittivity touches.

        Collective. Raises SceneError for a group without facets.
        """
        self._unknowns = unknowns
        self._potential_scale = potential_scale
        self.is_fixed: Booleans = np.zeros((unknowns.owned, unknowns.block), bool)
        if unknowns.electric:
            self.is_fixed[:, unknowns.dim] = ~dielectric_node[: unknowns.owned]
        self.conditions = [self._condition(index, boundary, bodies) for index, boundary in enumerate(boundaries)]
        self.groups: dict[str, list[Condition]] = {}
        for condition in self.conditions:
            self.groups.setdefault(condition.boundary.on, []).append(condition)
        self.fixed = np.flatnonzero(self.is_fixed.ravel())
        self.fixed_global = (self.fixed + unknowns.first_node * unknowns.block).astype(PETSc.IntType)

    def values(self, factors: dict[str, float]) -> Array:
        """Prescribed values (k,) of the fixed unknowns at these load factors, in the order of `fixed`."""
        unknowns = self._unknowns
        values = np.zeros(unknowns.owned * unknowns.block)
        for condition in self.conditions:
            b = condition.boundary
            factor = load_factor(b, factors)
            for component, fixed in condition.fixed.items():
                potential = component == unknowns.dim
                value = b.potential / self._potential_scale if potential else b.displacement[component]
                values[fixed] = factor * value
        return values[self.fixed]

    def fixed_displacements(self) -> Booleans:
        """Which of the fixed unknowns (k,) are displacements."""
        return self.fixed % self._unknowns.block < self._unknowns.dim

    def set_zero(self, vector: PETSc.Vec) -> None:
        """Set the fixed unknowns of a vector to zero."""
        vector.array[self.fixed] = 0.0

    def eliminate(self, matrix: PETSc.Mat) -> None:
        """Make the rows and columns of the fixed unknowns those of the unit matrix. Collective."""
        matrix.zeroRowsColumns(self.fixed_global, diag=1.0)

    def _condition(self, index: int, boundary: Boundary, bodies: BodyMesh) -> Condition:
        """A row of the scene; marks the unknowns that it fixes."""
        unknowns = self._unknowns
        facets = bodies.facets[boundary.on]
        nodes = unknowns.nodes_of(facets)
        if unknowns.comm.allreduce(len(facets)) == 0:
            raise SceneError(f"boundaries[{index}].on", f'"{boundary.on}", which has no facets', "a group with facets")
        components = dict(enumerate(boundary.displacement or []))
        if boundary.potential is not None:
            components[unknowns.dim] = boundary.potential
        fixed = {}
        for component, value in components.items():
            if value is None:
                continue
            free = nodes[~self.is_fixed[nodes, component]]
            self.is_fixed[free, component] = True
            fixed[component] = free * unknowns.block + component
        return Condition(boundary, facets, fixed, *_measure(unknowns, bodies, facets))


def load_factor(boundary: Boundary, factors: dict[str, float]) -> float:
    """Value of the load factor that a row [[boundaries]] follows; 1 without one."""
    return factors[boundary.follows] if boundary.follows is not None else 1.0


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
