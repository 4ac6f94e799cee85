"""Sharp edges that cross press on each other, whatever the method; gap and closest points of two edges."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.forms.contact.edges import crossings
from piezomat.scene import Scene
from piezomat.simulation import run
from tests.scenes import bar_on_edge, press

DEPTH = 0.02


def crossed(path: Path, contact: dict[str, Any]) -> Scene:
    """Two square bars that cross edge on edge, pressed together."""
    return press(
        {"file": str(path)},
        mesh={"cells": "tensor"},
        bodies={"*": "elastic"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0, 0]},
            {"on": "top", "displacement": [0, 0, -DEPTH], "follows": "press"},
        ],
        contact=contact,
        load={"steps": [2], "factors": {"press": [1.0]}},
        solver={"tolerance": 1e-11},
    )


@pytest.mark.mpi
def test_crossed_bars(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    """The edges cross between their nodes, so all methods see the same: one force, straight up and down."""
    path = shared_tmp_path / "bars.msh"
    if comm.rank == 0:
        bar_on_edge(path, 3, (2, 5))
    comm.barrier()
    forces = []
    for contact in ({}, {"method": "node"}, {"method": "segment"}, {"passes": 1}, {"pairs": [["tool", "base"]]}):
        (first, row) = run(crossed(path, contact), comm).history
        force = np.array([row[f"force_{axis}@bottom"] for axis in "xyz"])
        forces.append(force[2])
        np.testing.assert_allclose(force[:2], 0.0, atol=1e-8 * force[2])
        assert row["force_z@top"] == pytest.approx(-force[2], rel=1e-8)
        # One spring between two bodies: the force is proportional to the motion, the energy to its square.
        assert force[2] == pytest.approx(2.0 * first["force_z@bottom"], rel=1e-3)
        assert row["elastic"] + row["contact"] == pytest.approx(row["external_work"], rel=1e-4)
        (penetration,) = (value for name, value in row.items() if name.startswith("max_penetration"))
        assert 0.0 < penetration < 0.1 * DEPTH
    assert forces[0] > 1.0
    np.testing.assert_allclose(forces, forces[0], rtol=1e-7)
    if comm.size > 1:
        alone = run(crossed(path, {}), MPI.COMM_SELF).history[-1]
        assert forces[0] == pytest.approx(alone["force_z@bottom"], rel=1e-8)


def ridge(axis: int, height: float, up: float) -> tuple[np.ndarray, np.ndarray]:
    """Ends (2, 3) of an edge of length 2 along an axis, and normals (2, 3) of facets at 45 degrees to either side."""
    ends = np.zeros((2, 3))
    ends[:, axis], ends[:, 2] = (-0.7, 1.3), height
    normals = np.zeros((2, 3))
    normals[:, 1 - axis], normals[:, 2] = (1.0, -1.0), up
    return ends, normals / np.sqrt(2.0)


def test_gap_of_two_ridges() -> None:
    """The upper one is 0.1 inside the lower one; turned by 180 degrees they lie back to back and do not meet."""
    lower, upside = ridge(0, 0.0, 1.0)
    upper, downside = ridge(1, -0.1, -1.0)
    found = crossings(upper[None], lower[None], downside[None], upside[None])
    assert found.crosses.all() and found.gap == pytest.approx([-0.1])
    np.testing.assert_allclose(found.normal, [[0.0, 0.0, 1.0]], atol=1e-15)
    np.testing.assert_allclose([found.s, found.t], 0.35)
    assert not crossings(upper[None], lower[None], -downside[None], upside[None]).crosses.any()
    assert not crossings(upper[None] + [0.0, 2.0, 0.0], lower[None], downside[None], upside[None]).crosses.any()
    assert not crossings(lower[None], lower[None], -upside[None], upside[None]).crosses.any()


def test_variation_of_the_gap(rng: np.random.Generator) -> None:
    """It is that of the two points at fixed coordinates along the normal."""
    lower, upside = ridge(0, 0.0, 1.0)
    upper, downside = ridge(1, -0.1, -1.0)
    ends = np.stack([upper, lower]) + 0.1 * rng.standard_normal((2, 2, 3))
    change, step = rng.standard_normal((2, 2, 3)), 1e-6

    def at(share: float) -> Any:
        moved = ends + share * change
        return crossings(moved[0][None], moved[1][None], downside[None], upside[None])

    here = at(0.0)
    points = [(1.0 - c) * change[i, 0] + c * change[i, 1] for i, c in enumerate((here.s[0], here.t[0]))]
    wanted = (points[0] - points[1]) @ here.normal[0]
    assert (at(step).gap[0] - at(-step).gap[0]) / (2.0 * step) == pytest.approx(wanted, rel=1e-7)
