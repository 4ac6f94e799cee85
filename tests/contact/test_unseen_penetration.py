"""How deep bodies lie in each other is measured at nodes too, and a run says where no contact point sees it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from mpi4py import MPI

from piezomat.contact.unseen_penetration import unseen_penetration
from piezomat.scene import Scene
from piezomat.simulation import run
from tests.scenes import bar_on_edge, press

DEPTH = 0.02


def on_one_side(path: Path, **contact: Any) -> Scene:
    """A square on its corner pressed into a block; of the square one side alone may meet it."""
    return press(
        {"file": str(path)},
        mesh={"cells": "tensor"},
        bodies={"*": "elastic"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": [0, -DEPTH], "follows": "press"},
        ],
        contact={"pairs": [["right", "face"]], **contact},
        load={"steps": [2], "factors": {"press": [1.0]}},
    )


@pytest.mark.mpi
@pytest.mark.parametrize("method", ["point", "segment"])
def test_a_corner_that_no_point_sees(
    method: str, comm: MPI.Comm, shared_tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Nothing presses, so the corner is as deep in the block as it was moved, and a warning names the pair once."""
    path = shared_tmp_path / "square.msh"
    if comm.rank == 0:
        bar_on_edge(path, 2, (4, 4))
    comm.barrier()
    finished = run(on_one_side(path, method=method), comm)
    row = finished.history[-1]
    # Segments are nearer to the corner than points, and some are in contact at the end.
    depth = DEPTH - 1e-9 if method == "point" else row["max_penetration@right-face"]
    assert row["max_penetration@right-face"] == pytest.approx(depth, rel=1e-6)
    warnings = [line for line in capfd.readouterr().out.splitlines() if "no contact point presses" in line]
    found = unseen_penetration(finished.problem.contact)
    if method == "point":
        assert row["contact_force_y@right-face"] == 0.0 and list(found) == [0]
        assert '"right-face"' in found[0] and "0.08 of a facet" in found[0]
        assert len(warnings) == (comm.rank == 0)
    else:
        assert row["max_penetration@right-face"] > 0.3 * DEPTH


def test_nodes_that_press_are_no_doubt(tmp_path: Path) -> None:
    """With points at the nodes all is seen."""
    bar_on_edge(tmp_path / "square.msh", 2, (4, 4))
    finished = run(on_one_side(tmp_path / "square.msh", method="node"), MPI.COMM_SELF)
    assert finished.history[-1]["contact_force_y@right-face"] > 1.0
    assert not unseen_penetration(finished.problem.contact)
