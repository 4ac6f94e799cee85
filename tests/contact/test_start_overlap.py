"""How deep bodies lie inside each other at the start, whichever of their facets the pairs name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gmsh
import pytest
from mpi4py import MPI

from piezomat.contact.setup import interfaces_of
from piezomat.contact.start_overlap import start_overlap
from piezomat.discretization.model import Model
from piezomat.meshes.body_mesh import create
from piezomat.scene import Scene

pytestmark = pytest.mark.mpi

# Pairs of a block on another: faces that meet, faces that do not, and whole bodies.
PAIRS = [
    "auto",
    [["lower", "upper"]],
    [["lower_contact", "upper_contact"]],
    [["lower", "upper_top"]],
    [["lower_right", "upper"]],
    [["lower_bottom", "upper_bottom"]],
]


def overlap(comm: MPI.Comm, geometry: dict[str, Any], pairs: str | list[list[str]]) -> float:
    """The overlap of a scene of this geometry with these pairs."""
    scene = Scene(
        geometry=geometry,
        bodies={"*": "elastic"},
        boundaries=[{"on": "bottom", "displacement": [0, 0]}],
        contact={"pairs": pairs},
    )
    model = Model(scene, create(comm, scene.geometry, scene.sizes))
    return start_overlap(model, interfaces_of(model))


@pytest.mark.parametrize("pairs", PAIRS)
def test_blocks_that_touch_do_not_overlap(comm: MPI.Comm, pairs: str | list[list[str]]) -> None:
    """Behind the top face of the upper block lies all of the lower one, which is outside of it."""
    divisions = [[4, 2], [6, 3]]
    assert overlap(comm, {"shape": "stacked_blocks", "divisions": divisions}, pairs) < 1e-12


@pytest.mark.parametrize("pairs", PAIRS)
def test_overlap_is_that_of_the_bodies(comm: MPI.Comm, shared_tmp_path: Path, pairs: str | list[list[str]]) -> None:
    """A block of 1 x 0.5 that lies 0.2 deep in one that is wider."""
    path = shared_tmp_path / "m.msh"
    if comm.rank == 0:
        _overlapping(path)
    comm.barrier()
    assert overlap(comm, {"file": str(path)}, pairs) == pytest.approx(0.2, abs=1e-12)


@pytest.mark.parametrize(("pairs", "expected"), [([["lower", "middle"]], 0.0), ([["middle", "upper"]], 0.2)])
def test_bodies_in_no_pair_may_overlap(
    comm: MPI.Comm, shared_tmp_path: Path, pairs: list[list[str]], expected: float
) -> None:
    """Nothing acts between them: a body that stands for another place may lie anywhere."""
    path = shared_tmp_path / "m.msh"
    if comm.rank == 0:
        _overlapping(path, "middle", "upper")
    comm.barrier()
    assert overlap(comm, {"file": str(path)}, pairs) == pytest.approx(expected, abs=1e-12)


def _overlapping(path: Path, under: str = "lower", over: str = "upper") -> None:
    """Write the mesh of a block of 3 x 1 and one of 1 x 0.5, 0.2 deep in it; where neither is `lower`, of one apart."""
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    bodies = {under: (-1.0, 0.0, 3.0, 1.0), over: (0.0, 0.8, 1.0, 0.5)}
    if "lower" not in bodies:
        bodies["lower"] = (0.0, -2.0, 1.0, 1.0)
    for name, (x, y, width, height) in bodies.items():
        corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
        points = [gmsh.model.geo.addPoint(*corner, 0.0, 0.25) for corner in corners]
        lines = [gmsh.model.geo.addLine(points[i], points[(i + 1) % 4]) for i in range(4)]
        face = gmsh.model.geo.addPlaneSurface([gmsh.model.geo.addCurveLoop(lines)])
        gmsh.model.geo.synchronize()
        gmsh.model.addPhysicalGroup(2, [face], name=name)
        sides = {f"{name}_{side}": [line] for side, line in zip(("bottom", "right", "top"), lines, strict=False)}
        sides |= {"bottom": lines[:1]} if name == "lower" else {}
        sides |= {f"{name}_contact": lines[2:3] if name == under else lines[:1]}
        for group, members in sides.items():
            gmsh.model.addPhysicalGroup(1, members, name=group)
    gmsh.model.mesh.generate(2)
    gmsh.write(str(path))
    gmsh.finalize()
