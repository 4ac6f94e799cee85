"""Which rank gets which cell: equally many, whole bodies where that can be, and few nodes on several ranks."""

from __future__ import annotations

import numpy as np
import pytest

from piezomat.meshes.body_mesh import arrays_of
from piezomat.meshes.cell_ranks import cell_ranks
from piezomat.scene import Scene


def test_bodies_stay_whole_where_they_can() -> None:
    bodies = np.repeat([1, 0, 2, 3], 5).astype(np.int32)
    rank = cell_ranks(np.zeros((20, 3)), bodies, 4)
    assert [len(set(rank[bodies == body])) for body in range(4)] == [1] * 4
    assert set(rank) == {0, 1, 2, 3}


@pytest.mark.parametrize("ranks", [1, 3, 7, 8])
def test_a_body_is_cut_across_its_longer_side(ranks: int, rng: np.random.Generator) -> None:
    x = rng.uniform(size=(700, 2)) * [8.0, 1.0]
    rank = cell_ranks(x, np.zeros(700, np.int32), ranks)
    assert np.ptp(np.bincount(rank, minlength=ranks)) <= 1
    assert (np.diff(rank[np.argsort(x[:, 0])]) >= 0).all()


def test_fewer_cells_than_ranks() -> None:
    assert len(set(cell_ranks(np.arange(6.0).reshape(3, 2), np.zeros(3, np.int32), 5))) == 3


def test_few_nodes_lie_on_several_ranks() -> None:
    """Cells in the order of gmsh: 68 %."""
    scene = Scene.load("fibers_2d")
    arrays = arrays_of(scene.geometry, scene.sizes)
    rank = cell_ranks(arrays.x[arrays.cells].mean(axis=1), arrays.cell_body, 4)
    pairs = np.unique(np.stack([arrays.cells.ravel(), np.repeat(rank, arrays.cells.shape[1])]), axis=1)
    assert (np.bincount(pairs[0]) > 1).mean() < 0.05
