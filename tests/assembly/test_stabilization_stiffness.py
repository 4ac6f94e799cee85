"""Stabilization stiffness: springs on parts that no boundary constrains, and what they bear."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.assembly.stabilization_stiffness import RELATIVE_STIFFNESS, StabilizationStiffness
from piezomat.discretization.model import Model
from tests.discretization.models import HEIGHT, WIDTH, blocks

pytestmark = pytest.mark.mpi


def lifted(model: Model, height: float) -> PETSc.Vec:
    """All nodes moved up by this much."""
    values = np.zeros((model.unknowns.owned, model.unknowns.block))
    values[:, 1] = height
    vector = model.new_vector()
    vector.array[:] = values.ravel()
    return vector


def test_springs_of_a_volume_bear_a_rigid_motion(comm: MPI.Comm) -> None:
    """Of the upper block alone: force, work and share of the load, from the volume and the stiffness."""
    model = blocks(comm, boundaries=[{"on": "bottom", "displacement": [0, 0], "potential": 0}])
    springs = StabilizationStiffness(model)
    assert springs.is_active
    material = model.materials[1]
    stiffness = RELATIVE_STIFFNESS * material.mean_stiffness / model.parts.size[1] ** 2 * WIDTH * HEIGHT
    state, residual = lifted(model, 0.2), model.new_vector()
    springs.add_residual(state, residual)
    upper = model.parts.node_part[: model.unknowns.owned] == 1
    forces = model.unknowns.displacements(residual)
    assert not forces[~upper].any() and not forces[:, 0].any()
    assert comm.allreduce(forces[:, 1].sum()) == pytest.approx(0.2 * stiffness)
    assert springs.work(state) == pytest.approx(0.2**2 * stiffness)
    loads = lifted(model, 0.0)
    assert springs.load_share(state, loads) == 0.0
    loads.array[:] = residual.array_r
    loads.scale(-4.0)
    assert springs.load_share(state, loads) == pytest.approx(0.25)


def test_residual_tangent_and_factor_agree(comm: MPI.Comm) -> None:
    """Matrix times state plus the constant part is the residual, at any factor, and zero at the converged state."""
    model = blocks(comm)
    converged = lifted(model, 0.1)
    springs = StabilizationStiffness(model)
    springs.begin_step(converged)
    matrix = PETSc.Mat().createAIJ((converged.getSizes(), converged.getSizes()), nnz=1, comm=comm)
    matrix.setUp()
    first, last = matrix.getOwnershipRange()
    for row in range(first, last):
        matrix.setValue(row, row, 0.0)
    matrix.assemble()
    springs.add_tangent(matrix)
    springs.set_factor(100.0, matrix)
    state = lifted(model, -0.3)
    state.array[:] += np.random.default_rng(comm.rank).standard_normal(len(state.array_r))
    split, whole, rest = matrix.createVecLeft(), model.new_vector(), model.new_vector()
    matrix.mult(state, split)
    springs.add_constant_residual(split)
    springs.add_residual(state, whole)
    springs.add_residual(converged, rest)
    np.testing.assert_allclose(split.array_r, whole.array_r, atol=1e-12 * np.abs(whole.array_r).max(initial=1e-300))
    assert whole.norm() > 0.0 and rest.norm() == 0.0


def test_parts_that_boundaries_constrain_have_no_springs(comm: MPI.Comm) -> None:
    rows = [{"on": on, "displacement": [0, 0], **given} for on, given in (("bottom", {"potential": 0}), ("top", {}))]
    model = blocks(comm, boundaries=rows)
    springs = StabilizationStiffness(model)
    state, residual = lifted(model, 0.2), model.new_vector()
    springs.add_residual(state, residual)
    assert not springs.is_active and residual.norm() == 0.0 and springs.work(state) == 0.0
