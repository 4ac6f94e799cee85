"""Coarse space of unconstrained bodies: it contains their rigid motions, and the bodies slide on each other."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.assembly.problem import Problem
from piezomat.assembly.terms import Terms
from piezomat.contact.setup import interfaces_of
from piezomat.discretization.model import Model
from piezomat.discretization.rigid_bodies import rigid_modes
from piezomat.meshes.body_mesh import create
from piezomat.scene import Scene
from piezomat.simulation import run
from piezomat.solver import coarse_space
from piezomat.usage import Timer


def pile(count: int, **solver: Any) -> Scene:
    """Blocks on each other between planes, held sideways at one face each: no friction keeps them from sliding up."""
    return Scene(
        title="a pile",
        geometry={
            "shape": "stacked_blocks",
            "width": 1.5,
            "depth": 0.5,
            "height": [0.4] * count,
            "divisions": [[9, 4, 3], [7, 4, 2]] * (count // 2),
        },
        mesh={"cells": "tensor"},
        materials={"soft": {"young": 1000.0, "poisson": 0.3}},
        bodies={"*": "soft"},
        boundaries=[
            {"on": "left", "displacement": [0, "free", "free"]},
            {"on": "front", "displacement": ["free", 0, "free"]},
        ],
        planes=[
            {"name": "floor", "point": "bottom"},
            {"name": "lid", "point": "top", "motion": [0, 0, -0.02 * count], "follows": "press"},
        ],
        contact={},
        load={"steps": [2], "factors": {"press": [1.0]}},
        solver=solver,
        output={"fields": "none", "picture": False},
    )


@pytest.mark.mpi
def test_the_coarse_space_holds_rigid_motions_of_each_body(comm: MPI.Comm) -> None:
    scene = pile(2)
    free = Scene(**{**scene.model_dump(exclude_unset=True), "boundaries": []})
    model = Model(free, create(comm, free.geometry, free.sizes))
    problem = Problem(model, Terms.of(model, interfaces_of(model)), Timer())
    coarse = coarse_space.interpolation(model, problem.bulk_stiffness())
    assert coarse.size[1] < 0.5 * coarse.size[0]
    ksp = _conjugate_gradients(coarse.transposeMatMult(coarse))  # of the normal equations: the nearest coarse function
    for part in range(2):
        owned = model.unknowns.owned
        modes = rigid_modes(model.unknowns.coordinates[:owned])
        modes *= (model.parts.node_part[:owned] == part)[:, None, None]
        for k in range(modes.shape[2]):
            mode, rest, found = coarse.createVecLeft(), coarse.createVecLeft(), coarse.createVecRight()
            mode.array[:] = modes[:, :, k].ravel()
            right = coarse.createVecRight()
            coarse.multTranspose(mode, right)
            ksp.solve(right, found)
            coarse.mult(found, rest)
            rest.axpy(-1.0, mode)
            assert rest.norm() < 1e-6 * mode.norm()
    problem.close()


def _conjugate_gradients(matrix: PETSc.Mat) -> PETSc.KSP:
    ksp = PETSc.KSP().create(matrix.comm)
    ksp.setOperators(matrix)
    ksp.setType(PETSc.KSP.Type.CG)
    ksp.getPC().setType(PETSc.PC.Type.JACOBI)
    ksp.setTolerances(rtol=1e-12, max_it=2000)
    return ksp


@pytest.mark.mpi
@pytest.mark.parametrize("count", [2, 8])
def test_krylov_iterations_do_not_grow_with_the_number_of_bodies(comm: MPI.Comm, count: int) -> None:
    history = run(pile(count, kind="iterative"), comm).history
    exact = run(pile(count, kind="direct"), comm).history
    for row, other in zip(history, exact, strict=True):
        assert row["krylov"] <= 15 * row["newton"]
        assert row["force_z@lid"] == pytest.approx(other["force_z@lid"], rel=1e-6)


def test_a_scene_may_choose_another_multigrid(monkeypatch: pytest.MonkeyPatch) -> None:
    aggregated = run(pile(2, kind="iterative"), MPI.COMM_SELF).history[-1]
    monkeypatch.setattr(coarse_space, "interpolation", None)  # what is not called cannot fail
    found = run(pile(2, kind="iterative", petsc={"pc_type": "gamg"}), MPI.COMM_SELF).history[-1]
    assert np.isfinite(found["force_z@lid"])
    assert found["force_z@lid"] == pytest.approx(aggregated["force_z@lid"], rel=1e-6)
