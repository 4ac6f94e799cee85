"""Krylov solver with algebraic multigrid, for the tangents of large three-dimensional models."""

from __future__ import annotations

from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.discretization.evaluation_mode import COMPLETE, EvaluationMode
from piezomat.discretization.model import Model
from piezomat.discretization.rigid_bodies import rigid_modes
from piezomat.forms.arrays import Booleans
from piezomat.scene.sections import Solver
from piezomat.solver import coarse_space
from piezomat.solver.callbacks import CallbackErrors
from piezomat.solver.equations import WholeProblem
from piezomat.solver.tangent_operator import TangentOperator

START_TOLERANCE = 0.1  # of the linear solve that gives Newton's method its start value
CLOSE_TOLERANCE = 1e-3  # of the linear solve after Newton's method, where stabilization alone holds a part
# Of every linear solve with unconstrained bodies: what moves them is a small part of the forces. With fewer digits
# Newton's method takes half as many iterations again, each with a contact evaluation.
LOOSE_TOLERANCE = 1e-4
AGED = 1.5  # growth of the Krylov iterations a digit at which a preconditioner is made anew


class Multigrid:
    """FGMRES with algebraic multigrid, made for one tangent and kept while it serves for the next ones.

    The tolerance of a Newton step's solve follows the residual (Eisenstat and Walker 1996), unless the scene sets one.
    Unconstrained bodies are held by few points of contact that come and go: for them the preconditioner is made for
    each tangent, and that of the displacements has the coarse space of `coarse_space`.

    operators: the last tangent and the matrix that its preconditioner is made from, for PETSc's KSP.
    start_tolerance, close_tolerance: relative tolerances of the start value and of a close solve; None where the scene
    sets one for all. equations, callback_errors, failure, factor_solves, candidates: see `Direct`; the last three none.
    """

    failure = ""
    factor_solves = candidates = 0
    start_tolerance: float | None = START_TOLERANCE
    close_tolerance: float | None
    operators: tuple[PETSc.Mat, PETSc.Mat]

    def __init__(self, problem: Problem, keys: Solver) -> None:
        self.problem = problem
        self.equations = WholeProblem(problem)
        self.callback_errors = CallbackErrors()
        self._operator = TangentOperator(problem, self.callback_errors)
        self._loose = problem.model.has_unconstrained_bodies
        self._rigid = _near_nullspace(problem.model, problem.comm, apart=problem.model.electric and not self._loose)
        self._interpolation: PETSc.Mat | None = None
        self._matrix: PETSc.Mat | None = None
        self._rate = 0.0  # Krylov iterations a digit in the first solve with the present preconditioner
        self.close_tolerance = min(1e-8, 0.1 * keys.tolerance) if problem.is_linear else CLOSE_TOLERANCE
        self._inexact = "ksp_rtol" not in keys.petsc and not self._loose
        if "ksp_rtol" in keys.petsc:
            self.start_tolerance = self.close_tolerance = None
        elif self._loose:
            self.start_tolerance = LOOSE_TOLERANCE

    def close(self) -> None:
        """Part from PETSc's objects, which hold this one. Ends its use."""
        self._operator.close()

    def options(self) -> dict[str, Any]:
        """PETSc options, without SNES's prefix."""
        chosen = {
            "ksp_type": "fgmres",
            "ksp_gmres_restart": 100,
            "ksp_max_it": 1000,
        }
        if self._inexact:
            chosen |= {"snes_ksp_ew": True, "snes_ksp_ew_rtol0": 0.1, "snes_ksp_ew_rtolmax": 0.1}
        return chosen | self._multigrid()

    def attach(self, ksp: PETSc.KSP) -> None:
        """Set up SNES's Krylov solver: which unknowns are displacements (and their rigid modes), which potentials."""
        self._ksp = ksp
        model = self.problem.model
        if not model.electric:
            return
        u_numbers, phi_numbers = _fields(model, apart=not self._loose)
        u = PETSc.IS().createGeneral(u_numbers, comm=self.problem.comm)
        u.setBlockSize(model.dim)
        u.compose("nearnullspace", self._rigid)
        phi = PETSc.IS().createGeneral(phi_numbers, comm=self.problem.comm)
        self._displacements = u
        pc = ksp.getPC()
        pc.setType(PETSc.PC.Type.FIELDSPLIT)
        pc.setFieldSplitIS(("u", u), ("phi", phi))

    def linearize(self, x: PETSc.Vec, mode: EvaluationMode = COMPLETE) -> None:
        """Take the tangent at x: `operators` are then its."""
        self.problem.linearize(x, mode)
        if self._matrix is None or self._loose or self._has_aged():
            self._matrix, fresh = self.problem.tangent()
            if fresh and not self.problem.model.electric:
                self._matrix.setNearNullSpace(self._rigid)
            if self._loose and fresh:
                self._interpolate()
            self._rate = 0.0
        self.operators = self._matrix if self._loose else self._operator.matrix, self._matrix

    def _interpolate(self) -> None:
        """Give the displacements' multigrid its interpolation, unless the scene has chosen another multigrid."""
        model, ksp = self.problem.model, self._ksp
        if model.electric:
            ksp.setOperators(self._matrix)
            ksp.setUp()
            ksp = ksp.getPC().getFieldSplitSubKSP()[0]
        pc = ksp.getPC()
        if pc.getType() != PETSc.PC.Type.MG:
            return
        if self._interpolation is None:
            stiffness = self.problem.bulk_stiffness()
            if model.electric:
                whole, stiffness = stiffness, stiffness.createSubMatrix(self._displacements, self._displacements)
                whole.destroy()
            self._interpolation = coarse_space.interpolation(model, stiffness)
            stiffness.destroy()
        operators = ksp.getOperators()
        pc.reset()  # or PETSc would write the coarse matrix into the pattern of the last one
        ksp.setOperators(*operators)
        for matrix in operators:
            matrix.destroy()  # this reference to it, which would live until garbage is collected
        pc.setMGInterpolation(1, self._interpolation)

    def _has_aged(self) -> bool:
        """Whether the last solve took many more iterations a digit than the first with this preconditioner."""
        digits = max(-np.log10(self._ksp.getTolerances()[0]), 0.5)
        rate = max(self._ksp.getIterationNumber(), 5) / digits
        self._rate = self._rate or rate
        return rate > AGED * self._rate

    def _multigrid(self) -> dict[str, Any]:
        """Smoothed aggregation for each field, with rigid modes; `coarse_space` for unconstrained bodies."""
        # Point smoothers only: the coarse grids have empty rows where unknowns are fixed, which SOR cannot divide by.
        smoother = {"mg_levels_ksp_max_it": 3, "mg_levels_pc_type": "jacobi"}
        amg = {"pc_type": "gamg", "pc_gamg_threshold": 0.02} | smoother
        of_displacements = coarse_space.options(symmetric=self.problem.is_symmetric) | smoother if self._loose else amg
        if not self.problem.model.electric:
            return of_displacements
        split: dict[str, Any] = {"pc_type": "fieldsplit", "pc_fieldsplit_type": "multiplicative"}
        for part, multigrid in (("u", of_displacements), ("phi", amg)):
            split |= {f"fieldsplit_{part}_ksp_type": "preonly"}
            split |= {f"fieldsplit_{part}_{name}": value for name, value in multigrid.items()}
        return split


def _is_still(model: Model) -> Booleans:
    """Which of this rank's nodes (owned + references_here,) are reference nodes of potentials alone."""
    unknowns = model.unknowns
    still = np.arange(unknowns.owned + unknowns.references_here) >= unknowns.owned
    still[model.constraints.motions.local // unknowns.block] = False
    return still


def _fields(model: Model, *, apart: bool) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Global numbers of the owned unknowns in the field of displacements and in that of potentials.

    apart: the displacements of reference nodes of potentials alone, which are zero, are in the second. In the matrix
    they have places beside all nodes of an electrode, and PETSc 3.18 has room for 4,096 of them when it makes a graph
    of nodes, as it does where unknowns come in blocks.
    """
    u, phi = model.unknowns.displacement_numbers(), model.unknowns.potential_numbers()
    still = np.repeat(_is_still(model) & apart, model.dim)
    return u[~still], np.sort(np.concatenate([phi, u[still]]))


def _near_nullspace(model: Model, comm: MPI.Comm, *, apart: bool) -> PETSc.NullSpace:
    """Orthonormal rigid modes of the whole model; what moves as one by a force takes part in translations.

    apart: see `_fields`.
    """
    unknowns, constraints = model.unknowns, model.constraints
    modes = rigid_modes(unknowns.coordinates[: unknowns.owned])
    modes = np.concatenate([modes, np.zeros((unknowns.references_here, *modes.shape[1:]))])
    local = constraints.motions.local
    node, component = local // unknowns.block, local % unknowns.block
    modes[node, component, : model.dim] = constraints.motion_directions[: len(local)]
    if apart:
        modes = modes[~_is_still(model)]
    vectors = []
    for k in range(modes.shape[2]):
        vector = PETSc.Vec().createMPI((len(modes) * model.dim, None), bsize=model.dim, comm=comm)
        vector.array[:] = modes[:, :, k].ravel()
        vectors.append(vector)
    for i, vector in enumerate(vectors):
        for other in vectors[:i]:
            vector.axpy(-vector.dot(other), other)
        vector.normalize()
    return PETSc.NullSpace().create(vectors=vectors, comm=comm)
