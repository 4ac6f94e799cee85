"""Coarse space of a two-level multigrid for unconstrained bodies: rigid motions of aggregates of each body.

Algebraic multigrid takes nodes of two bodies that touch for one aggregate, and then cannot tell that the bodies slide
on each other, which without friction costs nothing. Here an aggregate is the nodes of a body in one box of a
lattice. The coarse functions are its rigid motions, smoothed by the stiffness of the bodies alone (Vanek, Mandel and
Brezina, Computing 56 (1996) 179-196); contact enters through the coarse matrix, which is factorized.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from petsc4py import PETSc

from piezomat.discretization.model import Model
from piezomat.discretization.rigid_bodies import rigid_modes

AGGREGATE_NODES = 150.0  # in a box that a body fills; half as many or twice as many cost the same
RELAXATION = 4.0 / 3.0  # over the largest eigenvalue of D^-1 A
POWER_ITERATIONS, SAFETY = 12, 1.1  # how that eigenvalue is found, and by how much it may be larger
TINY = np.finfo(float).tiny
DEPENDENT = 1e-6  # singular value of an aggregate's motions, over that of a unit motion, below which one is dropped


def options(*, symmetric: bool) -> dict[str, Any]:
    """PETSc options of a multigrid whose interpolation is still to be set, and its smoother to be chosen."""
    factorization = "cholesky" if symmetric else "lu"
    coarse = {"ksp_type": "preonly", "pc_type": factorization, "pc_factor_mat_solver_type": "mumps"}
    multigrid = {"pc_type": "mg", "pc_mg_levels": 2, "pc_mg_galerkin": "both", "mg_levels_ksp_type": "chebyshev"}
    return multigrid | {f"mg_coarse_{name}": value for name, value in coarse.items()}


def interpolation(model: Model, stiffness: PETSc.Mat) -> PETSc.Mat:
    """Smoothed rigid motions of the aggregates, (displacements, coarse unknowns). Collective.

    stiffness: of the displacements, without contact, its fixed unknowns eliminated.
    """
    motions = _motions(model)
    inverse = stiffness.getDiagonal()
    inverse.reciprocal()
    smoothed = stiffness.matMult(motions)
    smoothed.diagonalScale(L=inverse)
    smoothed.scale(-RELAXATION / _largest_eigenvalue(stiffness, inverse))
    smoothed.axpy(1.0, motions)
    motions.destroy()
    return smoothed


def _aggregates(model: Model) -> list[NDArray[np.int64]]:
    """This rank's nodes in each box of each part of the model."""
    unknowns, parts = model.unknowns, model.parts
    x, part = unknowns.coordinates[: unknowns.owned], parts.node_part[: unknowns.owned]
    edge = (AGGREGATE_NODES * parts.volume * unknowns.block / unknowns.total) ** (1.0 / model.dim)
    keys = np.column_stack([part, np.floor(x / edge).astype(np.int64)])
    _, box, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    return np.split(np.argsort(box.ravel(), kind="stable"), np.cumsum(count))[:-1]


def _motions(model: Model) -> PETSc.Mat:
    """Orthonormal rigid motions of the aggregates at the nodes, zero where a displacement is prescribed or tied.

    What moves as one by a force is an unknown of the coarse space.
    """
    unknowns, constraints = model.unknowns, model.constraints
    d, n, block = model.dim, unknowns.owned, unknowns.block
    left = np.ones((n + unknowns.references_here) * block, bool)
    left[constraints.eliminated] = False
    free = left.reshape(-1, block)[:, :d, None]
    rows, columns, values, count = [], [], [], 0
    for nodes in _aggregates(model):
        away = model.unknowns.coordinates[nodes] - model.unknowns.coordinates[nodes].mean(axis=0)
        modes = free[nodes] * rigid_modes(away / max(np.abs(away).max(), TINY))
        basis, size, _ = np.linalg.svd(modes.reshape(len(nodes) * d, -1), full_matrices=False)
        basis = basis[:, size > DEPENDENT * np.sqrt(len(nodes))]
        row = (nodes[:, None] * d + np.arange(d)).ravel()
        rows.append(np.repeat(row, basis.shape[1]))
        columns.append(np.tile(count + np.arange(basis.shape[1]), len(row)))
        values.append(basis.ravel())
        count += basis.shape[1]
    moving = constraints.motions.local
    rows.append(moving // block * d + moving % block)
    columns.append(count + np.arange(len(moving)))
    values.append(np.ones(len(moving)))
    count += len(moving)
    entries = [np.concatenate([np.zeros(0, int), *parts]) for parts in (values, rows, columns)]
    n += unknowns.references_here
    local = scipy.sparse.csr_matrix((entries[0], (entries[1], entries[2])), shape=(n * d, count))
    start = model.comm.exscan(count) or 0
    csr = local.indptr.astype(PETSc.IntType), (local.indices + start).astype(PETSc.IntType), local.data
    return PETSc.Mat().createAIJ(((n * d, None), (count, None)), csr=csr, comm=model.comm)


def _largest_eigenvalue(stiffness: PETSc.Mat, inverse: PETSc.Vec) -> float:
    """Upper estimate of the largest eigenvalue of D^-1 A, A the stiffness and D its diagonal, by the power method."""
    x, y = stiffness.createVecs()
    # Rough everywhere, and the same on any number of ranks but for the numbering.
    x.array[:] = np.random.default_rng(0).standard_normal(len(x.array))
    for _ in range(POWER_ITERATIONS):
        x.normalize()
        stiffness.mult(x, y)
        x.pointwiseMult(inverse, y)
    return SAFETY * x.norm()
