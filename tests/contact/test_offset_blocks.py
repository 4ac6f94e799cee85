"""Two blocks on each other, one shifted sideways: no contact but that of the two faces, with all sides searched."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.contact.setup import interfaces_of
from piezomat.discretization.model import Model
from piezomat.meshes.body_mesh import create
from piezomat.scene import Scene
from piezomat.simulation import run

PENALTY, OVERLAP = 1000.0, 1e-3
OFFSETS = (0.0, 1e-6, 0.11, 0.33, 0.5, 0.86, 0.99, 1.0, 1.02)
METHODS: dict[str, dict[str, Any]] = {
    "node": {"method": "node"},
    "node, one pass": {"method": "node", "passes": 1},
    "point": {"method": "point"},
    "segment": {"method": "segment"},
    "point, smoothed": {"method": "point", "smoothing": True},
    "segment, smoothed": {"method": "segment", "smoothing": True},
}


def blocks(dim: int, divisions: tuple[int, int], method: str, **changes: Any) -> Scene:
    """Two unit blocks with so many cells a side below and above."""
    sides = {"divisions": [[count] * dim for count in divisions], "height": [1.0, 1.0]}
    keys: dict[str, Any] = {
        "geometry": {"shape": "stacked_blocks", **sides} | ({"depth": 1.0} if dim == 3 else {}),
        "mesh": {"cells": "tensor"},
        "bodies": {"lower": "elastic", "upper": "elastic"},
        "boundaries": [{"on": "bottom", "displacement": [0.0] * dim}],
        "contact": METHODS[method] | {"normal_penalty": PENALTY},
        "output": {"fields": "none", "picture": False},
    }
    return Scene(**{**keys, **changes})


def two_faces(scene: Scene) -> Scene:
    """The same with the two faces alone searched."""
    contact = scene.contact.model_copy(update={"pairs": [["lower_contact", "upper_contact"]]})
    return scene.model_copy(update={"contact": contact})


def forces(scene: Scene, comm: MPI.Comm, places: list[tuple[float, float]]) -> list[np.ndarray]:
    """Force (d,) of contact on the upper block at each offset and gap. Collective."""
    model = Model(scene, create(comm, scene.geometry, scene.sizes))
    contact = interfaces_of(model)
    state, dim = model.coordinate_vector(), model.dim
    upper = model.parts.node_part[: model.unknowns.owned] == 1
    found = []
    for offset, gap in places:
        motion = np.zeros((len(upper), model.unknowns.block))
        motion[upper, 0], motion[upper, dim - 1] = offset, gap
        state.array[:] = motion.ravel()
        contact.detect(state, max(contact.least_search_radius(), 0.7))
        residual = model.new_vector()
        contact.add_residual(state, residual)
        force = -residual.array_r.reshape(len(upper), -1)[upper, :dim].sum(axis=0)
        assert contact.penetration() <= max(-gap, 0.0) + 1e-12, (offset, gap)
        found.append(comm.allreduce(force))
    return found


# More ratios, orders and methods are in the map `offset` of scripts/stability.
CASES = [
    pytest.param(2, (2, 3), 1, "tensor", marks=pytest.mark.mpi),
    pytest.param(3, (2, 3), 1, "tensor", marks=pytest.mark.mpi),
    (2, (1, 4), 2, "tensor"),
    (2, (1, 20), 1, "tensor"),
    (2, (20, 1), 1, "tensor"),
    (2, (4, 3), 1, "simplex"),
    (3, (2, 1), 2, "simplex"),
]


@pytest.mark.parametrize(("dim", "divisions", "order", "cells"), CASES)
def test_nothing_but_the_faces_press(
    dim: int, divisions: tuple[int, int], order: int, cells: str, comm: MPI.Comm
) -> None:
    """Nothing at a gap; where they overlap, the force on what is covered, as exactly as with the two faces alone."""
    apart = [(offset, gap) for offset in OFFSETS[::2] for gap in (0.02, 1e-3)]
    pressed = [(offset, -OVERLAP) for offset in OFFSETS]
    covered = np.maximum(1.0 - np.array(OFFSETS), 0.0)
    for method in METHODS:
        if (dim == 3 and method not in ("node", "point")) or ("smoothed" in method and order == 2):
            continue
        scene = blocks(dim, divisions, method, mesh={"order": order, "cells": cells, "size": 1.0})
        for place, force in zip(apart, forces(scene, comm, apart), strict=True):
            assert np.abs(force).max() < 1e-12, (method, place)
        force = np.array(forces(scene, comm, pressed)) / (PENALTY * OVERLAP)
        np.testing.assert_allclose(force[:, :-1], 0.0, atol=1e-12)
        alone = np.array(forces(two_faces(scene), comm, pressed)) / (PENALTY * OVERLAP)
        error = np.abs(force[:, -1] - covered)
        # Points at an edge press only partly: nodes on it stand for what is beside the block, too. The two faces alone
        # are no reference at offsets from 1 on, where the nodes at the edge still press.
        accuracy = np.abs(alone[:, -1] - covered)[covered > 0.0].max()
        # What is nearer to the edge than it is deep may be on the other block's side.
        assert (error <= accuracy + 1.01 * OVERLAP).all(), (method, error, accuracy)
        assert (force[:, -1] <= alone[:, -1] + 1e-9).all(), method


@pytest.mark.parametrize(
    ("kinematics", "order"),
    [pytest.param("small", 1, marks=pytest.mark.mpi), ("finite", 2)],
)
def test_blocks_that_are_apart_do_not_push(kinematics: str, order: int, comm: MPI.Comm) -> None:
    """One slides above the other, 0.02 apart, by half its width in one step and then in small ones."""
    for method in METHODS:
        if "smoothed" in method and order == 2:
            continue
        scene = blocks(
            2,
            (2, 3),
            method,
            geometry={"shape": "stacked_blocks", "height": [1, 1], "divisions": [[2, 2], [3, 3]], "gap": 0.02},
            mesh={"order": order, "cells": "tensor"},
            model={"kinematics": kinematics},
            boundaries=[
                {"on": "bottom", "displacement": [0, 0]},
                {"on": "top", "displacement": [1, 0], "follows": "slide"},
            ],
            load={"steps": [1, 3], "factors": {"slide": [0.45, 0.6]}},
        )
        for row in run(scene, comm).history:
            assert row["contact_area@lower-upper"] == 0.0, (method, row["step"])
            assert abs(row["force_x@top"]) < 1e-9 and abs(row["force_y@top"]) < 1e-9, (method, row["step"])


def test_a_block_that_slides_off_another_loses_its_force() -> None:
    """The force falls as the overlap does, with all sides searched as with the two faces alone."""
    scene = blocks(
        2,
        (12, 12),
        "point",
        geometry={"shape": "stacked_blocks", "height": [1, 1], "divisions": [[12, 12], [5, 5]]},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": ["free", -0.02], "follows": "press"},
            {"on": "top", "displacement": [1.0, "free"], "follows": "slide"},
        ],
        contact={},
        load={"steps": [1, 40], "factors": {"press": [1.0, 1.0], "slide": [0.0, 0.8]}},
    )
    both = (run(each, MPI.COMM_SELF).history for each in (scene, two_faces(scene)))
    force, alone = (np.array([-row["force_y@top"] for row in history]) for history in both)
    # The faces alone let points press that are nearer to the edge than they are deep, or beyond it: 0.06 of 28.
    np.testing.assert_allclose(force, alone, rtol=0.0, atol=0.07)
    expected = [28.1, 27.2, 25.1, 22.4, 19.4, 16.6, 13.8, 11.3, 8.9]
    np.testing.assert_allclose(force[::5], expected, rtol=0.0, atol=0.051)
