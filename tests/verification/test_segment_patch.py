"""The contact patch test of `method = "segment"`: uniform pressure crosses any two meshes exactly."""

from __future__ import annotations

from pathlib import Path

import gmsh
import numpy as np
import pytest
from mpi4py import MPI

from piezomat.results.fields import FieldOutput
from piezomat.scene import Scene
from piezomat.simulation import run
from tests.scenes import press
from tests.verification.references import contact_patch_stress

YOUNG, HEIGHTS, SHORTENING, TILT = 1e6, (0.3, 0.7), 0.01, 20.0
PENALTY = 1e3 * YOUNG

FLAT = [([1, 1], [1, 2]), ([3, 2], [2, 1]), ([2, 1], [3, 2]), ([7, 2], [5, 1])]
SOLID = [([1, 1, 1], [1, 1, 1]), ([3, 2, 1], [2, 3, 1]), ([2, 2, 1], [3, 1, 1])]


def patch(divisions: tuple[list[int], list[int]], cells: str, order: int, passes: int, tilt: float = 0.0) -> Scene:
    """Two blocks, one on the other, tilted as a whole, their far faces moved towards each other; nu = 0."""
    dim = len(divisions[0])
    up = np.zeros(dim)
    up[0], up[-1] = -np.sin(np.radians(tilt)), np.cos(np.radians(tilt))
    geometry = {"shape": "stacked_blocks", "height": list(HEIGHTS), "divisions": list(divisions), "tilt": tilt}
    if dim == 3:
        geometry["depth"] = 0.8
    return press(
        geometry,
        mesh={"cells": cells, "order": order},
        materials={"block": {"young": YOUNG, "poisson": 0}},
        bodies={"lower": "block", "upper": "block"},
        boundaries=[
            {"on": "bottom", "displacement": [0.0] * dim},
            {"on": "top", "displacement": (-SHORTENING * up).tolist()},
        ],
        contact={"method": "segment", "passes": passes, "normal_penalty": PENALTY},
        solver={"tolerance": 1e-12},
    )


def stress_error(scene: Scene, comm: MPI.Comm, tilt: float) -> float:
    """Greatest error of any stress component in the middle of any element, over the exact pressure."""
    stress = FieldOutput(run(scene, comm).problem).piece().stress
    exact = contact_patch_stress(YOUNG, HEIGHTS, SHORTENING, PENALTY)
    s, c = np.sin(np.radians(tilt)), np.cos(np.radians(tilt))
    dim = scene.dimension
    # Voigt 11 22 33 23 13 12 of exact * up x up, up being the last axis of the stack.
    expected = np.array([s * s, c * c, 0, 0, 0, -s * c] if dim == 2 else [s * s, 0, c * c, 0, -s * c, 0]) * exact
    worst = float(np.abs(stress - expected).max(initial=0.0)) / abs(exact)
    return comm.allreduce(worst, op=MPI.MAX)


# Each mesh with all kinds of cells and both numbers of passes, but not with all of their product.
KINDS = [("simplex", 1, 1, 0.0), ("simplex", 2, 2, TILT), ("tensor", 1, 2, TILT), ("tensor", 2, 1, 0.0)]


@pytest.mark.mpi
@pytest.mark.parametrize(("cells", "order", "passes", "tilt"), KINDS)
@pytest.mark.parametrize("divisions", FLAT, ids=str)
def test_in_two_dimensions(
    comm: MPI.Comm, divisions: tuple[list[int], list[int]], cells: str, order: int, tilt: float, passes: int
) -> None:
    assert stress_error(patch(divisions, cells, order, passes, tilt), comm, tilt) < 1e-10


@pytest.mark.mpi
@pytest.mark.parametrize(("cells", "order", "passes", "tilt"), KINDS)
@pytest.mark.parametrize("divisions", SOLID, ids=str)
def test_in_three_dimensions(
    comm: MPI.Comm, divisions: tuple[list[int], list[int]], cells: str, order: int, tilt: float, passes: int
) -> None:
    assert stress_error(patch(divisions, cells, order, passes, tilt), comm, tilt) < 1e-10


def offset_blocks(path: Path) -> None:
    """A rectangle 0..1 and, on it, one 0.35..1.6, meshed with 4 and 3 elements along their sides."""
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        for body, x, width, y, divisions in (("lower", 0.0, 1.0, -0.5, 4), ("upper", 0.35, 1.25, 0.0, 3)):
            face = gmsh.model.occ.addRectangle(x, y, 0.0, width, 0.5)
            gmsh.model.occ.synchronize()
            sides = [tag for _, tag in gmsh.model.getBoundary([(2, face)], oriented=False)]
            for side in sides:
                box = gmsh.model.getBoundingBox(1, side)
                flat = box[4] - box[1] < 1e-3
                gmsh.model.mesh.setTransfiniteCurve(side, 1 + (divisions if flat else 2))
                if flat:
                    name = f"{body}_contact" if abs(box[1]) < 1e-3 else {"lower": "bottom", "upper": "top"}[body]
                    gmsh.model.addPhysicalGroup(1, [side], name=name)
            gmsh.model.mesh.setTransfiniteSurface(face)
            gmsh.model.addPhysicalGroup(2, [face], name=body)
        gmsh.model.mesh.generate(2)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


def test_blocks_that_stand_out_press_on_the_overlap_alone(tmp_path: Path) -> None:
    """Either block as slave: nothing meets beyond the end of the other, and the force is the same."""
    offset_blocks(tmp_path / "offset.msh")
    force = []
    for pair in (["lower_contact", "upper_contact"], ["upper_contact", "lower_contact"]):
        scene = press(
            {"file": tmp_path / "offset.msh"},
            materials={"block": {"young": YOUNG, "poisson": 0}},
            bodies={"lower": "block", "upper": "block"},
            boundaries=[{"on": "bottom", "displacement": [0, 0]}, {"on": "top", "displacement": [0, -0.01]}],
            contact={"method": "segment", "passes": 1, "pairs": [pair], "normal_penalty": PENALTY},
        )
        row = run(scene, MPI.COMM_SELF).history[-1]
        # The overlap is 0.65; the ends tilt, so a little less of it presses.
        assert 0.5 < row[f"contact_area@{'-'.join(pair)}"] < 0.65
        force.append(row["force_y@top"])
    # 0.5 % with quadrature points on whole facets.
    assert force[0] == pytest.approx(force[1], rel=1e-4)


def slid(steps: int) -> float:
    """Force on two half discs pressed and slid by a facet and a half in so many steps."""
    scene = press(
        {"shape": "facing_halves"},
        mesh={"size": 0.2, "contact_size": 0.05, "size_factors": {"upper": 1.3}},
        bodies={"lower": "elastic", "upper": "elastic"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": [0.075, -0.02], "follows": "slide"},
        ],
        contact={"method": "segment", "passes": 1},
        load={"steps": [steps], "factors": {"slide": [1.0]}},
    )
    return run(scene, MPI.COMM_SELF).history[-1]["force_y@top"]


def test_segments_follow_what_slides_within_a_step() -> None:
    """Without friction the way does not matter: one step ends where eight do, its segments cut anew on the way."""
    assert slid(1) == pytest.approx(slid(8), rel=1e-5)
