"""The nonlinear problem of one load level: residual and tangent of bulk, loads, contact and stabilization."""

from __future__ import annotations

from typing import Any, Protocol

import dolfinx
import dolfinx.fem.petsc
import numpy as np
import ufl
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from piezomat.assembly.tangent_matrix import TangentMatrix
from piezomat.contact.interfaces import Interfaces
from piezomat.contact.terms import ContactTerms
from piezomat.discretization.model import Model
from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.forms.energy import stabilization_form, stored_energies
from piezomat.forms.evaluation import integral
from piezomat.forms.piezo import internal_form, load_tangent, tangent_form
from piezomat.meshes import parallel
from piezomat.usage import Timer, give_back_memory

# Springs that hold a floating part where it was at the last converged step: its stiffness over its size squared.
GROUNDING = 1e-8
ROUNDING = 1e-12  # of the potential of a strain of one


class CondensedBulk(Protocol):
    """A bulk that is told by some of its unknowns, the others being in equilibrium."""

    def residual(self, x: PETSc.Vec, result: PETSc.Vec) -> None:
        """Residual of the bulk at x."""


class Problem:
    """Residual and tangent of a model at given load factors, for Newton's method. Every method is collective.

    The state x solves R(x) = R_bulk(x) + R_loads + R_contact(x) + G (x - x_n) = 0 where it is not fixed; G grounds
    the parts that nothing but contact holds, and x_n is the last converged state.
    """

    def __init__(self, model: Model, contact: Interfaces | None, timer: Timer) -> None:
        self.model = model
        self.contact = contact
        self.timer = timer
        self.comm: MPI.Comm = model.comm
        self._evaluated: PETSc.Vec = fenicsx.petsc_vector(model.state)  # where forms are evaluated
        self.state: PETSc.Vec = self._evaluated.duplicate()
        self.state.set(0.0)
        self.has_finite_kinematics = model.kinematics == "finite"
        self._test = ufl.TestFunction(model.unknowns.space)
        self._coordinates = model.coordinate_vector()
        with timer("assembly"):
            self._compile()
            self._springs = self._ground()
            self.stabilization_factor = 1.0  # factor by which the springs are stronger, see `Springs`
            self._bulk = dolfinx.fem.petsc.create_matrix(self._tangent_form)
            self._assemble_bulk()
        self._matrix: TangentMatrix | None = None
        self.condensed: CondensedBulk | None = None  # what tells the bulk's residual, where it is not the matrix
        self.stiffness_version = 0  # how often bulk and grounding have changed
        self.residual_with_reactions = self.state.duplicate()  # residual with the reactions of what is fixed
        self.loads = self.state.duplicate()  # what the loads add to the residual: minus the nodal forces they apply
        self.converged_state = self.state.duplicate()  # the last converged state
        self._work = self.state.duplicate()  # new vectors in each iteration would stay until garbage is collected
        self._terms: ContactTerms | None = None
        self.snap_through_work: Array | None = None  # of the last part of a step, if it snapped
        self.is_linear = contact is None and not self.has_finite_kinematics
        length = float(model.parts.size.max())
        stiffest = contact.largest_penalty if contact is not None else 0.0
        # Forces of a strain of one, and of a penetration as large as the coordinates that the gaps are made from.
        self.largest_force = length ** (model.dim - 1) * (model.stiffness + stiffest * length)

    @property
    def is_stabilized(self) -> bool:
        """Whether springs hold a part, because its boundaries do not."""
        return self._springs is not None

    @property
    def has_weakly_held_bodies(self) -> bool:
        """Whether nothing but contact and weak springs holds some of the bodies."""
        return self.model.has_unconstrained_bodies and self.stabilization_factor == 1.0

    @property
    def is_symmetric(self) -> bool:
        """Whether the tangent is symmetric: all but follower pressure is derived from one enthalpy."""
        return self._load_tangent is None

    def collect_garbage(self) -> None:
        """Destroy the PETSc objects that Python has let go: petsc4py puts it off until all ranks do it together."""
        PETSc.garbage_cleanup(self.comm)
        PETSc.garbage_cleanup(self.state.comm.tompi4py())
        PETSc.garbage_cleanup(MPI.COMM_SELF)
        give_back_memory()

    def close(self) -> None:
        """Destroy the matrices; state and contact can still be looked at."""
        tangent = self._matrix.matrix if self._matrix is not None else None
        for matrix in (self._bulk, tangent):
            if matrix is not None:
                matrix.destroy()
        self.collect_garbage()

    def set_loads(self, factors: dict[str, float]) -> None:
        """Go to a load level: the loads and the values of the fixed unknowns (taken up by Newton's start value)."""
        self.model.loads.set_factors(factors)
        if self.contact is not None:
            self.contact.move_planes(factors)
        self.prescribed_values = self.model.constraints.values(factors)
        self._assemble_loads()

    def begin_step(self, margin: float) -> None:
        """Start a step from the converged state: pair the surfaces anew and remember where the step starts."""
        self.collect_garbage()
        self.state.copy(self.converged_state)
        self.pair(margin)

    def pair(self, margin: float) -> None:
        """Pair the contact surfaces at the present state, looking `margin` (um) around every point."""
        self.condensed = None  # where a solve has failed on the way, its inside is not that of this state
        if self.contact is None:
            return
        with self.timer("contact"):
            self.contact.detect(self.state, margin)
        if self._matrix is not None:
            self._matrix.forget_pattern()

    def residual(self, x: PETSc.Vec, result: PETSc.Vec, *, search: bool = True) -> None:
        """R(x) with zeros at the fixed unknowns; `full` keeps it with the reactions there. search: see `Interfaces`."""
        with self.timer("assembly"):
            self._bulk_residual(x)
        if self.contact is not None:
            with self.timer("contact"):
                terms = self.contact.evaluate(x, tangent=False, search=search)
                self.contact.add_residual(terms, self.residual_with_reactions)
                if self.contact.evaluation_failed:
                    self.residual_with_reactions.set(np.nan)
        self.residual_with_reactions.copy(result)
        result.array[self.model.constraints.fixed] = 0.0

    def linearize(self, x: PETSc.Vec) -> None:
        """Take up the tangent at x: `multiply`, `tangent` and `contact_terms` are then those of this state."""
        self._update_bulk(x)
        if self.contact is not None:
            with self.timer("contact"):
                self._terms = self.contact.evaluate(x, tangent=True)

    def tangent(self) -> tuple[PETSc.Mat, bool]:
        """The tangent as a matrix, the fixed unknowns eliminated, and whether its pattern differs from the last."""
        nodes, matrices = self.contact_terms()
        reserve = self.contact.candidate_nodes() if self.contact is not None else nodes
        with self.timer("assembly"):
            if self._matrix is None:
                fixed = self.model.constraints.fixed_global
                self._matrix = TangentMatrix(self.comm, self._bulk, self.model.unknowns.block, fixed)
            matrix, fresh = self._matrix.assemble(nodes, matrices, reserve)
            self._matrix.eliminate()
        return matrix, fresh

    def contact_terms(self) -> tuple[NDArray[np.int64], Array]:
        """Contact's part of the tangent: global nodes (k, n) of each pair of facets here, and its matrix."""
        if self.contact is None:
            size = 2 * self.model.unknowns.block
            return np.zeros((0, 2), np.int64), np.zeros((0, size, size))
        return self.contact.global_nodes(self._terms), self._terms.matrices

    def bulk_stiffness(self) -> PETSc.Mat:
        """A copy of the tangent's bulk and grounding, the fixed unknowns eliminated."""
        bulk = self._bulk.copy()
        bulk.zeroRowsColumns(self.model.constraints.fixed_global, diag=1.0)
        return bulk

    def multiply(self, change: PETSc.Vec, result: PETSc.Vec) -> None:
        """result = tangent of the last `linearize` times a change of the state, nothing eliminated from it."""
        self._bulk.mult(change, result)
        if self.contact is not None:
            self.contact.add_product(self._terms, change, result)

    def linearized_contact_residual(self, change: PETSc.Vec, result: PETSc.Vec) -> None:
        """result = contact's share of the residual after a change of the state, as the last `linearize` tells it."""
        result.set(0.0)
        self.contact.add_residual(self._terms, result)
        self.contact.add_product(self._terms, change, result)

    def prescribed_change(self) -> PETSc.Vec:
        """How far the fixed unknowns are from where this load level wants them, zero elsewhere."""
        change = self.state.duplicate()
        change.set(0.0)
        fixed = self.model.constraints.fixed
        change.array[fixed] = self.prescribed_values - self.state.array_r[fixed]
        return change

    def refresh(self) -> None:
        """Bring the model's function up to date with the state, ghosts included."""
        self._set_state(self.state)

    def norms(self, vector: PETSc.Vec) -> Array:
        """Euclidean norms of the displacement and the potential part of a vector, (1,) or (2,)."""
        values = vector.array_r.reshape(-1, self.model.unknowns.block) ** 2
        parts = [values[:, : self.model.dim].sum()]
        if self.model.electric:
            parts.append(values[:, -1].sum())
        return np.sqrt(parallel.total(self.comm, np.array(parts)))

    @property
    def has_loads(self) -> bool:
        """Whether the scene has loads, beside prescribed displacements and potentials."""
        return self._load_form is not None

    def external_forces(self) -> Array:
        """Norms (1,) or (2,) of what acts from outside at the last `residual`: reactions, loads, rigid planes."""
        self.loads.copy(self._work)
        self._work.axpy(-1.0, self.residual_with_reactions)
        if self.contact is not None:
            self.contact.add_forces_of_planes(self._work)
        return self.norms(self._work)

    def displacements(self, vector: PETSc.Vec) -> Array:
        """This rank's displacement part (nodes, d) of a vector."""
        return vector.array_r.reshape(-1, self.model.unknowns.block)[:, : self.model.dim]

    def maximum(self, value: float) -> float:
        """The largest of the ranks' values."""
        return self.comm.allreduce(value, op=MPI.MAX)

    def potential_range(self) -> float:
        """Range of the potential over the model, V, or what round-off makes of one."""
        scale = self.model.potential_scale
        if scale is None:
            return 1.0
        values = scale * self.state.array_r.reshape(-1, self.model.unknowns.block)[:, -1]
        ends = np.array([values.max(initial=-np.inf), -values.min(initial=np.inf)])
        return max(float(parallel.largest(self.comm, ends).sum()), ROUNDING * scale)

    def motion(self, since: PETSc.Vec | None = None) -> float:
        """How far a node has moved since an earlier state, or since the step began, um: the largest component."""
        change = self.displacements(self.state) - self.displacements(self.converged_state if since is None else since)
        return self.maximum(float(np.abs(change).max(initial=0.0)))

    def energies(self, x: PETSc.Vec) -> dict[str, float]:
        """Stored energies of the bulk at x, pJ: elastic, electric."""
        self._set_state(x)
        elastic, electric = self._energy_forms
        return {
            "elastic": integral(elastic),
            "electric": integral(electric) if electric is not None else 0.0,
        }

    def stabilization_work(self) -> float:
        """Work of the grounding springs in the step that ends at the present state, pJ."""
        if self._springs is None:
            return 0.0
        change = self.state - self.converged_state
        work = self.stabilization_factor * self._springs.array_r * change.array_r**2
        return self.comm.allreduce(float(np.abs(work).sum()), op=MPI.SUM)

    def _compile(self) -> None:
        model = self.model
        kinematics = model.kinematics
        self._tangent_form = dolfinx.fem.form(tangent_form(model.state, model.constitutive_field, kinematics))
        self._residual_form = None
        if self.has_finite_kinematics:
            self._residual_form = dolfinx.fem.form(internal_form(model.state, model.constitutive_field, kinematics))
        self._energy_forms = [
            None if e is None else dolfinx.fem.form(e)
            for e in stored_energies(model.state, model.constitutive_field, kinematics)
        ]
        loads = model.loads.form(model.state, model.kinematics, model.potential_scale)
        self._load_form = None if loads.empty() else dolfinx.fem.form(loads)
        derivative = None if loads.empty() else load_tangent(loads, model.state)
        self._load_tangent = None if derivative is None else dolfinx.fem.form(derivative)

    def _ground(self) -> PETSc.Vec | None:
        """The springs of parts that float, one at every unknown; None where no part does."""
        model = self.model
        if not model.unconstrained.any():
            return None
        strength = dolfinx.fem.Function(fenicsx.piecewise_constant(model.mesh, 2))
        modulus = np.array([self._modulus(members) for members in model.bodies.part_bodies])
        values = GROUNDING * modulus / model.parts.size[:, None] ** 2 * model.unconstrained
        cells = fenicsx.dofmap(strength.function_space)[: len(model.bodies.cell_part), 0]
        strength.x.array.reshape(-1, 2)[cells] = values[model.bodies.cell_part]
        strength.x.scatter_forward()
        springs = self.state.duplicate()
        self._assemble_into(springs, dolfinx.fem.form(stabilization_form(self._test, strength)))
        return springs

    def _modulus(self, members: list[int]) -> Array:
        """Stiffness of the softest body of a part, MPa, and the same for the potential unknown."""
        materials = [self.model.materials[i] for i in members]
        permittivity = min((m.mean_permittivity for m in materials if m.electric), default=0.0)
        scale = self.model.potential_scale or 0.0
        return np.array([min(m.mean_stiffness for m in materials), permittivity * scale**2])

    def set_stabilization(self, factor: float) -> None:
        """Make the springs of floating parts `factor` times as strong as they are at first."""
        if self.is_stabilized and factor != self.stabilization_factor:
            self._add_springs(factor - self.stabilization_factor)
            self.stabilization_factor = factor
            self._renew()

    def _add_springs(self, factor: float) -> None:
        diagonal = self._bulk.getDiagonal()
        diagonal.axpy(factor, self._springs)
        self._bulk.setDiagonal(diagonal)

    def _renew(self) -> None:
        self.stiffness_version += 1
        if self._matrix is not None:
            self._matrix.set_bulk(self._bulk)

    def stabilization_load_share(self) -> float:
        """Forces of the springs on floating parts over the forces of the loads; 0 without springs or loads."""
        loads = self.comm.allreduce(float(np.abs(self.displacements(self.loads)).sum()), op=MPI.SUM)
        if not self.is_stabilized or loads == 0.0:
            return 0.0
        force = self._springs * (self.state - self.converged_state)
        return self.comm.allreduce(float(np.abs(self.displacements(force)).sum()), op=MPI.SUM) / loads

    def _assemble_bulk(self) -> None:
        self._bulk.zeroEntries()
        dolfinx.fem.petsc.assemble_matrix(self._bulk, self._tangent_form)
        if self._load_tangent is not None:
            dolfinx.fem.petsc.assemble_matrix(self._bulk, self._load_tangent)
        self._bulk.assemble()
        if self._springs is not None:
            self._add_springs(self.stabilization_factor)

    def _update_bulk(self, x: PETSc.Vec) -> None:
        if not self.has_finite_kinematics:
            return
        with self.timer("assembly"):
            self._set_state(x)
            self._assemble_bulk()
            self._renew()

    def bulk_residual(self, x: PETSc.Vec) -> PETSc.Vec:
        """Residual at x of all but contact, with the reactions of what is fixed."""
        self._bulk_residual(x)
        return self.residual_with_reactions.copy()

    def _bulk_residual(self, x: PETSc.Vec) -> None:
        if self.condensed is not None:
            self.condensed.residual(x, self.residual_with_reactions)
            return
        if self.has_finite_kinematics:
            self._set_state(x)
            self._assemble_into(self.residual_with_reactions, self._residual_form)
            if self._load_tangent is not None:
                self._assemble_loads()
        else:
            self._bulk.mult(x, self.residual_with_reactions)  # its springs included
        self.residual_with_reactions.axpy(1.0, self.loads)
        if self._springs is not None:
            self.converged_state.copy(self._work)
            if self.has_finite_kinematics:
                self._work.axpy(-1.0, x)
            self._work.pointwiseMult(self._springs, self._work)
            self.residual_with_reactions.axpy(-self.stabilization_factor, self._work)

    def _assemble_loads(self) -> None:
        self.loads.set(0.0)
        if self._load_form is not None:
            self._assemble_into(self.loads, self._load_form)

    def _assemble_into(self, vector: PETSc.Vec, form: Any) -> None:
        with vector.localForm() as local:
            local.set(0.0)
        dolfinx.fem.petsc.assemble_vector(vector, form)
        vector.ghostUpdate(PETSc.InsertMode.ADD_VALUES, PETSc.ScatterMode.REVERSE)

    def _set_state(self, x: PETSc.Vec) -> None:
        x.copy(self._evaluated)
        self._evaluated.ghostUpdate(PETSc.InsertMode.INSERT_VALUES, PETSc.ScatterMode.FORWARD)
