"""Loads: tractions, pressures and charges on boundaries as a UFL form whose constants follow the load factors.

The charge of an electrode and the force on a rigid boundary or a plane belong to no place: they load a reference node.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import dolfinx
import numpy as np
import ufl
from mpi4py import MPI

from piezomat.discretization.constraints import Condition, Constraints, load_factor
from piezomat.forms.arrays import Array, Booleans
from piezomat.forms.kinematics import Kinematics
from piezomat.forms.loads import Load, boundary_loads
from piezomat.meshes.body_mesh import BodyMesh
from piezomat.meshes.mesh_entities import exterior_facets
from piezomat.scene.errors import SceneError
from piezomat.scene.sections import Boundary, Electrode

KINDS = ("traction", "pressure", "charge_density")


class Loads:
    """Tractions, pressures and charge densities of all boundary conditions, reference area and normal.

    charges (electrodes,), pC: given to the electrodes at the present load factors
    forces (k,), uN: on `Constraints.motions` at the present load factors
    """

    def __init__(self, constraints: Constraints, electrodes: Sequence[Electrode], bodies: BodyMesh) -> None:
        """Collective. Raises SceneError for a load on facets inside a body."""
        self._mesh = bodies.mesh
        self._dim: int = bodies.mesh.geometry.dim
        self._electrodes = electrodes
        self._motion_loads, conditions = constraints.motion_loads, constraints.conditions
        self.charges = np.zeros(len(electrodes))
        self.forces = np.zeros(len(self._motion_loads))
        loaded = [condition for condition in conditions if _given(condition.boundary)]
        with_loads = {condition.boundary.on for condition in loaded}
        groups = [name for name in dict.fromkeys(c.boundary.on for c in conditions) if name in with_loads]
        combinations, tags = self._tag(conditions, groups, bodies)
        self._measure = ufl.Measure("ds", domain=self._mesh, subdomain_data=tags)
        self._constants: list[tuple[Any, Any, Boundary]] = []
        self._loads: list[Load] = []
        for condition in loaded:
            b = condition.boundary
            values = _given(b)
            constants = {
                kind: dolfinx.fem.Constant(self._mesh, np.asarray(value, float)) for kind, value in values.items()
            }
            self._constants += [(constants[kind], value, b) for kind, value in values.items()]
            column = groups.index(b.on)
            self._loads += [Load(tag, **constants) for tag, row in enumerate(combinations, start=1) if row[column]]

    def set_factors(self, factors: dict[str, float]) -> None:
        """Set the constants of the form, the charges and the forces to these load factors."""
        for constant, value, boundary in self._constants:
            constant.value = np.asarray(value) * load_factor(boundary, factors)
        self.charges = np.array([load_factor(row, factors) * (row.charge or 0.0) for row in self._electrodes])
        self.forces = np.array([load_factor(row, factors) * force for row, force in self._motion_loads])

    def form(self, state: Any, kinematics: Kinematics, potential_scale: float | None) -> Any:
        """UFL form that the loads add to the residual at `state`; an empty form without loads."""
        test = ufl.TestFunction(state.function_space)
        return boundary_loads(test, state, self._measure, self._loads, kinematics, potential_scale)

    def applied(self, condition: Condition, factors: dict[str, float]) -> Array:
        """Sum (d + 1,) of the forces (uN) and the charge (pC) that the loads of one condition apply."""
        b = condition.boundary
        total = np.zeros(self._dim + 1)
        if b.traction is not None:
            total[: self._dim] += np.asarray(b.traction) * condition.area
        if b.pressure is not None:
            total[: self._dim] -= b.pressure * condition.normal
        if b.charge_density is not None:
            total[self._dim] += b.charge_density * condition.area
        return total * load_factor(b, factors)

    def _tag(
        self, conditions: Sequence[Condition], groups: list[str], bodies: BodyMesh
    ) -> tuple[list[tuple[bool, ...]], Any]:
        """The combinations of loaded groups that facets belong to, and the facets' tags: 1 for the first combination.

        Groups may share facets: all loads of the groups of a combination act on its facets.
        """
        comm, exterior = self._mesh.comm, exterior_facets(self._mesh)
        member: Booleans = np.zeros((exterior.max(initial=-1) + 1, len(groups)), bool)
        for column, name in enumerate(groups):
            here = np.intersect1d(bodies.facets[name], exterior)
            member[here, column] = True
            if comm.allreduce(len(bodies.facets[name]) > len(here), op=MPI.LOR):
                rows = [condition.boundary for condition in conditions]
                index = next(i for i, row in enumerate(rows) if row.on == name and _given(row))
                raise SceneError(
                    f"boundaries[{index}].on", f'a load on "{name}", inside a body', "a group of the outside"
                )
        mine = {tuple(row) for row in member[member.any(axis=1)].tolist()}
        combinations = sorted(set().union(*comm.allgather(mine)))
        tags = np.zeros(len(member), np.int32)
        for number, row in enumerate(combinations, start=1):
            tags[(member == row).all(axis=1)] = number
        facets = np.flatnonzero(tags).astype(np.int32)
        return combinations, dolfinx.mesh.meshtags(self._mesh, self._dim - 1, facets, tags[facets])


def _given(boundary: Boundary) -> dict[str, Any]:
    """The loads of a row [[boundaries]] by kind."""
    return {kind: getattr(boundary, kind) for kind in KINDS if getattr(boundary, kind) is not None}
