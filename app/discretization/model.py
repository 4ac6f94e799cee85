"""What is modelled: the unknowns, the bulk's material, what holds the bodies and what loads them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import dolfinx
import numpy as np
import ufl
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.forms.contact.gap import point_normals
from piezomat.forms.contact.integrals import nodal_points, quadrature_points
from piezomat.forms.materials import Material
from piezomat.forms.piezo import Load, boundary_loads, constitutive_field
from piezomat.meshes import parallel
from piezomat.meshes.body_mesh import BodyMesh
from piezomat.meshes.contact.surface import node_coordinates, surface
from piezomat.scene import Scene
from piezomat.scene.errors import SceneError
from piezomat.scene.sections import Boundary

HELD_TOLERANCE = 1e-8  # least eigenvalue, relative, of the constraints on a part's rigid modes that counts as held


@dataclass(frozen=True)
class Condition:
    """A boundary of the scene: its local owned unknowns by component, and those it fixes and reports on alone.

    fixed: {component: local scalar unknowns}; where boundaries meet, the one listed first holds the unknown. Of the
    undeformed boundary: area (um2; 2D: um), normal (d,), the integral of the outward normal, and the share `weights`
    of the area that belongs to each of the local `nodes`.
    """

    boundary: Boundary
    facets: NDArray[np.int32]
    fixed: dict[int, NDArray[np.int64]]
    area: float
    normal: Array
    nodes: NDArray[np.int32]
    weights: Array

    @property
    def loaded(self) -> bool:
        """Whether the boundary applies a load."""
        b = self.boundary
        return any(load is not None for load in (b.traction, b.pressure, b.charge_density))


class Model:
    """The discrete model of a scene on a distributed mesh. Collective.

    One blocked Lagrange space: displacement and, where any body has a permittivity, the potential divided by
    `potential_scale` = sqrt(stiffness / permittivity) um, which makes both fields' matrices of one size.
    """

    def __init__(self, scene: Scene, bodies: BodyMesh) -> None:
        self.scene = scene
        self.bodies = bodies
        self.mesh = bodies.mesh
        self.comm: MPI.Comm = self.mesh.comm
        self.dim: int = self.mesh.geometry.dim
        self.materials: list[Material] = [scene.material(name) for name in bodies.bodies]
        self.electric = any(m.electric for m in self.materials)
        self.stiffness = max(m.mean_stiffness for m in self.materials)
        self.potential_scale: float | None = None
        if self.electric:
            permittivity = max(m.mean_permittivity for m in self.materials)
            self.potential_scale = float(np.sqrt(self.stiffness / permittivity))
        self.space = fenicsx.lagrange(self.mesh, bodies.order, self.dim + self.electric)
        self.block: int = self.dim + self.electric
        self.state = dolfinx.fem.Function(self.space)
        self.part_modulus = np.array([self._modulus(members) for members in bodies.part_bodies])
        self.constitutive_field = constitutive_field(
            self.mesh,
            [m.constitutive_matrix(self.dim, scene.model.plane) for m in self.materials],
            bodies.cell_body,
            self.potential_scale,
        )
        self.coordinates = node_coordinates(self.space)
        self._index_map = self.space.dofmap.index_map
        self.owned = self._index_map.size_local
        self._find_parts()
        self.conditions = self._find_conditions()
        self.groups: dict[str, list[Condition]] = {}
        for condition in self.conditions:
            self.groups.setdefault(condition.boundary.on, []).append(condition)
        self._find_loads()
        self.unconstrained = self._find_unconstrained()

    def _modulus(self, members: list[int]) -> Array:
        """Stiffness of the softest body of a part, MPa, and the same for the potential unknown."""
        materials = [self.materials[i] for i in members]
        permittivity = min((m.mean_permittivity for m in materials if m.electric), default=0.0)
        return np.array([min(m.mean_stiffness for m in materials), permittivity * (self.potential_scale or 0.0) ** 2])

    @property
    def has_unconstrained_bodies(self) -> bool:
        """Whether a part can move that its boundaries do not hold."""
        return bool(self.unconstrained[:, 0].any())

    @property
    def unknowns(self) -> int:
        """Number of unknowns of the whole model."""
        return self._index_map.size_global * self.block

    def coordinate_vector(self) -> PETSc.Vec:
        """The nodes' reference coordinates in a distributed vector laid out like the state."""
        vector = fenicsx.petsc_vector(self.state).duplicate()
        values = np.zeros((self.owned, self.block))
        values[:, : self.dim] = self.coordinates[: self.owned]
        vector.array[:] = values.ravel()
        return vector

    def nodes_of(self, facets: NDArray[np.int32]) -> NDArray[np.int64]:
        """This rank's owned nodes on facets of any rank."""
        nodes = dolfinx.fem.locate_dofs_topological(self.space, self.dim - 1, facets)
        return np.asarray(nodes[nodes < self.owned], np.int64)

    def factor(self, boundary: Boundary, factors: dict[str, float]) -> float:
        """The value of the load factor that a boundary follows; 1 without one."""
        return factors[boundary.follows] if boundary.follows is not None else 1.0

    def fixed_values(self, factors: dict[str, float]) -> Array:
        """Values of the fixed unknowns, in the order of `fixed`."""
        values = np.zeros(self.owned * self.block)
        for condition in self.conditions:
            b = condition.boundary
            factor = self.factor(b, factors)
            for component, unknowns in condition.fixed.items():
                value = b.potential / self.potential_scale if component == self.dim else b.displacement[component]
                values[unknowns] = factor * value
        return values[self.fixed]

    def largest_voltage(self) -> float:
        """Largest difference of the potentials that boundaries and planes prescribe at once, V."""
        load, largest = self.scene.load, 0.0
        for stage in range(-1, len(load.steps)):
            factors = {name: values[stage] if stage >= 0 else 0.0 for name, values in load.factors.items()}
            given = [(b.potential, b.follows) for b in self.scene.boundaries]
            given += [(p.potential, p.potential_follows) for p in self.scene.planes]
            values = [v * (factors[name] if name is not None else 1.0) for v, name in given if v is not None]
            largest = max(largest, max(values, default=0.0) - min(values, default=0.0))
        return largest

    def set_loads(self, factors: dict[str, float]) -> None:
        """Set the load forms' constants to these load factors."""
        for constant, value, boundary in self._load_constants:
            constant.value = np.asarray(value) * self.factor(boundary, factors)

    def load_form(self) -> Any:
        """UFL form that the loads add to the residual (empty without loads)."""
        return boundary_loads(
            ufl.TestFunction(self.space),
            self.state,
            self._load_measure,
            self._loads,
            self.scene.model.kinematics,
            self.potential_scale,
        )

    def applied(self, condition: Condition, factors: dict[str, float]) -> Array:
        """Force (d) and charge that the loads of a boundary apply in all (uN, pC); reference area and normal."""
        b = condition.boundary
        total = np.zeros(self.dim + 1)
        if b.traction is not None:
            total[: self.dim] += np.asarray(b.traction) * condition.area
        if b.pressure is not None:
            total[: self.dim] -= b.pressure * condition.normal
        if b.charge_density is not None:
            total[self.dim] += b.charge_density * condition.area
        return total * self.factor(b, factors)

    def mean_potential(self, condition: Condition) -> float:
        """Mean of the potential over a boundary, V."""
        psi = self.state.x.array.reshape(-1, self.block)[condition.nodes, self.dim]
        total = self.comm.allreduce(float(condition.weights @ psi), op=MPI.SUM)
        return self.potential_scale * total / condition.area

    def _find_parts(self) -> None:
        """Each local node's part and whether a body with permittivity touches it."""
        nodes = fenicsx.dofmap(self.space)
        count = self.owned + self._index_map.num_ghosts
        self.node_part = np.zeros(count, np.int64)
        self.node_part[nodes] = self.bodies.cell_part[: len(nodes), None]
        dielectric = np.array([m.electric for m in self.materials])
        charged = np.zeros(count)
        charged[nodes[dielectric[self.bodies.cell_body[: len(nodes)]]]] = 1.0
        self.dielectric_node = fenicsx.sum_over_ranks(self.space, charged) > 0.0

    def _find_conditions(self) -> list[Condition]:
        taken = np.zeros((self.owned, self.block), bool)
        if self.electric:
            taken[:, self.dim] = ~self.dielectric_node[: self.owned]  # no unknown that matters: held at zero
        conditions = []
        for index, boundary in enumerate(self.scene.boundaries):
            facets = self.bodies.facets[boundary.on]
            nodes = self.nodes_of(facets)
            fixed = {}
            components = dict(enumerate(boundary.displacement or []))
            if boundary.potential is not None:
                components[self.dim] = boundary.potential
            if self.comm.allreduce(len(facets)) == 0:
                raise SceneError(
                    f"boundaries[{index}].on", f'"{boundary.on}", which has no facets', "a group with facets"
                )
            for component, value in components.items():
                if value is None:
                    continue
                free = nodes[~taken[nodes, component]]
                taken[free, component] = True
                fixed[component] = free * self.block + component
            conditions.append(Condition(boundary, facets, fixed, *self._measure(facets)))
        self.fixed = np.flatnonzero(taken.ravel())
        start = self._index_map.local_range[0] * self.block
        self.fixed_global = (self.fixed + start).astype(PETSc.IntType)
        return conditions

    def _measure(self, facets: NDArray[np.int32]) -> tuple[float, Array, NDArray[np.int32], Array]:
        """Area, integrated normal, nodes and their shares of the area of a group of facets."""
        owned = facets[facets < self.mesh.topology.index_map(self.dim - 1).size_local]
        group = surface(self.space, "", owned, self.bodies.order)
        points = quadrature_points(group.kind, group.reference)
        normals = point_normals(group.kind, points.xi, group.reference[points.facet], group.orientation[points.facet])
        local = np.concatenate([[points.weight.sum()], points.weight @ normals])
        total = parallel.total(self.comm, local)
        share = nodal_points(group.kind, group.reference)
        nodes = group.nodes[share.facet, share.place]
        return float(total[0]), total[1:], nodes, share.weight

    def _find_loads(self) -> None:
        """Constants and facet tags of the loads."""
        exterior = fenicsx.exterior_facets(self.mesh)
        loaded = [name for name, conditions in self.groups.items() if any(c.loaded for c in conditions)]
        # Groups may share facets: a tag stands for a set of groups, each of whose loads acts there.
        member = np.zeros((exterior.max(initial=-1) + 1, len(loaded)), bool)
        for column, name in enumerate(loaded):
            facets = self.groups[name][0].facets
            here = np.intersect1d(facets, exterior)
            member[here, column] = True
            if self.comm.allreduce(len(facets) > len(here), op=MPI.LOR):
                index = self.scene.boundaries.index(self.groups[name][0].boundary)
                raise SceneError(
                    f"boundaries[{index}].on", f'a load on "{name}", inside a body', "a group of the outside"
                )
        sets = {tuple(row) for row in member[member.any(axis=1)].tolist()}
        sets = sorted(set().union(*self.comm.allgather(sets)))
        tags = np.zeros(len(member), np.int32)
        for number, row in enumerate(sets, start=1):
            tags[(member == row).all(axis=1)] = number
        facets = np.flatnonzero(tags).astype(np.int32)
        self._facet_tags = dolfinx.mesh.meshtags(self.mesh, self.dim - 1, facets, tags[facets])
        self._load_measure = ufl.Measure("ds", domain=self.mesh, subdomain_data=self._facet_tags)
        self._load_constants: list[tuple[Any, Any, Boundary]] = []
        self._loads = []
        for condition in self.conditions:
            b = condition.boundary
            given = {
                name: getattr(b, name)
                for name in ("traction", "pressure", "charge_density")
                if getattr(b, name) is not None
            }
            if given:
                constants = {name: dolfinx.fem.Constant(self.mesh, np.asarray(v, float)) for name, v in given.items()}
                self._load_constants += [(constants[name], given[name], b) for name in given]
                numbers = [number for number, row in enumerate(sets, start=1) if row[loaded.index(b.on)]]
                self._loads += [Load(number, **constants) for number in numbers]

    def _find_unconstrained(self) -> NDArray[np.bool_]:
        """(parts, 2): whether nothing but contact holds a part, mechanically and electrically."""
        parts = len(self.bodies.part_bodies)
        d, owned = self.dim, self.owned
        part = self.node_part[:owned]
        middle = self._find_extents()
        local = (self.coordinates[:owned] - middle[part]) / self.part_size[part, None]
        modes = rigid_modes(local)
        held = np.zeros((owned * self.block,), bool)
        held[self.fixed] = True
        held = held.reshape(owned, self.block)
        rows = modes * held[:, :d, None]
        gram = self._sum_by_part(part, np.einsum("ndr,nds->nrs", rows, rows).reshape(owned, modes.shape[2] ** 2))
        gram = gram.reshape(parts, modes.shape[2], -1)
        eigenvalues = np.linalg.eigvalsh(gram)
        floating = np.zeros((parts, 2), bool)
        floating[:, 0] = eigenvalues[:, 0] < HELD_TOLERANCE * np.maximum(eigenvalues[:, -1], 1e-300)
        if self.electric:
            inside = self.dielectric_node[:owned]
            grounded = self._sum_by_part(part, (held[:, d] & inside)[:, None].astype(float))[:, 0] > 0
            charged = self._sum_by_part(part, inside[:, None].astype(float))[:, 0] > 0
            floating[:, 1] = charged & ~grounded
        return floating

    def _find_extents(self) -> Array:
        """Centre of gravity (parts, d) of each part; sets its size and thickness from its second moments of volume."""
        part = self.bodies.cell_part
        nodes = fenicsx.dofmap(self.space)[: len(part)]
        cells = self.coordinates[nodes]
        volume = fenicsx.cell_volumes(self.mesh)[:, None]
        total = self._sum_by_part(part, volume)
        self.volume = float(total.sum())
        middle = self._sum_by_part(part, volume * cells.mean(axis=1)) / total
        # Nodes rather than centres, so that a part of one cell has an extent too.
        local = cells - middle[part][:, None]
        second = volume * np.einsum("cni,cnj->cij", local, local).reshape(len(part), self.dim**2) / cells.shape[1]
        moments = (self._sum_by_part(part, second) / total).reshape(-1, self.dim, self.dim)
        moments = np.linalg.eigvalsh(moments)
        self.part_size = np.sqrt(moments.sum(axis=1))
        self.part_thickness = np.sqrt(12.0 * moments[:, 0])  # of a plate or block with that second moment
        return middle

    def _sum_by_part(self, part: NDArray[np.int64], values: Array) -> Array:
        parts = len(self.bodies.part_bodies)
        return parallel.total(self.comm, np.stack([np.bincount(part, v, parts) for v in values.T], axis=1))


def rigid_modes(x: Array) -> Array:
    """Rigid-body modes (n, d, 3 or 6) at points x (n, d)."""
    n, d = x.shape
    modes = np.zeros((n, d, 3 if d == 2 else 6))
    for i in range(d):
        modes[:, i, i] = 1.0
    if d == 2:
        modes[:, 0, 2], modes[:, 1, 2] = -x[:, 1], x[:, 0]
    else:
        for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
            modes[:, i, 3 + k], modes[:, j, 3 + k] = -x[:, j], x[:, i]
    return modes
