"""Two fibers pressed together, for benchmark and chart: the scene, its mesh for other programs, the cost of a run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import gmsh

from piezomat.meshes.gmsh_io.mesh_file import read_groups
from piezomat.meshes.gmsh_io.model import MeshError
from piezomat.scene import Scene

ROOT = Path(__file__).parents[2]
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}


def scene_of_shape(
    shape: str,
    fine: float,
    far: float,
    contact: dict[str, Any],
    *,
    order: int = 1,
    material: str = "pvdf",
    approach: float = 0.05,
    steps: int = 5,
) -> Scene:
    """Two half fibers of R = 0.5 um, grounded below, pressed by an approach (um) of their flat faces."""
    mesh = {"contact_size": fine, "size": far, "size_factors": {"upper": 0.9}, "order": order}
    dim = 2 if shape == "facing_halves" else 3
    return _pressed(dim, {"shape": shape}, contact, mesh=mesh, material=material, approach=approach, steps=steps)


def scene_of_mesh(path: Path, contact: dict[str, Any], approach: float = 0.05, steps: int = 5) -> Scene:
    """The same for a mesh file with bodies `lower`, `upper` and facet groups `bottom`, `top`. Raises MeshError."""
    dim, bodies, facets = read_groups(path)
    missing = sorted({"lower", "upper", "bottom", "top", *contact["pairs"][0]} - {*bodies, *facets})
    if missing:
        raise MeshError(f"{path} has no group {', '.join(missing)}; it has {', '.join([*bodies, *facets])}")
    geometry = {"file": str(path.absolute())}
    return _pressed(dim, geometry, contact, mesh={}, material="pvdf", approach=approach, steps=steps)


def _pressed(
    dim: int,
    geometry: dict[str, str],
    contact: dict[str, Any],
    *,
    mesh: dict[str, Any],
    material: str,
    approach: float,
    steps: int,
) -> Scene:
    """Bodies `lower` and `upper`: `bottom` is fixed and grounded, `top` moves down by the approach (um)."""
    zeros = [0.0] * (dim - 1)
    grounded = {"potential": 0.0} if material == "pvdf" else {}
    return Scene(
        geometry=geometry,
        mesh=mesh,
        bodies={"lower": material, "upper": material},
        contact=contact,
        load={"steps": [steps], "factors": {"press": [1.0]}},
        boundaries=[
            {"on": "bottom", "displacement": [*zeros, 0.0], **grounded},
            {"on": "top", "displacement": [*zeros, -approach], "follows": "press"},
        ],
    )


def write_mesh(scene: Path, path: Path) -> None:
    """Write the mesh of a scene file as ASCII MSH 2.2, which other programs read."""
    with tempfile.TemporaryDirectory() as scratch:
        mesh = Path(scratch) / "mesh.msh"
        command = [sys.executable, "-m", "piezomat", "mesh", str(scene), "--out", str(mesh)]
        subprocess.run(command, check=True, capture_output=True, cwd=ROOT)
        gmsh.initialize(readConfigFiles=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(mesh))
    gmsh.option.setNumber("Mesh.MshFileVersion", 2.2)
    gmsh.option.setNumber("Mesh.Binary", 0)
    gmsh.write(str(path))
    gmsh.finalize()


@dataclass
class Cost:
    """Processor and wall seconds and largest memory (MB) of a process, and the JSON in its last line."""

    seconds: float
    wall: float
    memory: float
    answer: dict[str, Any]


class Failed(RuntimeError):
    """A process ended in error; the message is the last line of its standard error."""


def measured(command: list[str], environment: dict[str, str] | None = None) -> Cost:
    """Run a process to its end on one thread. Raises Failed."""
    variables = {**os.environ, "PYTHONPATH": str(ROOT), **ONE_THREAD, **(environment or {})}
    # Installed packages come with byte code; piezomat keeps its own only without this variable.
    variables.pop("PYTHONDONTWRITEBYTECODE", None)
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as errors:
        start = perf_counter()
        process = subprocess.Popen(command, stdout=out, stderr=errors, env=variables)
        _, status, usage = os.wait4(process.pid, 0)
        wall = perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        errors.seek(0)
        if process.returncode:
            lines = errors.read().strip().splitlines()
            raise Failed(lines[-1] if lines else f"exit status {process.returncode}")
        answer = json.loads(out.read().splitlines()[-1])
    return Cost(usage.ru_utime + usage.ru_stime, wall, usage.ru_maxrss / 1024, answer)


def run_command(scene: Path) -> list[str]:
    """The command that runs a scene file with piezomat and writes no results."""
    return [sys.executable, "-m", "scripts.studies.benchmark_run", str(scene)]
