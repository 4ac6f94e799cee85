"""Unknowns tied to one scalar unknown, in whole solves: against an elimination done densely.

The dense side knows nothing of `Ties`: it finds the tied and the fixed unknowns by the places of their nodes, takes the
tangent of all unknowns column by column, and solves with T^T K T.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.solver.linear_solve import solve
from piezomat.solver.load_steps import steps
from tests.marching import stepper_of
from tests.scenes import pressed

SOLVERS: dict[str, dict[str, Any]] = {
    "condensed": {},
    "factorized": {"petsc": {"pc_type": "lu"}},
    "multigrid": {"kind": "iterative", "petsc": {"ksp_rtol": 1e-13}},
}
EXACT = 1e-10


def whole(comm: MPI.Comm, vector: PETSc.Vec) -> Array:
    """All values of a distributed vector, on all ranks."""
    return np.concatenate(comm.allgather(vector.array_r.copy()))


def constraints_by_place(problem: Problem) -> tuple[Integers, Booleans]:
    """Image (n,) of each unknown, itself unless it is tied to the lid's potential, and which (n,) are fixed."""
    unknowns, comm = problem.model.unknowns, problem.comm
    height = np.concatenate(comm.allgather(unknowns.coordinates[: unknowns.owned, -1]))
    bottom, top = (np.flatnonzero(np.abs(height - end) < 1e-9) for end in (height.min(), height.max()))
    size = unknowns.total + unknowns.block  # one reference node after all others
    image, fixed = np.arange(size), np.zeros(size, bool)
    image[top * unknowns.block + unknowns.dim] = size - 1
    for component in range(unknowns.dim):
        fixed[np.concatenate([bottom, top]) * unknowns.block + component] = True
    fixed[bottom * unknowns.block + unknowns.dim] = True
    fixed[unknowns.total : size - 1] = True  # the electrode moves nowhere
    return image, fixed


def dense_tangent(problem: Problem) -> Array:
    """The tangent of all unknowns, nothing eliminated."""
    column, product = problem.model.new_vector(), problem.model.new_vector()
    first, end = column.getOwnershipRange()
    columns = []
    for number in range(column.getSize()):
        column.array[:] = np.arange(first, end) == number
        problem.multiply(column, product)
        columns.append(whole(problem.comm, product))
    return np.array(columns).T


@pytest.mark.mpi
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_solve_equals_that_of_the_dense_elimination(dimension: int, solver: str, rng: np.random.Generator) -> None:
    """Fibers in contact, the top one open electrode: a load at every unknown, in the tangent of the last state."""
    comm = MPI.COMM_WORLD
    rows = pressed(dimension).model_dump(exclude_none=True)["boundaries"]
    rows = [{**row, "displacement": [0.0] * (dimension - 1) + [end]} for row, end in zip(rows, (0, -0.04), strict=True)]
    keys: dict[str, Any] = {"mesh": {"size": 0.5, "contact_size": 0.3}, "boundaries": rows}
    keys |= {"electrodes": [{"name": "lid", "on": ["top"]}], "solver": {"tolerance": 1e-9, **SOLVERS[solver]}}
    with stepper_of(pressed(dimension, **keys), comm) as stepper:
        for step in steps(stepper.problem.model.scene.load):
            stepper.advance(step, lambda part: None)
        problem, contact, newton = stepper.problem, stepper.terms.contact, stepper.newton.newton
        image, fixed = constraints_by_place(problem)
        left = np.flatnonzero(~fixed & (image == np.arange(len(image))))
        transform = np.eye(len(image))[image][:, left]
        newton.linear.linearize(problem.state)
        right, result = problem.model.new_vector(), problem.model.new_vector()
        right.array[:] = rng.standard_normal(len(image))[slice(*right.getOwnershipRange())]
        load = transform.T @ whole(comm, right)
        expected = transform @ np.linalg.solve(transform.T @ dense_tangent(problem) @ transform, load)
        problem.model.constraints.reduce(right)
        solve(problem, newton.linear, newton.snes, right, result, 1e-13)
        found = whole(comm, result)
    assert contact.penetration() > 0.0
    scale = np.abs(expected).reshape(-1, dimension + 1).max(axis=0)
    errors = np.abs(found - expected).reshape(-1, dimension + 1).max(axis=0)
    assert (errors <= EXACT * scale).all()
