"""Stabilization stiffness: weak springs on the parts that only contact holds, without which the tangent is singular.

A spring at each unknown of such a part pulls it back to where it was, at first the last converged state, so that it
does work in a step and bears nothing that lasts. The potential of an open electrode that consists of planes has one
too, and the travel of a plane by force.
"""

from __future__ import annotations

import dolfinx
import numpy as np
import ufl
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.discretization.model import Model
from piezomat.discretization.term import AssembledTerm
from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array, Booleans
from piezomat.forms.stabilization import stabilization_form

TRAVEL_STIFFNESS = 1e-12  # the same of the travel of a plane, which is always in contact where a force pushes it
RELATIVE_STIFFNESS = 1e-8  # of the springs of a volume, at factor 1, over the part's stiffness over its size squared


class StabilizationStiffness(AssembledTerm):
    """Springs of the unconstrained parts of a model: force factor * stiffness * (x - x_a). Every method is collective.

    is_active: whether there are springs
    factor: by how much they are stronger than weak ones, see `piezomat.solver.stabilization_continuation`
    """

    def __init__(self, model: Model) -> None:
        self._unknowns, self._comm = model.unknowns, model.comm
        self.factor = 1.0
        held_by_planes = _held_by_planes(model)
        pushed = len(model.constraints.travels) > 0
        self.is_active = bool(model.unconstrained.any() or held_by_planes.any() or pushed)
        if self.is_active:
            self._anchor = model.new_vector()
            self._work_before = 0.0  # at earlier anchors
            self._stiffness = _stiffness(model, held_by_planes)
            self._work = model.new_vector()  # a new one in each iteration would stay until garbage is collected

    def begin_step(self, x: PETSc.Vec) -> None:
        """Let the springs pull back to the last converged state x, their work being none."""
        if self.is_active:
            x.copy(self._anchor)
            self._work_before = 0.0

    def release(self, x: PETSc.Vec) -> None:
        """Let the springs go: from now on they pull back to x, where they bear nothing."""
        self._work_before = self.work(x)
        x.copy(self._anchor)

    def add_tangent(self, matrix: PETSc.Mat) -> None:
        """See `AssembledTerm.add_tangent`."""
        if self.is_active:
            self._add_to_diagonal(matrix, self.factor)

    def set_factor(self, factor: float, matrix: PETSc.Mat) -> None:
        """Change the factor, and what `add_tangent` has added to this matrix."""
        self._add_to_diagonal(matrix, factor - self.factor)
        self.factor = factor

    def add_residual(self, x: PETSc.Vec, result: PETSc.Vec) -> None:
        """See `AssembledTerm.add_residual`."""
        if self.is_active:
            self._anchor.copy(self._work)
            self._work.axpy(-1.0, x)
            self._add_forces(result)

    def add_constant_residual(self, result: PETSc.Vec) -> None:
        """Add -factor * stiffness * x_a."""
        if self.is_active:
            self._anchor.copy(self._work)
            self._add_forces(result)

    def _add_forces(self, result: PETSc.Vec) -> None:
        """Subtract the springs times `_work`."""
        self._work.pointwiseMult(self._stiffness, self._work)
        result.axpy(-self.factor, self._work)

    def work(self, x: PETSc.Vec) -> float:
        """Work of the springs from the last converged state to x, pJ."""
        if not self.is_active:
            return 0.0
        change = x.array_r - self._anchor.array_r
        work = self.factor * self._stiffness.array_r * change**2
        return self._work_before + self._comm.allreduce(float(np.abs(work).sum()), op=MPI.SUM)

    def load_share(self, x: PETSc.Vec, loads: PETSc.Vec) -> float:
        """Sum of the forces of springs of factor 1 at x over that of the loads; 0 without springs or loads."""
        displacements = self._unknowns.all_displacements
        total = self._comm.allreduce(float(np.abs(displacements(loads)).sum()), op=MPI.SUM)
        if not self.is_active or total == 0.0:
            return 0.0
        change = displacements(x) - displacements(self._anchor)
        force = displacements(self._stiffness) * change
        return self._comm.allreduce(float(np.abs(force).sum()), op=MPI.SUM) / total

    def _add_to_diagonal(self, matrix: PETSc.Mat, factor: float) -> None:
        diagonal = matrix.getDiagonal()
        diagonal.axpy(factor, self._stiffness)
        matrix.setDiagonal(diagonal)


def _stiffness(model: Model, held_by_planes: Booleans) -> PETSc.Vec:
    """The springs at factor 1: one at each unknown, none where boundaries constrain the part.

    held_by_planes: see `_held_by_planes`.
    """
    strength = dolfinx.fem.Function(fenicsx.piecewise_constant(model.mesh, 2))
    modulus = np.array([_modulus(model, members) for members in model.bodies.part_bodies])
    values = RELATIVE_STIFFNESS * modulus / model.parts.size[:, None] ** 2 * model.unconstrained
    cells = fenicsx.dofmap(strength.function_space)[: len(model.bodies.cell_part), 0]
    strength.x.array.reshape(-1, 2)[cells] = values[model.bodies.cell_part]
    strength.x.scatter_forward()
    springs = model.new_vector()
    test = ufl.TestFunction(model.unknowns.space)
    model.assemble_vector(dolfinx.fem.form(stabilization_form(test, strength)), springs)
    # Of a plane as large as the model, whose stiffness is `model.stiffness` in units of the potential too.
    unit = model.stiffness * model.parts.volume / model.parts.size.max() ** 2
    model.constraints.potentials.add_values(springs, -RELATIVE_STIFFNESS * unit * held_by_planes)
    travels = model.constraints.travels
    travels.add_values(springs, np.full(len(travels), TRAVEL_STIFFNESS * unit))
    return springs


def _held_by_planes(model: Model) -> Booleans:
    """Whether nothing but what touches its planes says which potential an electrode has, (electrodes,). Collective."""
    electrodes = model.constraints.electrodes
    nodes = model.comm.allreduce(np.array([len(e.nodes) for e in electrodes], np.int64))
    return (nodes == 0) & np.array([e.electrode.potential is None for e in electrodes], bool)


def _modulus(model: Model, bodies: list[int]) -> Array:
    """Stiffness of the softest of some bodies, MPa, and the same for the potential unknown, (2,)."""
    materials = [model.materials[i] for i in bodies]
    permittivity = min((m.mean_permittivity for m in materials if m.electric), default=0.0)
    return np.array([min(m.mean_stiffness for m in materials), permittivity * (model.potential_scale or 0.0) ** 2])
