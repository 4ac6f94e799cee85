"""How deep bodies lie in each other is measured at nodes too, and a run says where no contact point sees it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gmsh
import numpy as np
import pytest
from mpi4py import MPI

from piezomat.contact.unseen_penetration import unseen_penetration
from piezomat.scene import Scene
from piezomat.simulation import run
from tests.scenes import bar_on_edge, press

DEPTH = 0.02


def pressed(path: Path, dimension: int, depth: float = DEPTH, **contact: Any) -> Scene:
    """Two square bars that cross edge on edge, pressed together; in 2D a square on its corner over a block."""
    sideways = [0] * (dimension - 1)
    return press(
        {"file": str(path)},
        mesh={"cells": "tensor"},
        bodies={"*": "elastic"},
        boundaries=[
            {"on": "bottom", "displacement": [*sideways, 0]},
            {"on": "top", "displacement": [*sideways, -depth], "follows": "press"},
        ],
        contact=contact,
        load={"steps": [2], "factors": {"press": [1.0]}},
    )


@pytest.mark.mpi
@pytest.mark.parametrize(("method", "cells"), [("point", 5), ("point", 6), ("node", 5)])
def test_edges_that_no_point_sees(
    method: str, cells: int, comm: MPI.Comm, shared_tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Nothing presses where edges cross, at a node or between, so they are as deep as moved; one warning names them."""
    path = shared_tmp_path / "bars.msh"
    if comm.rank == 0:
        bar_on_edge(path, 3, (2, cells))
    comm.barrier()
    finished = run(pressed(path, 3, method=method), comm)
    row = finished.history[-1]
    (pair,) = (name.partition("@")[2] for name in row if name.startswith("max_penetration"))
    # The faces beside an edge are at 45 degrees to the motion.
    assert row[f"max_penetration@{pair}"] == pytest.approx((DEPTH - 1e-9) / 2.0**0.5, rel=1e-6)
    assert row[f"contact_force_z@{pair}"] == 0.0
    found = unseen_penetration(finished.contact)
    assert list(found) == [pair] and "edges that cross lie up to 0.014 um" in found[pair]
    warnings = [line for line in capfd.readouterr().out.splitlines() if "no contact point presses" in line]
    assert len(warnings) == (comm.rank == 0)


def test_slivers_at_crossing_edges(tmp_path: Path) -> None:
    """Segments where edges cross at a node are deep and press with next to nothing: the run warns all the same."""
    bar_on_edge(tmp_path / "bars.msh", 3, (2, 6))
    forces = {}
    for method in ("segment", "node"):
        finished = run(pressed(tmp_path / "bars.msh", 3, 1e-3, method=method), MPI.COMM_SELF)
        forces[method] = -finished.history[-1]["contact_force_z@base-tool"]
        assert forces[method] > 0.1 or unseen_penetration(finished.contact)
    assert forces["segment"] < 1e-3 * forces["node"]


@pytest.mark.mpi
def test_one_pass_that_leaves_a_corner_out(
    comm: MPI.Comm, shared_tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The corner belongs to the master, which has no points: the run says so at the start and at its depth."""
    path = shared_tmp_path / "square.msh"
    if comm.rank == 0:
        bar_on_edge(path, 2, (4, 4))
    comm.barrier()
    for pair, said in ((["base", "tool"], True), (["tool", "base"], False)):
        row = run(pressed(path, 2, passes=1, pairs=[pair]), comm).history[-1]
        deep = row[f"max_penetration@{'-'.join(pair)}"]
        assert deep == pytest.approx(DEPTH - 1e-9, rel=1e-6) if said else deep < 0.1 * DEPTH
        printed = capfd.readouterr().out
        for text in ("point to another one", "nodes of the surface without contact points lie up to 0.02 um"):
            assert (text in printed) == (said and comm.rank == 0)


@pytest.mark.parametrize("tilt", [0.2, 0.5, 8.0])
def test_a_corner_has_its_force_or_a_warning(tilt: float, tmp_path: Path) -> None:
    """However little its side is tilted from the other body: nodes press, or the run says that nothing does."""
    bar_on_edge(tmp_path / "square.msh", 2, (4, 4), tilt=tilt)
    forces, said = [], []
    for method in ("node", "point"):
        scene = pressed(tmp_path / "square.msh", 2, 1e-4, method=method)
        finished = run(scene, MPI.COMM_SELF)
        forces.append(finished.history[-1]["force_y@bottom"])
        said += unseen_penetration(finished.contact).values()
    if tilt > 0.25:
        assert forces[1] == pytest.approx(forces[0], rel=0.05) and not said
    else:
        assert forces[1] == 0.0 < forces[0]
        (text,) = said
        assert '"tool-base": nodes lie up to 0.0001 um' in text


def test_a_coarse_disc_on_a_plane(tmp_path: Path) -> None:
    """The corner of an octagon is round: its points lie behind, and the run says how deep it is in the plane."""
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        geo, angles = gmsh.model.geo, np.radians(np.arange(8) * 45.0 - 90.0)
        points = [geo.addPoint(0.5 * np.cos(a), 0.5 * np.sin(a), 0.0) for a in angles]
        lines = [geo.addLine(points[i - 1], points[i]) for i in range(8)]
        face = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        geo.synchronize()
        for line in lines:
            gmsh.model.mesh.setTransfiniteCurve(line, 2)
        gmsh.model.addPhysicalGroup(2, [face], name="disc")
        gmsh.model.addPhysicalGroup(1, lines[4:6], name="top")
        gmsh.model.mesh.generate(2)
        gmsh.write(str(tmp_path / "disc.msh"))
    finally:
        gmsh.finalize()
    depth = 0.025
    floor = {"name": "floor", "point": [0, -0.5], "normal": [0, 1], "motion": [0, depth], "follows": "press"}
    scene = press(
        {"file": str(tmp_path / "disc.msh")},
        bodies={"disc": "elastic"},
        boundaries=[{"on": "top", "displacement": [0, 0]}],
        planes=[floor],
        load={"steps": [1], "factors": {"press": [1.0]}},
    )
    finished = run(scene, MPI.COMM_SELF)
    assert finished.history[-1]["max_penetration@floor"] == pytest.approx(depth, rel=1e-6)
    (text,) = unseen_penetration(finished.contact).values()
    assert '"floor": nodes lie up to 0.025 um (0.065 of a facet)' in text
