"""Two fibers pressed together, for benchmark and chart: the scene, its mesh for other programs, and a run's cost."""

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

from piezomat.scene import Scene

ROOT = Path(__file__).parents[2]
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}


def pressed(
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
    """Two halves of fibers of R = 0.5 um, earthed below, pressed by an approach (um) of their flat sides."""
    zeros = [0.0] if shape == "facing_halves" else [0.0, 0.0]
    earthed = {"potential": 0.0} if material == "pvdf" else {}
    return Scene(
        geometry={"shape": shape},
        mesh={"contact_size": fine, "size": far, "size_factors": {"upper": 0.9}, "order": order},
        bodies={"lower": material, "upper": material},
        contact=contact,
        load={"steps": [steps], "factors": {"press": [1.0]}},
        boundaries=[
            {"on": "bottom", "displacement": [*zeros, 0.0], **earthed},
            {"on": "top", "displacement": [*zeros, -approach], "follows": "press"},
        ],
    )


def write_mesh(scene: Path, path: Path) -> None:
    """The mesh of a scene file as ASCII MSH 2.2, which other programs read."""
    with tempfile.TemporaryDirectory() as scratch:
        mesh = Path(scratch) / "mesh.msh"
        command = [sys.executable, "-m", "app", "mesh", str(scene), "--out", str(mesh)]
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
    """A process ended in error; the message is the end of what it said."""


def measured(command: list[str], environment: dict[str, str] | None = None) -> Cost:
    """Run a process to its end on one thread. Raises Failed."""
    variables = {**os.environ, "PYTHONPATH": str(ROOT), **ONE_THREAD, **(environment or {})}
    # What is installed brings its byte code along; Python is to keep ours too, as it does unless told not to.
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
            said = errors.read().strip().splitlines()
            raise Failed(said[-1] if said else f"exit status {process.returncode}")
        answer = json.loads(out.read().splitlines()[-1])
    return Cost(usage.ru_utime + usage.ru_stime, wall, usage.ru_maxrss / 1024, answer)


def run_of(scene: Path) -> list[str]:
    """The command that runs a scene file with piezomat and writes no results."""
    return [sys.executable, "-m", "scripts.studies.benchmark_run", str(scene)]
