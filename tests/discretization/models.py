"""Models of two blocks on each other, which the tests of this folder share."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

from piezomat.discretization.model import Model
from piezomat.meshes.body_mesh import create
from piezomat.scene import Scene

WIDTH, HEIGHT, DEPTH = 2.0, 0.5, 1.5  # of a block, um


def blocks(comm: MPI.Comm, dimension: int = 2, **changes: Any) -> Model:
    """Two blocks that share no nodes, the lower one held from below unless `boundaries` says otherwise."""
    extent = {"width": WIDTH, "height": [HEIGHT, HEIGHT]}
    cells = [[4, 2], [5, 3]]
    if dimension == 3:
        extent["depth"] = DEPTH
        cells = [[4, 3, 2], [5, 4, 3]]
    scene = Scene(
        **{
            "geometry": {"shape": "stacked_blocks", "divisions": cells, **extent},
            "bodies": {"lower": "pvdf", "upper": "elastic"},
            "boundaries": [{"on": "bottom", "displacement": [0] * dimension}],
            "contact": {},
            **changes,
        }
    )
    return Model(scene, create(comm, scene.geometry, scene.sizes))
