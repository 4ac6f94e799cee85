"""The answer depends neither on the number of ranks nor on which rank holds which cells.

Every history column of a run on all ranks is compared with a serial run of the same scene. The mesh is cut in
strips through both bodies and the contact zone, or in the order of the cells, or so that a rank holds no cell.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from numpy.typing import NDArray

from piezomat.scene import Scene
from piezomat.simulation import Run, run
from tests.histories import Rows, assert_equal

pytestmark = pytest.mark.mpi

Partition = Callable[[NDArray[np.float64], NDArray[np.int32], int], NDArray[np.int32]]

PRESS = 0.04  # um
# The solver's own error is out of the way at this tolerance.
TIGHT = {"tolerance": 1e-11}
STILL_PRESSED = {"steps": [2, 2], "factors": {"press": [1.0, 0.4]}}
CUTOFF = {"law": "cutoff", "strength": 20.0, "energy": 0.1}
BILINEAR = {"law": "bilinear", "strength": 20.0, "energy": 0.1}


def two_bodies(
    geometry: dict[str, Any],
    mesh: dict[str, Any],
    contact: dict[str, Any],
    names: tuple[str, str] = ("lower", "upper"),
    depth: float = PRESS,
    **changes: Any,
) -> dict[str, Any]:
    """One body pressed on the other and pulled off, poled along no axis; both electrodes have a potential."""
    up = 2 if geometry["shape"] == "crossed_fibers" or "depth" in geometry else 1
    across = [0.0] * up
    return {
        "title": "Ranks",
        "geometry": geometry,
        "mesh": mesh,
        "materials": {
            "under": {"like": "pvdf", "poling": [0.3, *across[1:], 1.0]},
            "over": {"like": "pvdf_tzou", "poling": [0.2, *across[1:], -1.0]},
        },
        "bodies": dict(zip(names, ("under", "over"), strict=True)),
        "boundaries": [
            {"on": "bottom", "displacement": [*across, 0.0], "potential": 0.0},
            {"on": "top", "displacement": [0.1 * depth, *across[1:], -depth], "potential": 2.0, "follows": "press"},
        ],
        "contact": {"normal_penalty": 1e5, "electric_penalty": 0.1, **contact},
        "load": {"steps": [2, 3], "factors": {"press": [1.0, -0.2]}},
        "solver": TIGHT,
        **changes,
    }


def halves(contact: dict[str, Any], cells: str, order: int) -> Scene:
    mesh = {"size": 0.15 * order, "contact_size": 0.04 * order, "order": order, "cells": cells}
    load = {"steps": [2, 2], "factors": {"press": [1.0, -0.4]}}
    return Scene(**two_bodies({"shape": "facing_halves"}, mesh, contact, depth=0.75 * PRESS, load=load))


def crossed(contact: dict[str, Any], order: int, contact_size: float = 0.2, **changes: Any) -> Scene:
    mesh = {"size": 0.6 if order == 1 else 1.0, "contact_size": contact_size if order == 1 else 0.8, "order": order}
    geometry = {"shape": "crossed_fibers", "length": 0.8}
    return Scene(**two_bodies(geometry, mesh, contact, **changes))


def bricks(contact: dict[str, Any], order: int, **changes: Any) -> Scene:
    """Tilted blocks of distorted bricks that do not match."""
    geometry = {"shape": "stacked_blocks", "depth": 1.0, "distortion": 0.1, "tilt": 10.0}
    divisions = [[2, 2, 1], [1, 2, 1]] if order == 2 else [[3, 2, 2], [2, 3, 1]]
    mesh = {"order": order, "cells": "tensor"}
    return Scene(**two_bodies(geometry | {"divisions": divisions}, mesh, contact, depth=0.25 * PRESS, **changes))


def finite() -> Scene:
    geometry, mesh = {"shape": "fiber_on_block"}, {"size": 0.3, "contact_size": 0.05}
    contact = {"method": "point", "adhesion": BILINEAR}
    return Scene(**two_bodies(geometry, mesh, contact, ("block", "fiber"), model={"kinematics": "finite"}))


def stack_of_blocks() -> Scene:
    """Three blocks without potential; nothing but contact and adhesion holds the one in the middle.

    Flat faces give it nothing to slide down. A column of discs is no scene for this: without friction it buckles, and
    rounding decides whether and where to.
    """
    divisions = [[5, 2], [4, 2], [7, 2]]
    return Scene(
        geometry={"shape": "stacked_blocks", "height": [0.3, 0.4, 0.3], "divisions": divisions, "distortion": 0.1},
        title="Blocks",
        bodies={f"block_{i}": "elastic" for i in (1, 2, 3)},
        boundaries=[
            {"on": "bottom", "displacement": [0.0, 0.0]},
            {"on": "top", "displacement": [0.0, -0.125 * PRESS], "follows": "press"},
        ],
        contact={"method": "node", "normal_penalty": 1e5, "adhesion": BILINEAR},
        load={"steps": [2, 3], "factors": {"press": [1.0, -0.1]}},
        solver=TIGHT,
    )


def floating(**solver: Any) -> dict[str, Any]:
    """What makes the upper body's potential float, which then is grounded by a spring."""
    press = {"on": "top", "displacement": [0.0, 0.0, -PRESS], "follows": "press"}
    bottom = {"on": "bottom", "displacement": [0.0, 0.0, 0.0], "potential": 0.0}
    return {"boundaries": [bottom, press], "solver": TIGHT | solver}


SCENES: dict[str, Callable[[], Scene]] = {
    "triangles": lambda: halves({"method": "point", "adhesion": CUTOFF}, "simplex", 1),
    "triangles of order 2": lambda: halves({"method": "node", "adhesion": BILINEAR}, "simplex", 2),
    "quadrilaterals": lambda: halves({"method": "node", "passes": 1, "adhesion": BILINEAR}, "tensor", 1),
    "quadrilaterals of order 2": lambda: halves({"method": "point", "passes": 1, "adhesion": CUTOFF}, "tensor", 2),
    "finite kinematics": finite,
    "a floating block": stack_of_blocks,
    "tetrahedra": lambda: crossed({"method": "point", "adhesion": CUTOFF}, 1, **floating()),
    "tetrahedra of order 2": lambda: crossed({"method": "node", "passes": 1, "adhesion": BILINEAR}, 2),
    "bricks": lambda: bricks({"method": "point", "adhesion": BILINEAR}, 1),
    "bricks of order 2": lambda: bricks({"method": "node", "passes": 1}, 2),
    "segments": lambda: halves({"method": "segment", "adhesion": BILINEAR}, "simplex", 1),
    "segments of order 2": lambda: halves({"method": "segment", "passes": 1}, "tensor", 2),
    "segments of tetrahedra": lambda: crossed({"method": "segment", "adhesion": CUTOFF}, 1, 0.3, **floating()),
    "segments of bricks": lambda: bricks({"method": "segment", "passes": 1, "adhesion": BILINEAR}, 1),
    "smoothed": lambda: halves({"method": "point", "smoothing": True, "adhesion": BILINEAR}, "simplex", 1),
    # Not until they are apart: the potential that then remains is rounding over the weak link, 2.7e-8 of the largest.
    "smoothed tetrahedra": lambda: crossed(
        {"method": "point", "passes": 1, "smoothing": True}, 1, load=STILL_PRESSED, **floating()
    ),
    "augmented": lambda: halves({"method": "segment", "augment": 3e-3, "adhesion": BILINEAR}, "simplex", 1),
    "augmented bricks": lambda: bricks({"method": "point", "augment": 1e-2}, 1),
    "multigrid": lambda: crossed(
        {"method": "node", "adhesion": BILINEAR}, 1, **floating(kind="iterative", petsc={"ksp_rtol": 1e-13})
    ),
}


def strips(centroids: NDArray[np.float64], bodies: NDArray[np.int32], ranks: int) -> NDArray[np.int32]:
    """As many cells for every rank; the cuts run across both bodies and through the contact zone."""
    along = centroids @ np.array([1.0, 0.3, 0.4])[-centroids.shape[1] :]
    return (np.argsort(np.argsort(along)) * ranks // len(along)).astype(np.int32)


def none_on_the_first(centroids: NDArray[np.float64], bodies: NDArray[np.int32], ranks: int) -> NDArray[np.int32]:
    return strips(centroids, bodies, max(ranks - 1, 1)) + (ranks > 1)


def a_body_a_rank(centroids: NDArray[np.float64], bodies: NDArray[np.int32], ranks: int) -> NDArray[np.int32]:
    return (bodies % ranks).astype(np.int32)


CUTS: dict[str, Partition | None] = {
    "strips": strips,
    "cell order": None,
    "an empty rank": none_on_the_first,
    "a body a rank": a_body_a_rank,
}
# On one rank there is nothing to tell from the serial run but whether a run repeats itself.
CASES = [("triangles", "strips"), ("multigrid", "strips")]
if MPI.COMM_WORLD.size > 1:
    CASES = [(scene, "strips") for scene in SCENES]
    CASES += [(scene, "cell order") for scene in ("triangles", "quadrilaterals of order 2", "tetrahedra", "bricks")]
    some = ("triangles", "a floating block", "tetrahedra", "segments", "smoothed")
    CASES += [(scene, "an empty rank") for scene in some]
    CASES += [("finite kinematics", "a body a rank"), ("multigrid", "cell order")]
serial: dict[str, Rows] = {}


def serial_history(name: str, comm: MPI.Comm) -> Rows:
    """The history of a scene on one rank, found once. Collective."""
    if name not in serial:
        mine = run(SCENES[name](), MPI.COMM_SELF).history if comm.rank == 0 else None
        serial[name] = comm.bcast(mine)
    return serial[name]


def cuts_contact(result: Run) -> bool:
    """Whether points that this rank evaluates are near facets that another one holds."""
    for p in result.contact.surface_pairs:
        meetings = zip(p.closest.candidates.facets, p.closest.candidates.points, strict=True)
        near = [p.facets.master.key[facets] for facets, points in meetings if len(points)]
        if not all(np.isin(keys, p.master.key).all() for keys in near):
            return True
    return False


@pytest.mark.parametrize(("name", "cut"), CASES)
def test_ranks_agree(name: str, cut: str, comm: MPI.Comm) -> None:
    reference = serial_history(name, comm)
    result = run(SCENES[name](), comm, partition=CUTS[cut])
    assert comm.allreduce(cuts_contact(result), op=MPI.LOR) == (comm.size > 1)
    # The scene does what it is here for: presses, and sticks where it can.
    assert max(v for row in reference for k, v in row.items() if k.startswith("contact_area@")) > 0.0
    assert result.model.scene.contact.adhesion is None or max(row["adhesion"] for row in reference) > 0.0
    # Smoothed aggregation depends on the cuts; what it converges to does not.
    assert_equal(result.history, reference, leave_out={"krylov"} if name == "multigrid" else ())
