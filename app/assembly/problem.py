"""The nonlinear problem of one load level: the sum of its terms.

While all assembled terms are constant, their residual is one matrix times the state. Terms with a tangent that changes
places, such as contact, give it as matrices of groups of nodes, which are added to that matrix.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from dolfinx.fem import Function
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.assembly.node_groups import joined_blocks, joined_groups
from piezomat.assembly.tangent_matrix import TangentMatrix
from piezomat.assembly.terms import Terms
from piezomat.discretization.evaluation_mode import COMPLETE, EvaluationMode
from piezomat.discretization.model import Model
from piezomat.discretization.state import ReadPoints, SavedHistory, State
from piezomat.forms.arrays import Array, Integers
from piezomat.meshes import parallel
from piezomat.usage import Timer, give_back_memory

ROUNDING = 1e-12  # of the potential of a strain of one


# result = residual with reactions at x of the assembled terms.
AssembledResidual = Callable[[PETSc.Vec, PETSc.Vec], None]


class Problem:
    """Residual and tangent of a model at given load factors, for Newton's method. Every method is collective.

    The state x solves, where it is not fixed,

        R(x) = sum of the terms' residuals = 0.

    model: what is solved
    state: x
    converged_state: x_n
    factors: load factors of the present load level
    prescribed_values (k,): of the fixed unknowns at the present load level, in the order of `Constraints.fixed`
    residual_with_reactions: R at the last `residual`; at fixed unknowns the reactions less the loads there
    stiffness_version: number of times that the tangent of the assembled terms has changed
    is_constant: whether that tangent is the same at any state
    is_symmetric: whether the tangent is symmetric
    is_linear: whether one linear solve is enough
    largest_force, uN (2D: per um of depth): forces of a strain of one, and of a penetration as large as the coordinates
        that gaps are computed from; rounding is a share of it
    """

    def __init__(self, model: Model, terms: Terms, timer: Timer) -> None:
        """terms: what is summed."""
        self.model = model
        self._terms = terms
        self.timer = timer
        self.comm: MPI.Comm = model.comm
        self.state = model.new_vector()
        self.converged_state = model.new_vector()
        self.residual_with_reactions = model.new_vector()
        self.factors = dict.fromkeys(model.scene.load.factors, 0.0)
        self.prescribed_values = np.zeros(len(model.constraints.fixed))
        with timer("assembly"):
            self._stiffness = terms.new_matrix()  # of the assembled terms
            self._assemble_stiffness()
        self.is_constant = all(term.is_constant for term in terms.assembled)
        self.is_symmetric = all(term.is_symmetric for term in terms)
        self._matrix: TangentMatrix | None = None
        self._work = model.new_vector()  # a new one in each iteration would stay until garbage is collected
        self.stiffness_version = 0
        self.is_linear = not terms.blocks and self.is_constant
        length = float(model.parts.size.max())
        stiffest = max(term.largest_penalty for term in terms)
        self.largest_force = length ** (model.dim - 1) * (model.stiffness + stiffest * length)

    # --- load steps

    def set_loads(self, factors: dict[str, float]) -> None:
        """Go to a load level: loads, planes, and prescribed values, which Newton's start value takes up."""
        for term in self._terms:
            term.set_loads(factors)
        self.prescribed_values = self.model.constraints.values(factors)
        self.factors = dict(factors)

    def begin_step(self, margin: float) -> None:
        """Take the present state for the converged one, and detect what acts on what, see `pair`."""
        self.collect_garbage()
        self.pair(margin)
        self.state.copy(self.converged_state)
        for term in self._terms:
            term.begin_step(self.converged_state)

    def return_to_converged_state(self) -> None:
        """Give the unknowns the values of the last converged state; load level and histories stay."""
        self.converged_state.copy(self.state)
        for term in self._terms:
            term.begin_step(self.converged_state)

    def commit(self) -> None:
        """Advance the histories of the terms: the last evaluation is the end of a part of a step that has converged."""
        for term in self._terms:
            term.commit()

    def copy_state(self) -> State:
        """The present unknowns and load level, with the histories of the last converged part of a step."""
        return State(self.state.array_r.copy(), self.factors, tuple(term.history() for term in self._terms))

    def restore(self, state: State) -> None:
        """Return to a state. What is detected and evaluated is then still that of another one."""
        self.state.array[:] = state.unknowns
        self.set_loads(dict(state.factors))
        for term, history in zip(self._terms, state.histories, strict=True):
            term.restore(history)

    def saved_histories(self) -> SavedHistory:
        """The histories of the terms for a checkpoint."""
        points, scalars = {}, {}
        for term in self._terms:
            saved = term.saved()
            points |= saved.points
            scalars |= saved.scalars
        return SavedHistory(points, scalars)

    def resume(self, factors: dict[str, float], read: ReadPoints, scalars: Mapping[str, float]) -> None:
        """Take up a load level and the histories of a checkpoint; the unknowns are written to `state`."""
        self.set_loads(factors)
        for term in self._terms:
            term.resume(read, scalars)

    def pair(self, margin: float) -> None:
        """Detect what acts on what at the present state, such as contact, with a search radius `margin` (um)."""
        for term in self._terms.blocks:
            with self.timer(term.phase):
                term.detect(self.state, margin)
        if self._terms.blocks and self._matrix is not None:
            self._matrix.forget_pattern()

    def prescribed_change(self) -> PETSc.Vec:
        """Change of the fixed unknowns, and of those tied to them, to this load level, zero elsewhere; a new vector."""
        change = self.model.new_vector()
        fixed = self.model.constraints.fixed
        change.array[fixed] = self.prescribed_values - self.state.array_r[fixed]
        self.model.constraints.expand(change)
        return change

    def take_prescribed_values(self) -> None:
        """Give the fixed unknowns of the state their values at this load level, and the tied ones those they equal."""
        constraints = self.model.constraints
        self.state.array[constraints.fixed] = self.prescribed_values
        constraints.expand(self.state)

    def change_tangent(self, change: Callable[[PETSc.Mat], None]) -> None:
        """Let a constant term change: `change` adds the difference to the matrix of all assembled terms."""
        change(self._stiffness)
        self._renew_stiffness()

    # --- residual

    def residual(
        self,
        x: PETSc.Vec,
        result: PETSc.Vec,
        mode: EvaluationMode = COMPLETE,
        assembled: AssembledResidual | None = None,
    ) -> None:
        """result = T^T R(x), zero at the eliminated unknowns, not a number where a term cannot be evaluated.

        Sets `residual_with_reactions`. assembled: what evaluates the residual of the assembled terms; None: they do.
        """
        with self.timer("assembly"):
            (assembled or self._assembled_residual)(x, self.residual_with_reactions)
        for term in self._terms.blocks:
            with self.timer(term.phase):
                term.add_residual(x, self.residual_with_reactions, mode)
        self.residual_with_reactions.copy(result)
        self.model.constraints.reduce(result)

    def bulk_residual(self, x: PETSc.Vec) -> PETSc.Vec:
        """Residual with reactions at x of the assembled terms, as `residual_with_reactions` then is; a new vector."""
        self._assembled_residual(x, self.residual_with_reactions)
        return self.residual_with_reactions.copy()

    def external_forces(self) -> Array:
        """Norms, as `Unknowns.norms`, of the external forces at the last `residual`: reactions, loads, rigid planes."""
        self.residual_with_reactions.copy(self._work)
        self._work.scale(-1.0)
        for term in self._terms:
            term.add_external_forces(self._work)
        return self.model.unknowns.norms(self._work)

    def _assembled_residual(self, x: PETSc.Vec, result: PETSc.Vec) -> None:
        if self.is_constant:
            self._stiffness.mult(x, result)
            for term in self._terms.assembled:
                term.add_constant_residual(result)
            return
        self.model.set_trial_state(x)
        result.set(0.0)
        for term in self._terms.assembled:
            term.add_residual(x, result)

    # --- tangent

    def linearize(self, x: PETSc.Vec, mode: EvaluationMode = COMPLETE) -> None:
        """Take the tangent at x for `multiply`, `tangent`, `blocks` and `linearized_block_residual`."""
        if not self.is_constant:
            with self.timer("assembly"):
                self.model.set_trial_state(x)
                self._assemble_stiffness()
                self._renew_stiffness()
        for term in self._terms.blocks:
            with self.timer(term.phase):
                term.linearize(x, mode)

    def tangent(self) -> tuple[PETSc.Mat, bool]:
        """The tangent T^T K T as a matrix, and whether its pattern differs from the last."""
        nodes, matrices = self.blocks()
        reserve = joined_groups([term.reserve() for term in self._terms.blocks])
        with self.timer("assembly"):
            if self._matrix is None:
                self._matrix = self._new_matrix()
            matrix, fresh = self._matrix.assemble(nodes, matrices, reserve)
            self._matrix.eliminate()
        return matrix, fresh

    def blocks(self) -> tuple[Integers, Array]:
        """The tangent of the block terms: global nodes (k, n) of each group here, its matrix (k, n b, n b)."""
        return joined_blocks([term.blocks() for term in self._terms.blocks], self.model.unknowns.block)

    def bulk_stiffness(self) -> PETSc.Mat:
        """The tangent T^T K T of the assembled terms; a new matrix."""
        if self.model.constraints.ties:
            without = self._new_matrix()
            none = np.zeros((0, 1), np.int64), np.zeros((0, without.block, without.block))
            bulk, _ = without.assemble(*none, none[0])
        else:
            bulk = self._stiffness.copy()
        self.model.constraints.eliminate(bulk)
        return bulk

    def _new_matrix(self) -> TangentMatrix:
        model = self.model
        return TangentMatrix(self.comm, self._stiffness, model.unknowns.block, model.constraints)

    def multiply(self, change: PETSc.Vec, result: PETSc.Vec) -> None:
        """result = tangent K times a change of all unknowns, none eliminated."""
        self._stiffness.mult(change, result)
        for term in self._terms.blocks:
            term.add_product(change, result)

    def linearized_block_residual(self, change: PETSc.Vec, result: PETSc.Vec) -> None:
        """result = residual of the block terms plus their tangent times a change of the state."""
        result.set(0.0)
        for term in self._terms.blocks:
            term.add_linearized_residual(result)
            term.add_product(change, result)

    def _assemble_stiffness(self) -> None:
        """The tangent of the assembled terms at the model's state."""
        self._stiffness.zeroEntries()
        for term in self._terms.assembled:
            term.add_tangent(self._stiffness)

    def _renew_stiffness(self) -> None:
        self.stiffness_version += 1
        if self._matrix is not None:
            self._matrix.set_bulk(self._stiffness)

    # --- measures of the state

    def energies(self, x: PETSc.Vec) -> dict[str, float]:
        """Energies of all terms at x, where the residual was evaluated last, by name, pJ (2D: per um of depth)."""
        total: dict[str, float] = {}
        for term in self._terms:
            for name, value in term.energies(x).items():
                total[name] = total.get(name, 0.0) + value
        return total

    def potential_range(self) -> float:
        """Range of the potential over the model, V, or the rounding of one."""
        scale = self.model.potential_scale
        if scale is None:
            return 1.0
        values = scale * self.model.unknowns.potentials(self.state)
        ends = np.array([values.max(initial=-np.inf), -values.min(initial=np.inf)])
        return max(float(parallel.largest(self.comm, ends).sum()), ROUNDING * scale)

    def motion(self, since: PETSc.Vec | None = None) -> float:
        """Largest component of a node's displacement since an earlier state, or the last converged one, um."""
        displacements = self.model.unknowns.displacements
        change = displacements(self.state) - displacements(self.converged_state if since is None else since)
        return self.comm.allreduce(float(np.abs(change).max(initial=0.0)), op=MPI.MAX)

    def travel(self, since: PETSc.Vec | None = None) -> float:
        """Longest travel of a plane by force since an earlier state, or the last converged one, um."""
        travels = self.model.constraints.travels
        change = travels.values(self.state) - travels.values(self.converged_state if since is None else since)
        return float(np.abs(change).max(initial=0.0))

    def solution(self) -> Function:
        """The state as a Function, ghosts included, until forms are evaluated at another state."""
        self.model.set_trial_state(self.state)
        return self.model.trial_state

    # --- memory

    def collect_garbage(self) -> None:
        """Destroy the PETSc objects that Python no longer holds: petsc4py waits until all ranks do so together."""
        PETSc.garbage_cleanup(self.comm)
        PETSc.garbage_cleanup(self.state.comm.tompi4py())
        PETSc.garbage_cleanup(MPI.COMM_SELF)
        give_back_memory()

    def close(self) -> None:
        """Destroy the matrices; state and terms can still be looked at."""
        tangent = self._matrix.matrix if self._matrix is not None else None
        for matrix in (self._stiffness, tangent):
            if matrix is not None:
                matrix.destroy()
        self.collect_garbage()
