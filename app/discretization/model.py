"""The discrete model of a scene: its mesh, material, unknowns, constraints and loads."""

from __future__ import annotations

from typing import Any

import dolfinx
import dolfinx.fem.petsc
import numpy as np
from petsc4py import PETSc

from piezomat.discretization.conductors import conductors
from piezomat.discretization.constraints import Constraints, reference_nodes
from piezomat.discretization.doubts import doubts
from piezomat.discretization.loads import Loads
from piezomat.discretization.material_axes import axes_along_lines
from piezomat.discretization.prescription import Prescription
from piezomat.discretization.rigid_bodies import parts_of, unconstrained
from piezomat.discretization.unknowns import Unknowns
from piezomat.forms.constitutive import ConstitutiveLaw
from piezomat.forms.enthalpy import regions
from piezomat.forms.materials import VACUUM_PERMITTIVITY, Material
from piezomat.meshes.body_mesh import BodyMesh
from piezomat.scene.scene import Scene


class Model:
    """The discrete model of a scene on a distributed mesh. Collective.

    bodies: the mesh with its bodies, parts and facet groups
    mesh, comm, dim: the dolfinx mesh, its communicator and dimension
    materials: of each body, in global axes; in its own where they follow its centre line
    axes: rotations (n, 3, 3) to the cells of this rank of those bodies, by number; the columns are the material axes
    warnings: doubts about the scene on its mesh, one sentence each
    electric: whether any material has a permittivity, and the model a potential
    kinematics: "small" or "finite"
    plane: "strain" or "stress", in 2D
    stiffness, MPa: mean stiffness of the stiffest material
    potential_scale, V: the potential unknown is the potential over this, sqrt(stiffness / permittivity) um, which makes
        the matrices of both fields of one size; None without a potential
    unknowns: the space, and where unknowns stand in vectors
    parts: connected parts and their extents
    constraints: fixed unknowns and their values
    prescription: largest motion and voltage that boundaries and planes prescribe
    loads: tractions, pressures and charges
    unconstrained (parts, 2): whether no boundary constrains the rigid-body modes of a part, and its mean potential
    regions: the cells of each material law
    trial_state: Function at which forms are evaluated, see `set_trial_state`; the solution is `Problem.solution`
    """

    def __init__(self, scene: Scene, bodies: BodyMesh) -> None:
        """Raises SceneError for a boundary that does not fit the mesh, or a joint that cannot be meant."""
        self.scene = scene
        self.bodies = bodies
        self.mesh = bodies.mesh
        self.comm = bodies.comm
        self.dim: int = self.mesh.geometry.dim
        self.kinematics = scene.model.kinematics
        self.plane = scene.model.plane
        self.materials: list[ConstitutiveLaw] = [scene.material(name) for name in bodies.bodies]
        dielectrics = [m.mean_permittivity for m in self.materials if not m.conductor]
        largest = max(dielectrics, default=0.0) or VACUUM_PERMITTIVITY
        self.materials = [m.beside(largest) if isinstance(m, Material) else m for m in self.materials]
        self.axes = axes_along_lines(scene, bodies)
        self.warnings = doubts(scene, bodies, self.materials)
        self.electric = any(m.electric for m in self.materials)
        self.stiffness = max(m.mean_stiffness for m in self.materials)
        self.potential_scale: float | None = None
        if self.electric:
            self.potential_scale = float(np.sqrt(self.stiffness / largest))
        references = reference_nodes(scene)
        self.unknowns = Unknowns(self.mesh, bodies.order, electric=self.electric, references=references)
        self.trial_state = dolfinx.fem.Function(self.unknowns.space)
        self._layout = self.unknowns.empty_vector(self.comm)
        self._ghosted = self.unknowns.ghosted_vector(self.comm)
        materials = self.materials, bodies.cell_body, self.plane, self.potential_scale, self.axes
        self.regions = regions(self.mesh, *materials)
        has_permittivity = np.array([m.electric for m in self.materials])
        dielectric = self.unknowns.touched(has_permittivity[bodies.cell_body])
        self.parts = parts_of(bodies, self.unknowns)
        metal = conductors(self.unknowns, bodies, self.materials)
        self.constraints = Constraints(scene, self.unknowns, bodies, dielectric, metal, self.potential_scale)
        self.prescription = Prescription(self.comm, self.constraints, scene.planes, scene.load)
        self.loads = Loads(self.constraints, scene.electrodes, bodies)
        self.unconstrained = unconstrained(self.parts, self.unknowns, self.constraints, dielectric)

    @property
    def electrode_names(self) -> list[str]:
        """Names of the electrodes, in the order of the scene."""
        return [e.electrode.name for e in self.constraints.electrodes]

    @property
    def has_unconstrained_bodies(self) -> bool:
        """Whether a part has a rigid-body mode that no boundary constrains."""
        return bool(self.unconstrained[:, 0].any())

    def new_vector(self) -> PETSc.Vec:
        """A distributed vector of the unknowns ; zero."""
        vector = self._layout.duplicate()
        vector.set(0.0)
        return vector

    def coordinate_vector(self) -> PETSc.Vec:
        """The nodes' reference coordinates, um, in the displacement part of a new vector."""
        vector, owned = self.new_vector(), self.unknowns.owned
        values = np.zeros((owned, self.unknowns.block))
        values[:, : self.dim] = self.unknowns.coordinates[:owned]
        self.unknowns.set_by_node(vector, values)
        return vector

    def assemble_vector(self, form: Any, result: PETSc.Vec) -> None:
        """result = a compiled linear form, summed over the ranks; zero at reference nodes."""
        with self._ghosted.localForm() as local:
            local.set(0.0)
        dolfinx.fem.petsc.assemble_vector(self._ghosted, form)
        self._ghosted.ghostUpdate(PETSc.InsertMode.ADD_VALUES, PETSc.ScatterMode.REVERSE)
        result.set(0.0)
        result.array[: len(self._ghosted.array_r)] = self._ghosted.array_r

    def set_trial_state(self, x: PETSc.Vec) -> None:
        """Evaluate forms at x from now on: copy it into the Function `trial_state`, ghosts included."""
        nodal = x.array_r[: self.unknowns.owned * self.unknowns.block]
        self.trial_state.x.array[: len(nodal)] = nodal
        self.trial_state.x.scatter_forward()
