"""The linear systems of Newton's method: how they are solved, what is chosen, and why."""

from __future__ import annotations

from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.discretization.model import Model
from piezomat.discretization.rigid_bodies import rigid_modes
from piezomat.scene.sections import Solver
from piezomat.solver import coarse_space as boxes
from piezomat.solver.condensation import Condensation

# Largest three-dimensional model that is factorized. Multigrid costs less from 6,000 unknowns (two crossed fibers, five
# steps, linear solves: 0.5 s against 0.7; 3.6 s against 6 at 18,000; 18 s against 51 at 77,000); factors are exact.
DIRECT_LIMIT_3D = 10_000
# The same where bodies are loose, held by contact alone: where fibers are slender factors cost little (a mat of 88,000
# unknowns: 0.5 s a solve).
LOOSE_LIMIT_3D = 100_000
# Most unknowns of the contact's candidates, whose dense matrix is factorized in each iteration: more in large models.
CONDENSED_LIMIT, CONDENSED_SHARE, CONDENSED_ALWAYS = 5_000, 0.2, 500
START_TOLERANCE = 0.1  # of the linear solve that gives Newton's method its start value
POLISH_TOLERANCE = 1e-3  # of the linear solve after Newton's method, where a part is held by next to nothing
# Of every linear solve where bodies are loose: what moves them is a small part of the forces. With fewer digits
# Newton's method takes half as many iterations again, each with a contact evaluation.
LOOSE_TOLERANCE = 1e-4
AGED = 1.5  # growth of the Krylov iterations a digit that has a preconditioner made anew


def direct_limit_3d(model: Model) -> int:
    """Most unknowns that are factorized in 3D."""
    return LOOSE_LIMIT_3D if model.has_unconstrained_bodies else DIRECT_LIMIT_3D


def is_direct(model: Model, keys: Solver) -> bool:
    """Whether the linear systems are factorized: in 2D, and in 3D as long as that is cheap, unless told otherwise."""
    if keys.kind != "auto":
        return keys.kind == "direct"
    return model.dim == 2 or model.unknowns.total <= direct_limit_3d(model)


def linear_solver(problem: Problem, keys: Solver) -> Direct | Multigrid:
    """The solver that suits a problem, unless the scene's [solver] asks for another."""
    return (Direct if is_direct(problem.model, keys) else Multigrid)(problem, keys)


class _Operator:
    """The tangent of a problem's last linearization, its fixed unknowns eliminated, as PETSc's shell matrix."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self._free = problem.state.duplicate()
        sizes = problem.state.getSizes()
        self.matrix = PETSc.Mat().createPython((sizes, sizes), self, comm=problem.comm)
        self.matrix.setUp()

    def close(self) -> None:
        """Part from PETSc's matrix: each holds the other."""
        self.matrix.destroy()

    def mult(self, matrix: PETSc.Mat, x: PETSc.Vec, result: PETSc.Vec) -> None:
        """result = tangent times x."""
        fixed = self.problem.model.constraints.fixed
        x.copy(self._free)
        self._free.array[fixed] = 0.0
        self.problem.multiply(self._free, result)
        result.array[fixed] = x.array_r[fixed]


class Direct:
    """Factorizations: of the whole tangent, or once of its constant bulk and then of the contact's share alone."""

    failure = "the tangent matrix is singular: something can move, or charge up, without resistance"
    start_tolerance = close_tolerance = None

    def __init__(self, problem: Problem, keys: Solver) -> None:
        self.problem = problem
        own_choice = any(name.startswith(("pc_", "mat_")) for name in keys.petsc)
        constant = problem.contact is not None and problem.bulk.is_constant and problem.is_symmetric
        self.condensation: Condensation | None = Condensation(problem) if constant and not own_choice else None
        self._operator = _Operator(problem)
        self._matrix: PETSc.Mat | None = None

    def close(self) -> None:
        """Part from PETSc's objects, which hold this one. Ends its use."""
        self._operator.close()
        self._pc.destroy()

    def options(self) -> dict[str, Any]:
        """PETSc options, with SNES's prefix to come."""
        return {"mat_mumps_icntl_14": 60}  # room for pivots

    def attach(self, ksp: PETSc.KSP) -> None:
        """Set up SNES's Krylov solver."""
        ksp.setType(PETSc.KSP.Type.PREONLY)
        self._pc = ksp.getPC()
        if self.condensation is not None:
            self._pc.setType(PETSc.PC.Type.PYTHON)
            self._pc.setPythonContext(self)
        else:
            self._factorize_all()

    def linearize(self, x: PETSc.Vec) -> tuple[PETSc.Mat, PETSc.Mat]:
        """Take up the tangent at x: the operator, and what its preconditioner is made from."""
        self.problem.linearize(x)
        if self.condensation is not None:
            with self.problem.timer("linear_solve"):
                share = max(CONDENSED_SHARE * self.problem.model.unknowns.total, CONDENSED_ALWAYS)
                few = self.condensation.update(min(CONDENSED_LIMIT, share))
            if few:
                return self._operator.matrix, self._operator.matrix
            self.condensation = None
            self._factorize_all()
        self._matrix, _ = self.problem.tangent()
        return self._matrix, self._matrix

    def apply(self, pc: PETSc.PC, right: PETSc.Vec, result: PETSc.Vec) -> None:
        """Solve the condensed system: PETSc's shell preconditioner, an exact one."""
        self.condensation.solve(right, result)

    def _factorize_all(self) -> None:
        # LDL^T of the symmetric tangent takes half the work of LU; both can pivot on its negative block.
        self._pc.setType(PETSc.PC.Type.CHOLESKY if self.problem.is_symmetric else PETSc.PC.Type.LU)
        self._pc.setFactorSolverType("mumps")


class Multigrid:
    """FGMRES with algebraic multigrid, made for one tangent and kept as long as it serves for the next ones.

    Newton's method asks for no more digits than it can use (Eisenstat and Walker 1996), unless the scene says how many.
    Bodies that contact alone holds hang on few points that come and go: for them it is made for each tangent, and that
    of the displacements has the coarse space of `boxes`.
    """

    failure = ""
    condensation = None
    start_tolerance: float | None = START_TOLERANCE
    close_tolerance: float | None

    def __init__(self, problem: Problem, keys: Solver) -> None:
        self.problem = problem
        self._operator = _Operator(problem)
        self._rigid = _near_nullspace(problem.model, problem.comm)
        self._loose = problem.model.has_unconstrained_bodies
        self._interpolation: PETSc.Mat | None = None
        self._matrix: PETSc.Mat | None = None
        self._rate = 0.0  # Krylov iterations a digit in the first solve with the present preconditioner
        self.close_tolerance = min(1e-8, 0.1 * keys.tolerance) if problem.is_linear else POLISH_TOLERANCE
        self._inexact = "ksp_rtol" not in keys.petsc and not self._loose
        if "ksp_rtol" in keys.petsc:
            self.start_tolerance = self.close_tolerance = None
        elif self._loose:
            self.start_tolerance = LOOSE_TOLERANCE

    def close(self) -> None:
        """Part from PETSc's objects, which hold this one. Ends its use."""
        self._operator.close()

    def options(self) -> dict[str, Any]:
        """PETSc options, with SNES's prefix to come."""
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
        start = model.unknowns.space.dofmap.index_map.local_range[0]
        nodes = np.arange(start, start + model.unknowns.owned)
        d, block = model.dim, model.unknowns.block
        displacement = (nodes[:, None] * block + np.arange(d)).ravel().astype(PETSc.IntType)
        u = PETSc.IS().createGeneral(displacement, comm=self.problem.comm)
        u.setBlockSize(d)
        u.compose("nearnullspace", self._rigid)
        phi = PETSc.IS().createGeneral((nodes * block + d).astype(PETSc.IntType), comm=self.problem.comm)
        self._displacements = u
        pc = ksp.getPC()
        pc.setType(PETSc.PC.Type.FIELDSPLIT)
        pc.setFieldSplitIS(("u", u), ("phi", phi))

    def linearize(self, x: PETSc.Vec) -> tuple[PETSc.Mat, PETSc.Mat]:
        """Take up the tangent at x: the operator, and what its preconditioner is made from."""
        self.problem.linearize(x)
        if self._matrix is None or self._loose or self._has_aged():
            self._matrix, fresh = self.problem.tangent()
            if fresh and not self.problem.model.electric:
                self._matrix.setNearNullSpace(self._rigid)
            if self._loose and fresh:
                self._interpolate()
            self._rate = 0.0
        return self._matrix if self._loose else self._operator.matrix, self._matrix

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
            self._interpolation = boxes.interpolation(model, stiffness)
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
        """Smoothed aggregation for each field; that of the displacements knows rigid bodies, or boxes of loose ones."""
        # Point smoothers only: the coarse grids have empty rows where unknowns are fixed, which SOR cannot divide by.
        smoother = {"mg_levels_ksp_max_it": 3, "mg_levels_pc_type": "jacobi"}
        amg = {"pc_type": "gamg", "pc_gamg_threshold": 0.02} | smoother
        of_displacements = boxes.options(symmetric=self.problem.is_symmetric) | smoother if self._loose else amg
        if not self.problem.model.electric:
            return of_displacements
        split: dict[str, Any] = {"pc_type": "fieldsplit", "pc_fieldsplit_type": "multiplicative"}
        for part, multigrid in (("u", of_displacements), ("phi", amg)):
            split |= {f"fieldsplit_{part}_ksp_type": "preonly"}
            split |= {f"fieldsplit_{part}_{name}": value for name, value in multigrid.items()}
        return split


def _near_nullspace(model: Model, comm: MPI.Comm) -> PETSc.NullSpace:
    x = model.unknowns.coordinates[: model.unknowns.owned]
    modes: NDArray[np.float64] = rigid_modes(x)
    vectors = []
    for k in range(modes.shape[2]):
        vector = PETSc.Vec().createMPI((model.unknowns.owned * model.dim, None), bsize=model.dim, comm=comm)
        vector.array[:] = modes[:, :, k].ravel()
        vectors.append(vector)
    for i, vector in enumerate(vectors):
        for other in vectors[:i]:
            vector.axpy(-vector.dot(other), other)
        vector.normalize()
    return PETSc.NullSpace().create(vectors=vectors, comm=comm)
