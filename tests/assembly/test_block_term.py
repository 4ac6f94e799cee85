"""A term of a user whose tangent couples two bodies: a spring between their nodes, with and without contact."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.assembly.node_groups import joined_blocks, joined_groups
from piezomat.discretization.evaluation_mode import COMPLETE, EvaluationMode
from piezomat.discretization.model import Model
from piezomat.discretization.term import BlockTerm
from piezomat.forms.arrays import Array, Integers
from piezomat.meshes.ghost_scatter import GhostScatter
from piezomat.scene import Scene
from piezomat.simulation import run

STIFFNESS, YOUNG, PULL = 300.0, 1000.0, 0.01


class Spring(BlockTerm):
    """A spring in the last direction between the nodes at the middle of two facing surfaces; rank 0 evaluates it."""

    def __init__(self, model: Model) -> None:
        d, unknowns = model.dim, model.unknowns
        x = unknowns.coordinates[: unknowns.owned] + model.unknowns.origin
        middle = unknowns.first_node + np.flatnonzero((np.abs(x[:, 0] - 0.5) < 1e-9) & (np.abs(x[:, 1] - 0.5) < 0.06))
        ends = np.sort(np.concatenate(model.comm.allgather(middle)))
        assert len(ends) == 2
        self._nodes = ends[None] if model.comm.rank == 0 else np.zeros((0, 2), np.int64)
        numbers = (self._nodes * unknowns.block + d - 1).ravel().astype(PETSc.IntType)
        self._scatter = GhostScatter(model.new_vector(), PETSc.IS().createGeneral(numbers, comm=MPI.COMM_SELF))
        self._row = np.zeros(2 * unknowns.block)
        self._row[[d - 1, unknowns.block + d - 1]] = [-1.0, 1.0]
        self._comm, self._change = model.comm, 0.0

    def detect(self, x: PETSc.Vec, radius: float) -> None:
        """Nothing: a spring stays where it is."""

    def _stretch(self, x: PETSc.Vec) -> Array:
        ends = self._scatter.gather(x).reshape(-1, 2)
        return ends[:, 1] - ends[:, 0]

    def _add(self, stretch: Array, result: PETSc.Vec) -> None:
        self._scatter.add((STIFFNESS * stretch[:, None] * [-1.0, 1.0]).ravel(), result)

    def add_residual(self, x: PETSc.Vec, result: PETSc.Vec, mode: EvaluationMode = COMPLETE) -> None:
        self._add(self._stretch(x), result)

    def linearize(self, x: PETSc.Vec, mode: EvaluationMode = COMPLETE) -> None:
        self._at = self._stretch(x)

    def blocks(self) -> tuple[Integers, Array]:
        return self._nodes, np.tile(STIFFNESS * np.outer(self._row, self._row), (len(self._nodes), 1, 1))

    def reserve(self) -> Integers:
        return self._nodes

    def add_linearized_residual(self, result: PETSc.Vec) -> None:
        self._add(self._at, result)

    def add_product(self, change: PETSc.Vec, result: PETSc.Vec) -> None:
        self._add(self._stretch(change), result)

    def energies(self, x: PETSc.Vec) -> dict[str, float]:
        mine = float((0.5 * STIFFNESS * self._stretch(x) ** 2).sum())
        return {"spring": self._comm.allreduce(mine)}


@pytest.mark.mpi
@pytest.mark.parametrize("solver", [{}, {"kind": "iterative"}], ids=["direct", "multigrid"])
@pytest.mark.parametrize("contact", [True, False])
def test_a_spring_couples_two_bodies(contact: bool, solver: dict[str, str], comm: MPI.Comm) -> None:
    """The force of the spring is that on both boundaries, and its work is stored, condensed to its nodes or not."""
    scene = Scene(
        geometry={"shape": "stacked_blocks", "height": [0.5, 0.5], "divisions": [[4, 2], [4, 2]], "gap": 0.02},
        materials={"soft": {"young": YOUNG, "poisson": 0.0}},
        bodies={"lower": "soft", "upper": "soft"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": [0, PULL], "follows": "pull"},
        ],
        contact={} if contact else None,
        load={"factors": {"pull": [1.0]}, "steps": [1]},
        solver=solver,
    )
    found = run(scene, comm, terms=[Spring])
    row, energies = found.history[-1], found.problem.energies(found.problem.state)
    force = row["force_y@top"]
    assert force > 0.1 * STRETCHED and row["force_y@bottom"] == pytest.approx(-force, rel=1e-6)
    assert force == pytest.approx(np.sqrt(2.0 * STIFFNESS * energies["spring"]), rel=1e-6)
    assert energies["elastic"] + energies["spring"] == pytest.approx(0.5 * force * PULL, rel=1e-6)


STRETCHED = STIFFNESS * PULL


def test_groups_of_different_sizes_are_joined(rng: np.random.Generator) -> None:
    groups = [np.array([[3, 5]]), np.array([[1, 2, 7], [4, 6, 8]])]
    matrices = [rng.standard_normal((len(nodes), 2 * nodes.shape[1], 2 * nodes.shape[1])) for nodes in groups]
    nodes, joined = joined_blocks(list(zip(groups, matrices, strict=True)), 2)
    np.testing.assert_array_equal(nodes, [[3, 5, 3], [1, 2, 7], [4, 6, 8]])
    np.testing.assert_array_equal(joined_groups(groups), nodes)
    np.testing.assert_array_equal(joined[0, :4, :4], matrices[0][0])
    assert not joined[0, 4:].any() and not joined[0, :, 4:].any()
    np.testing.assert_array_equal(joined[1:], matrices[1])
