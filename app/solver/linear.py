"""The linear systems of Newton's method: which solver is chosen, and the direct one."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.contact.interfaces import Interfaces
from piezomat.discretization.evaluation_mode import COMPLETE, EvaluationMode
from piezomat.discretization.model import Model
from piezomat.scene.sections import Solver
from piezomat.solver.callbacks import CallbackErrors, callback, not_numbers
from piezomat.solver.condensation import Condensation
from piezomat.solver.equations import Equations, ReducedProblem, WholeProblem
from piezomat.solver.multigrid import Multigrid
from piezomat.solver.outcome import SINGULAR
from piezomat.solver.tangent_operator import TangentOperator

# Largest three-dimensional model that is factorized. Multigrid costs less from 6,000 unknowns (two crossed fibers, five
# steps, linear solves: 0.5 s against 0.7; 3.6 s against 6 at 18,000; 18 s against 51 at 77,000); factors are exact.
DIRECT_LIMIT_3D = 10_000
# The same with unconstrained bodies, held by contact alone: where fibers are slender factors cost little (a mat of
# 88,000 unknowns: 0.5 s a solve).
LOOSE_LIMIT_3D = 100_000
# Most candidate unknowns, whose dense matrix is factorized in each iteration: a share of the unknowns in large models.
CONDENSED_LIMIT, CONDENSED_SHARE, CONDENSED_ALWAYS = 5_000, 0.2, 500


def direct_limit_3d(model: Model) -> int:
    """Most unknowns that are factorized in 3D."""
    return LOOSE_LIMIT_3D if model.has_unconstrained_bodies else DIRECT_LIMIT_3D


def is_direct(model: Model, keys: Solver) -> bool:
    """Whether the linear systems are factorized: as [solver] says, or in 2D, and in 3D as long as that is cheap."""
    if keys.kind != "auto":
        return keys.kind == "direct"
    return model.dim == 2 or model.unknowns.total <= direct_limit_3d(model)


def linear_solver(problem: Problem, contact: Interfaces | None, keys: Solver) -> LinearSolver:
    """The solver that suits a problem, unless the scene's [solver] names another."""
    return Direct(problem, contact, keys) if is_direct(problem.model, keys) else Multigrid(problem, keys)


class Direct:
    """Factorizations: of the whole tangent, or once of its constant bulk and then of the contact's share alone.

    equations: what is solved, the problem or its reduced form.
    operators: the last tangent and the matrix that its preconditioner is made from, for PETSc's KSP.
    callback_errors: of what PETSc calls here. failure: words for a linear solve that fails.
    The tolerances are those of a Krylov solver: none.
    """

    failure = SINGULAR
    start_tolerance = close_tolerance = None
    operators: tuple[PETSc.Mat, PETSc.Mat]

    def __init__(self, problem: Problem, contact: Interfaces | None, keys: Solver) -> None:
        self.problem = problem
        chosen_by_scene = any(name.startswith(("pc_", "mat_")) for name in keys.petsc)
        self._condensation: Condensation | None = None
        if contact is not None and problem.is_constant and problem.is_symmetric and not chosen_by_scene:
            self._condensation = Condensation(problem, contact)
        self._counted = self._condensation
        self.equations: Equations = WholeProblem(problem)
        if self._condensation is not None:
            self.equations = ReducedProblem(problem, self._condensation)
        self.callback_errors = CallbackErrors()
        self._operator = TangentOperator(problem, self.callback_errors)

    @property
    def factor_solves(self) -> int:
        """Solves with the factors of a condensed bulk so far."""
        return 0 if self._counted is None else self._counted.factor_solves

    @property
    def candidates(self) -> int:
        """Number of nodes that the bulk is or was condensed to."""
        return 0 if self._counted is None else len(self._counted.candidates)

    def close(self) -> None:
        """Part from PETSc's objects, which hold this one, and free the factors. Ends its use."""
        self._operator.close()
        self._pc.destroy()
        if self._condensation is not None:
            self._condensation.close()

    def options(self) -> dict[str, Any]:
        """PETSc options, without SNES's prefix."""
        return {"mat_mumps_icntl_14": 60}  # room for pivots

    def attach(self, ksp: PETSc.KSP) -> None:
        """Set up SNES's Krylov solver."""
        ksp.setType(PETSc.KSP.Type.PREONLY)
        self._pc = ksp.getPC()
        if self._condensation is not None:
            self._pc.setType(PETSc.PC.Type.PYTHON)
            self._pc.setPythonContext(self)
        else:
            self._factorize_all()

    def linearize(self, x: PETSc.Vec, mode: EvaluationMode = COMPLETE) -> None:
        """Take the tangent at x: `operators` are then its."""
        self.problem.linearize(x, mode)
        if self._condensation is not None:
            with self.problem.timer("linear_solve"):
                share = max(CONDENSED_SHARE * self.problem.model.unknowns.total, CONDENSED_ALWAYS)
                few = self._condensation.update(min(CONDENSED_LIMIT, share))
            if few:
                self.operators = self._operator.matrix, self._operator.matrix
                return
            self._condensation.close()
            self._condensation, self.equations = None, WholeProblem(self.problem)
            self._factorize_all()
        matrix, _ = self.problem.tangent()
        self.operators = matrix, matrix

    @callback(instead=not_numbers)
    def apply(self, pc: PETSc.PC, right: PETSc.Vec, result: PETSc.Vec) -> None:
        """Solve the condensed system: PETSc's shell preconditioner, an exact one."""
        self._condensation.solve(right, result)

    def _factorize_all(self) -> None:
        # LDL^T of the symmetric tangent takes half the work of LU; both can pivot on its negative block.
        self._pc.setType(PETSc.PC.Type.CHOLESKY if self.problem.is_symmetric else PETSc.PC.Type.LU)
        self._pc.setFactorSolverType("mumps")


LinearSolver = Direct | Multigrid
