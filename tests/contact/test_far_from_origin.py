"""A scene far from the origin gives the forces that it gives at the origin: gaps lose no digits."""

from __future__ import annotations

from pathlib import Path

import gmsh
import numpy as np
import pytest
from mpi4py import MPI

from piezomat.meshes.body_mesh import write
from piezomat.results.fields import contact_points
from piezomat.scene import Scene
from piezomat.simulation import Run, run
from tests.histories import scales

FAR = 1e5  # um; the blocks measure one
# A mesh file's numbers are rounded to 7e-12 um there. Penetrations of 1e-3 um show that as 1e-8.
EQUAL = 1e-7


def stack(dimension: int, tilt: float = 0.0) -> Scene:
    """Two blocks on each other that do not match, turned by `tilt`."""
    depth = {} if dimension == 2 else {"depth": 1.0}
    divisions = [[4, 2], [6, 3]] if dimension == 2 else [[3, 3, 1], [4, 4, 2]]
    geometry = {"shape": "stacked_blocks", "height": [0.5, 0.5], "divisions": divisions, "tilt": tilt, **depth}
    held = [{"on": "bottom", "displacement": [0] * dimension}]
    return Scene(geometry=geometry, bodies={"*": "pvdf"}, boundaries=held)


def moved(scene: Scene, path: Path, shift: list[float], comm: MPI.Comm) -> Path:
    """Write the scene's mesh, moved by `shift`. Collective."""
    write(comm, scene.geometry, scene.sizes, path)
    if comm.rank == 0:
        gmsh.initialize(interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(path))
        x, y, z = (*shift, 0.0)[:3]
        gmsh.model.mesh.affineTransform([1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z])
        gmsh.write(str(path))
        gmsh.finalize()
    comm.barrier()
    return path


def assert_alike(far: Run, near: Run) -> None:
    """The histories agree, but for the path: whether surfaces that just touch have a gap is rounding's choice."""
    of = scales(near.history)
    of["stabilization"] = of["elastic"]  # that of rounding: 1e-9 pJ
    for name, scale in of.items():
        if name in ("newton", "linear_solves", "krylov"):
            continue
        ours, theirs = (np.array([row[name] for row in each.history]) for each in (far, near))
        assert np.abs(ours - theirs).max() <= EQUAL * (scale or 1.0), name


@pytest.mark.mpi
@pytest.mark.parametrize(("dimension", "method"), [(2, "segment"), (2, "node"), (3, "point")])
def test_tilted_blocks(comm: MPI.Comm, shared_tmp_path: Path, dimension: int, method: str) -> None:
    found = []
    for number, far in enumerate((0.0, FAR)):
        shift = [far * share for share in (1.0, -0.3, 0.7)[:dimension]]
        scene = Scene(
            geometry={"file": str(moved(stack(dimension, 15.0), shared_tmp_path / f"{number}.msh", shift, comm))},
            bodies={"lower": "pvdf", "upper": "pvdf"},
            boundaries=[
                {"on": "bottom", "displacement": [0] * dimension, "potential": 0},
                {"on": "top", "displacement": [0.002, -0.01] if dimension == 2 else [0.002, 0, -0.01], "potential": 1},
            ],
            contact={"method": method, "adhesion": {"law": "bilinear", "strength": 5.0, "energy": 0.05}},
            load={"steps": [2]},
            output={"fields": "none", "picture": False},
        )
        found.append(run(scene, comm))
    assert found[0].history[-1]["contact_area@lower-upper"] > 0.5
    assert_alike(*reversed(found))


@pytest.mark.mpi
@pytest.mark.parametrize("dimension", [2, 3])
def test_planes(comm: MPI.Comm, shared_tmp_path: Path, dimension: int) -> None:
    found = []
    for number, far in enumerate((0.0, FAR)):
        shift = [far] * dimension
        scene = Scene(
            geometry={"file": str(moved(stack(dimension), shared_tmp_path / f"{number}.msh", shift, comm))},
            bodies={"lower": "pvdf", "upper": "pvdf"},
            boundaries=[{"on": "left", "displacement": [0, *["free"] * (dimension - 1)]}],
            contact={},
            planes=[
                {"name": "floor", "point": "bottom", "potential": 0},
                {
                    "name": "lid",
                    "point": [*shift[:-1], far + 1.0],
                    "normal": [*[0.0] * (dimension - 1), -1.0],
                    "motion": [*[0.0] * (dimension - 1), -0.01],
                    "potential": 1.0,
                },
            ],
            load={"steps": [2]},
            output={"fields": "none", "picture": False},
        )
        found.append(run(scene, comm))
        points = contact_points(found[-1].contact, found[-1].problem.model)
        high = comm.allreduce(points.position[:, dimension - 1].max(initial=-np.inf), op=MPI.MAX)
        assert high == pytest.approx(far + 0.99, abs=1e-3)
    assert abs(found[0].history[-1]["charge@lid"]) > 0.0
    assert_alike(*reversed(found))
