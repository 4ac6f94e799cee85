"""Constraints: what boundaries fix, at which values, and what they measure."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.discretization.model import Model
from piezomat.forms.arrays import Array
from piezomat.scene import SceneError
from tests.discretization.models import DEPTH, HEIGHT, WIDTH, blocks

pytestmark = pytest.mark.mpi

ROWS: list[dict[str, Any]] = [
    {"on": "bottom", "displacement": ["free", 0.5], "potential": 3.0},
    {"on": "left", "displacement": [0.25, "free"], "follows": "push"},
]


def prescribed(model: Model, factors: dict[str, float]) -> tuple[Array, Array]:
    """Values (owned, block) that are prescribed, not a number where none is, and coordinates (owned, 2)."""
    unknowns, constraints = model.unknowns, model.constraints
    values = np.full(unknowns.owned * unknowns.block, np.nan)
    values[constraints.fixed] = constraints.values(factors)
    values = values.reshape(unknowns.owned, unknowns.block)
    np.testing.assert_array_equal(constraints.is_fixed, ~np.isnan(values))
    return values, unknowns.coordinates[: unknowns.owned]


def test_values_follow_the_load_factor(comm: MPI.Comm) -> None:
    model = blocks(comm, boundaries=ROWS, load={"steps": [1], "factors": {"push": [1.0]}})
    values, x = prescribed(model, {"push": 2.0})
    bottom = np.isclose(x[:, 1], 0.0)
    left = np.isclose(x[:, 0], 0.0)
    np.testing.assert_array_equal(values[bottom, 1], 0.5)
    np.testing.assert_allclose(values[bottom, 2] * model.potential_scale, 3.0)
    np.testing.assert_array_equal(values[left, 0], 0.5)
    assert np.isnan(values[bottom & ~left, 0]).all() and np.isnan(values[left & ~bottom, 1]).all()
    free = ~bottom & ~left
    assert np.isnan(values[free, :2]).all()
    moves = model.constraints.fixed_displacements()
    assert comm.allreduce(int(moves.sum())) == comm.allreduce(int(bottom.sum() + left.sum()))


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(
    ("bottom", "left", "wrong"),
    [
        ({"displacement": [0, 0]}, {"displacement": [0.1, "free"]}, "displacement x"),
        ({"displacement": [0, 0]}, {"displacement": ["free", 0.1], "follows": "push"}, "displacement y"),
        ({"potential": 0}, {"potential": 5}, "potential"),
        ({"potential": 5}, {"potential": 5, "follows": "push"}, "potential"),
        ({"potential": 0}, {"potential": 0, "follows": "push"}, None),
        ({"displacement": [0, 0]}, {"displacement": [0, "free"], "follows": "push"}, None),
        ({"displacement": ["free", 0]}, {"displacement": [0.1, "free"], "potential": 5}, None),
    ],
)
def test_rows_that_share_an_edge_agree_there(
    comm: MPI.Comm, dimension: int, bottom: dict[str, Any], left: dict[str, Any], wrong: str | None
) -> None:
    """Sides of a block have no facet in common, but the node at a corner, or four along an edge."""
    rows = [{"on": on, **row} for on, row in (("bottom", bottom), ("left", left))]
    if dimension == 3:
        # Across: x, y, up.
        for row in rows:
            if "displacement" in row:
                row["displacement"] = [row["displacement"][0], "free", row["displacement"][1]]
    load = {"steps": [1], "factors": {"push": [1.0]}} if "follows" in left else {}
    if wrong is None:
        assert blocks(comm, dimension, boundaries=rows, load=load)
        return
    if dimension == 3:
        wrong = wrong.replace("y", "z")
    nodes = "1 node belongs" if dimension == 2 else "4 nodes belong"
    words = f'another {wrong} on "left" than boundaries.0. on "bottom"; {nodes} to both'
    with pytest.raises(SceneError, match=words) as caught:
        blocks(comm, dimension, boundaries=rows, load=load)
    assert caught.value.key == f"boundaries[1].{wrong.split()[0]}"


def test_without_a_permittivity_the_potential_is_fixed_at_zero(comm: MPI.Comm) -> None:
    """The upper block carries no potential; where the blocks lie on each other only its own nodes are fixed."""
    model = blocks(comm, boundaries=ROWS, load={"steps": [1], "factors": {"push": [1.0]}})
    values, x = prescribed(model, {"push": 1.0})
    upper = model.parts.node_part[: len(x)] == 1
    np.testing.assert_array_equal(values[upper, 2], 0.0)
    assert np.isnan(values[~upper & ~np.isclose(x[:, 1], 0.0), 2]).all()


def test_elimination_and_zeros(comm: MPI.Comm) -> None:
    model = blocks(comm, boundaries=ROWS, load={"steps": [1], "factors": {"push": [1.0]}})
    constraints, vector = model.constraints, model.new_vector()
    vector.set(1.0)
    constraints.reduce(vector)
    np.testing.assert_array_equal(vector.array_r == 0.0, constraints.is_fixed.ravel())
    first, last = vector.getOwnershipRange()
    np.testing.assert_array_equal(constraints.eliminated_global, first + constraints.fixed)
    assert last - first == constraints.is_fixed.size


def test_ties(comm: MPI.Comm) -> None:
    """T and its transpose, for two electrodes, one of which a source holds."""
    electrodes = [
        {"name": "left", "on": ["left"]},
        {"name": "right", "on": ["right"], "potential": 2.0, "follows": "push"},
    ]
    rows = [{"on": "bottom", "displacement": [0, 0], "follows": "push"}]
    model = blocks(comm, boundaries=rows, electrodes=electrodes, load={"steps": [1], "factors": {"push": [1.0]}})
    constraints, unknowns, vector = model.constraints, model.unknowns, model.new_vector()
    x, scale = unknowns.coordinates[: unknowns.owned], model.potential_scale
    state = np.zeros((unknowns.owned + unknowns.references_here, unknowns.block))
    state[: unknowns.owned, 2] = -1.0
    if unknowns.references_here:
        state[unknowns.owned :, 2] = [5.0, 7.0]
    vector.array[:] = state.ravel()
    constraints.expand(vector)
    np.testing.assert_array_equal(constraints.potentials.values(vector), [5.0, 7.0])
    tied = [electrode.nodes for electrode in constraints.electrodes]
    # The upper block has no permittivity, and so no part in an electrode.
    lower = model.parts.node_part[: unknowns.owned] == 0
    assert comm.allreduce(len(tied[0])) == comm.allreduce(int((np.isclose(x[:, 0], 0.0) & lower).sum())) > 0
    found = unknowns.potentials(vector)
    np.testing.assert_array_equal(found[tied[0]], 5.0)
    np.testing.assert_array_equal(found[tied[1]], 7.0)
    assert (np.delete(found, np.concatenate(tied)) == -1.0).all()
    vector.set(1.0)
    sums = constraints.ties.sums(vector)
    np.testing.assert_array_equal(sums, [1.0 + comm.allreduce(len(nodes)) for nodes in tied])
    constraints.reduce(vector)
    np.testing.assert_array_equal(constraints.potentials.values(vector), [sums[0], 0.0])
    np.testing.assert_array_equal(vector.array_r[constraints.eliminated], 0.0)
    values = constraints.values({"push": 3.0})
    if unknowns.references_here:
        assert values[-1] * scale == pytest.approx(6.0)


@pytest.mark.parametrize("dimension", [2, 3])
def test_measures_of_a_boundary(dimension: int, comm: MPI.Comm) -> None:
    """Area, normal and the nodes' shares of it: exact on flat sides."""
    sides = {"top": dimension - 1, "right": 0}
    model = blocks(comm, dimension, boundaries=[{"on": on, "displacement": [0] * dimension} for on in sides])
    depth = DEPTH if dimension == 3 else 1.0
    areas = {"top": WIDTH * depth, "right": 2 * HEIGHT * depth}
    for (on, axis), condition in zip(sides.items(), model.constraints.conditions, strict=True):
        assert condition.area == pytest.approx(areas[on])
        np.testing.assert_allclose(condition.normal, areas[on] * np.eye(dimension)[axis], atol=1e-12)
        assert comm.allreduce(condition.weights.sum()) == pytest.approx(areas[on])
        x = model.unknowns.coordinates[condition.nodes, axis]
        np.testing.assert_allclose(x, 2 * HEIGHT if on == "top" else WIDTH)
