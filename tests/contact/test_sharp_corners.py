"""Sharp edges and vertices that face a body or a plane are in contact whatever the method; flat faces are as before."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gmsh
import numpy as np
import pytest
from mpi4py import MPI

from piezomat.forms.contact.facets import facet_kind
from piezomat.forms.contact.integrals import quadrature_points, with_closed_points
from piezomat.scene import Scene
from piezomat.simulation import run
from tests.scenes import bar_on_edge, blocks, press

DEPTH = 0.02


def pressed(path: Path, dimension: int, **changes: Any) -> Scene:
    """The body `tool` pressed by 2 % of its size into the block `base`, in two steps."""
    sideways = [0.0] * (dimension - 1)
    keys: dict[str, Any] = {
        "mesh": {"cells": "tensor"},
        "bodies": {"*": "elastic"},
        "boundaries": [
            {"on": "bottom", "displacement": [*sideways, 0]},
            {"on": "top", "displacement": [*sideways, -DEPTH], "follows": "press"},
        ],
        "contact": {},
        "load": {"steps": [2], "factors": {"press": [1.0]}},
        "solver": {"tolerance": 1e-11},
    }
    return press({"file": str(path)}, **{**keys, **changes})


def cube(path: Path, turn: tuple[float, float, float], cells: int = 2) -> None:
    """A unit cube, turned about the origin by an angle around an axis, over a block of 2 x 2 x 1; bricks."""
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        occ, mesh = gmsh.model.occ, gmsh.model.mesh
        tool, base = occ.addBox(0, 0, 0, 1, 1, 1), occ.addBox(-1, -1, -1, 2, 2, 1)
        axis = np.array(turn)
        angle = np.linalg.norm(axis)
        occ.rotate([(3, tool)], 0, 0, 0, *(axis / angle), angle)
        occ.translate([(3, tool)], 0.03, -0.48, 1e-9)
        occ.synchronize()
        for curve in gmsh.model.getEntities(1):
            mesh.setTransfiniteCurve(curve[1], cells + 1)
        for face in gmsh.model.getEntities(2):
            mesh.setTransfiniteSurface(face[1])
            mesh.setRecombine(2, face[1])
        for body, name, side in ((tool, "tool", "top"), (base, "base", "bottom")):
            mesh.setTransfiniteVolume(body)
            faces = [face for _, face in gmsh.model.getBoundary([(3, body)], oriented=False)]
            box = {face: gmsh.model.getBoundingBox(2, face) for face in faces}
            held = [f for f in faces if (box[f][2] > 0.1 if side == "top" else box[f][5] < -0.9)]
            gmsh.model.addPhysicalGroup(3, [body], name=name)
            gmsh.model.addPhysicalGroup(2, held, name=side)
        mesh.generate(3)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


SHAPES = {
    "corner": (2, lambda path: bar_on_edge(path, 2, (4, 4))),
    "edge": (3, lambda path: cube(path, (0.0, -np.pi / 4.0, 0.0))),
    "vertex": (3, lambda path: cube(path, tuple(np.arccos(1 / np.sqrt(3.0)) * np.array([1.0, -1.0, 0.0]) / 2.0**0.5))),
}


@pytest.mark.mpi
@pytest.mark.parametrize("shape", SHAPES)
def test_every_method_sees_it(shape: str, comm: MPI.Comm, shared_tmp_path: Path) -> None:
    """With the force that nodes have, which are points of both bodies, and as small a penetration; ranks agree."""
    dimension, mesh = SHAPES[shape]
    path = shared_tmp_path / f"{shape}.msh"
    if comm.rank == 0:
        mesh(path)
    comm.barrier()
    up = f"force_{'xyz'[dimension - 1]}"
    wanted = run(pressed(path, dimension, contact={"method": "node"}), MPI.COMM_SELF).history[-1]
    assert wanted[f"{up}@bottom"] > 1.0
    for method in ("point", "segment"):
        row = run(pressed(path, dimension, contact={"method": method}), comm).history[-1]
        assert row[f"{up}@bottom"] == pytest.approx(wanted[f"{up}@bottom"], rel=0.01)
        assert row[f"{up}@top"] == pytest.approx(-row[f"{up}@bottom"], rel=1e-8)
        (penetration,) = (value for name, value in row.items() if name.startswith("max_penetration"))
        assert 0.0 < penetration < 0.1 * DEPTH
        if comm.size > 1:
            alone = run(pressed(path, dimension, contact={"method": method}), MPI.COMM_SELF).history[-1]
            assert row[f"{up}@bottom"] == pytest.approx(alone[f"{up}@bottom"], rel=1e-8)
            assert row["contact"] == pytest.approx(alone["contact"], rel=1e-8)


@pytest.mark.parametrize("tilt", [2.0, 8.0, 45.0])
def test_a_corner_on_a_plane(tilt: float, tmp_path: Path) -> None:
    """It presses whatever the angle of its sides to the plane."""
    bar_on_edge(tmp_path / "square.msh", 2, (4, 4))
    angle, depth = np.radians(45.0 - tilt), 0.01
    down = -np.array([np.sin(angle), np.cos(angle)])
    lid = {"name": "lid", "point": [0.0, 2.0**0.5 + 1e-9], "normal": down.tolist(), "motion": (depth * down).tolist()}
    held = [{"on": on, "displacement": [0, 0]} for on in ("bottom", "left", "right")]
    keys = {"boundaries": held, "contact": {"pairs": [["left", "face"]]}, "planes": [{**lid, "follows": "press"}]}
    scene = pressed(tmp_path / "square.msh", 2, **keys)
    row = run(scene, MPI.COMM_SELF).history[-1]
    assert 0.0 < row["max_penetration@lid"] < 0.1 * depth
    assert np.hypot(row["force_x@lid"], row["force_y@lid"]) > 1.0


def test_flat_faces_keep_their_points() -> None:
    """Blocks on each other, whose edges are aligned or not."""
    finished = run(blocks(contact={"method": "point"}), MPI.COMM_SELF)
    assert not any(p.closed.any() for p in finished.contact.surface_pairs)
    assert all(p.sharp.any() for p in finished.contact.surface_pairs)


@pytest.mark.parametrize("name", ["line2", "line3", "tri3", "tri6", "quad4", "quad9"])
def test_points_at_corners(name: str) -> None:
    """They are at all corners, and a uniform pressure has the nodal forces of the integral."""
    kind = facet_kind(name)
    nodes = np.concatenate([kind.nodes @ np.eye(kind.dim, kind.dim + 1)[None] + shift for shift in (0.0, 2.0)])
    points = quadrature_points(kind, nodes)
    mixed, new = with_closed_points(points, kind, nodes, np.array([False, True]))
    assert (np.diff(mixed.facet) >= 0).all()
    np.testing.assert_array_equal(new, mixed.facet == 1)
    np.testing.assert_array_equal(mixed.xi[~new], points.xi[points.facet == 0])
    corners = kind.nodes[: 2**kind.dim if not kind.simplex else kind.dim + 1]
    assert all((np.abs(mixed.xi[new] - corner).max(axis=1) == 0.0).any() for corner in corners)
    assert (mixed.weight > 0.0).all()
    forces = [mixed.weight[some] @ mixed.shape[some] for some in (~new, new)]
    np.testing.assert_allclose(forces[1], forces[0], atol=1e-15)
