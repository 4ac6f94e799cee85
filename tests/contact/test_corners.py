"""Sharp corners press on blocks and planes whatever the method; flat faces are as they were."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.forms.contact.corners import corner_share
from piezomat.scene import Scene
from piezomat.simulation import run
from tests.scenes import bar_on_edge, blocks, press

DEPTH = 0.02
# Nodes at the corner of the square and the place below it: the reference, since both are contact points.
NODE = {"method": "node"}


def on_corner(path: Path, contact: dict[str, Any], **changes: Any) -> Scene:
    """A square pressed with its corner into a block."""
    keys: dict[str, Any] = {
        "mesh": {"cells": "tensor"},
        "bodies": {"*": "elastic"},
        "boundaries": [
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": [0, -DEPTH], "follows": "press"},
        ],
        "contact": contact,
        "load": {"steps": [2], "factors": {"press": [1.0]}},
    }
    return press({"file": str(path)}, **{**keys, **changes})


@pytest.fixture
def square(comm: MPI.Comm, shared_tmp_path: Path) -> Path:
    """The mesh: four cells along a side of the square, in a block of cells of the same size."""
    path = shared_tmp_path / "square.msh"
    if comm.rank == 0:
        bar_on_edge(path, 2, (4, 4))
    comm.barrier()
    return path


@pytest.mark.mpi
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_every_method_sees_a_corner(order: int, kinematics: str, comm: MPI.Comm, square: Path) -> None:
    """As nodes do, with either role of the two bodies in one pass; on all ranks alike."""
    keys = {"mesh": {"cells": "tensor", "order": order}, "model": {"kinematics": kinematics}}
    reference = run(on_corner(square, NODE, **keys), MPI.COMM_SELF).history
    for contact in (
        {},
        {"method": "segment"},
        {"passes": 1, "pairs": [["tool", "base"]]},
        {"passes": 1, "pairs": [["base", "tool"]]},
        {"passes": 1, "pairs": [["base", "tool"]], "method": "node"},
    ):
        for row, wanted in zip(run(on_corner(square, contact, **keys), comm).history, reference, strict=True):
            assert -row["force_y@top"] == pytest.approx(row["force_y@bottom"], rel=1e-7)
            near = pytest.approx(wanted["force_y@bottom"], rel=0.04 if order == 1 else 0.07)
            assert row["force_y@bottom"] == near, contact
            (penetration,) = (value for name, value in row.items() if name.startswith("max_penetration"))
            assert penetration < 0.2 * DEPTH
            energy = sum(row[name] for name in ("elastic", "contact"))
            assert energy == pytest.approx(row["external_work"], rel=5e-3 if kinematics == "small" else 1e-2)


@pytest.mark.mpi
def test_ranks_agree(comm: MPI.Comm, square: Path) -> None:
    scene = on_corner(square, {}, solver={"tolerance": 1e-11})
    mine, alone = run(scene, comm).history[-1], run(scene, MPI.COMM_SELF).history[-1]
    for name in ("force_y@bottom", "max_penetration@tool-base", "contact_area@tool-base", "contact"):
        assert mine[name] == pytest.approx(alone[name], rel=1e-8), name


@pytest.mark.parametrize("divisions", [16, 32])
def test_finer_meshes_come_nearer_to_the_wedge(divisions: int, tmp_path: Path) -> None:
    """A coarse mesh is too stiff: the force falls to that of fine meshes, 6.3, with the logarithm of their size."""
    bar_on_edge(tmp_path / "square.msh", 2, (divisions, divisions))
    force, wanted = (
        run(on_corner(tmp_path / "square.msh", keys), MPI.COMM_SELF).history[-1]["force_y@bottom"]
        for keys in ({}, NODE)
    )
    assert force == pytest.approx(wanted, rel=0.06)


@pytest.mark.mpi
def test_a_corner_on_a_plane(comm: MPI.Comm, square: Path) -> None:
    """It pushes the upper corner down."""
    forces = {}
    for method in ("node", "point", "segment"):
        scene = on_corner(
            square,
            {"method": method, "pairs": [["left", "face"]]},
            boundaries=[{"on": on, "displacement": [0, 0]} for on in ("bottom", "left")],
            planes=[
                {"name": "lid", "point": [0, 2.0**0.5], "normal": [0, -1], "motion": [0, -0.01], "follows": "press"}
            ],
        )
        row = run(scene, comm).history[-1]
        forces[method] = -row["force_y@lid"]
        assert row["max_penetration@lid"] < 2e-3
    assert forces["node"] > 1.0
    assert forces["point"] == pytest.approx(forces["node"], rel=0.04)
    assert forces["segment"] == pytest.approx(forces["point"], rel=1e-6)


def test_corners_of_flat_faces_do_not_act() -> None:
    """Blocks on each other: the corners are as deep as the faces, and stay out of it."""
    finished = run(blocks(contact={"method": "point"}), MPI.COMM_SELF)
    corners = [p for p in finished.problem.contact.surface_pairs if p.corners is not None]
    assert sum(len(p.near_points) for p in corners) > 0
    assert sum(len(p.projected_points) for p in corners) == 0


def test_share_of_a_corner() -> None:
    """A right angle that turns from flat to its diagonal: nothing up to 20 degrees, all from 30 on, rising between."""
    normals = np.array([[[0.0, 1.0], [1.0, 0.0]]])
    found = []
    for degrees in (0.0, 10.0, 20.0, 22.0, 25.0, 28.0, 30.0, 45.0, 60.0, 68.0, 75.0, 90.0):
        angle = np.radians(degrees)
        other = -np.array([[np.sin(angle), np.cos(angle)]])
        found.append(float(corner_share(normals, np.eye(2)[None], other)[0]))
    assert found[:3] == pytest.approx([0.0] * 3, abs=1e-12) and found[6:9] == pytest.approx([1.0] * 3)
    assert found[-2:] == [0.0, 0.0]
    assert 0.0 < found[3] < found[4] < found[5] < 1.0
