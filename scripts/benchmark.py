"""Processor seconds of whole runs, median of several: two fibers pressed together, in 2D and 3D, by their unknowns.

Linear elements, material pvdf, R = 0.5 um, five steps to an approach of 0.05 um, one pass of quadrature points,
normal penalty 1e5 MPa/um, electric penalty 0.1 pC/(V um2), relative residual 1e-8, one processor, one thread. A run
is a process of its own: start-up, mesh, solution; no result files. With `--ngsolve PYTHON` the same meshes, materials,
penalties, steps and tolerance go to NGSolve in that Python (see benchmark_ngsolve.py for what it does and does not
do), run in turn with ours; its mesh comes ready in a file.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from statistics import median
from typing import Any

import gmsh

ROOT = Path(__file__).parent.parent
SIZES = {
    "2d-15k": ("facing_halves", 0.008, 0.038),
    "2d-59k": ("facing_halves", 0.004, 0.019),
    "2d-235k": ("facing_halves", 0.002, 0.0095),
    "3d-20k": ("crossed_fibers", 0.0355, 0.144),
    "3d-79k": ("crossed_fibers", 0.0201, 0.091),
    "3d-236k": ("crossed_fibers", 0.013, 0.065),
    "3d-583k": ("crossed_fibers", 0.0093, 0.0485),
}
RUN = """
import json, sys
from mpi4py import MPI
from app.scene import Scene
from app.simulation import run
done = run(Scene.load(sys.argv[1]), MPI.COMM_WORLD)
last = done.history[-1]
force, potential = (last[name] for name in ("force_y@top" if done.model.dim == 2 else "force_z@top",
                                            "mean_potential@top"))
print(json.dumps({"unknowns": done.model.unknowns, "newton": [row["newton"] for row in done.history],
                  "force": force, "potential": potential, "where": done.problem.timer.seconds}))
"""


def scene(case: str) -> str:
    """The scene of a case as TOML."""
    shape, fine, far = SIZES[case]
    zeros = "0, " if shape == "facing_halves" else "0, 0, "
    return f"""
        title = "{case}"
        geometry.shape = "{shape}"
        mesh = {{ contact_size = {fine}, size = {far}, size_factors = {{ upper = 0.9 }} }}
        bodies = {{ lower = "pvdf", upper = "pvdf" }}
        contact = {{ passes = 1, normal_penalty = 1e5, electric_penalty = 0.1 }}
        load = {{ steps = [5], factors = {{ press = [1.0] }} }}
        [[boundaries]]
        on = "bottom"
        displacement = [{zeros}0]
        potential = 0
        [[boundaries]]
        on = "top"
        displacement = [{zeros}-0.05]
        follows = "press"
    """


def timed(command: list[str]) -> tuple[float, dict[str, Any]]:
    """Processor seconds of a process, and the JSON in its last line. Ends the program if that fails."""
    before = getrusage(RUSAGE_CHILDREN)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    if done.returncode:
        sys.exit(f"{command[0]} failed:\n{done.stderr}")
    after = getrusage(RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    answer = json.loads(done.stdout.splitlines()[-1])
    return seconds, answer


def for_ngsolve(mesh: Path, plain: Path) -> None:
    """The mesh as ASCII MSH 2.2, which NGSolve reads."""
    gmsh.initialize(readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(mesh))
    gmsh.option.setNumber("Mesh.MshFileVersion", 2.2)
    gmsh.option.setNumber("Mesh.Binary", 0)
    gmsh.write(str(plain))
    gmsh.finalize()


def compare(case: str, repeat: int, ngsolve: str | None) -> None:
    """Run a case so many times, the two programs in turn, and print a line for each."""
    with tempfile.TemporaryDirectory() as scratch:
        path, mesh, plain = (Path(scratch) / name for name in ("scene.toml", "mesh.msh", "plain.msh"))
        path.write_text(scene(case), encoding="utf-8")
        commands = {"piezomat": [sys.executable, "-c", RUN, str(path)]}
        if ngsolve is not None:
            timed_mesh = [sys.executable, "-m", "app", "mesh", str(path), "--out", str(mesh)]
            subprocess.run(timed_mesh, check=True, capture_output=True, cwd=ROOT)
            for_ngsolve(mesh, plain)
            commands["NGSolve"] = [ngsolve, str(ROOT / "scripts" / "benchmark_ngsolve.py"), str(plain)]
        runs = {name: [] for name in commands}
        for _ in range(repeat):
            for name, command in commands.items():
                runs[name].append(timed(command))
    for name, results in runs.items():
        seconds = sorted(cpu for cpu, _ in results)
        answer = results[0][1]
        spread = f"{seconds[0]:.1f} to {seconds[-1]:.1f}"
        print(
            f"{case:8} {name:9} {answer['unknowns']:8d} unknowns {median(seconds):8.1f} s ({spread})  "
            f"newton {answer['newton']}  force {answer['force']:.6f}  potential {answer['potential']:.5f}"
        )
        if "where" in answer:
            where = ", ".join(f"{part} {share:.1f}" for part, share in answer["where"].items() if share >= 0.05)
            print(f"{'':8} of which (wall clock): {where} s; the rest is start-up")
    if ngsolve is not None:
        ours, theirs = (median(cpu for cpu, _ in runs[name]) for name in ("piezomat", "NGSolve"))
        print(f"{case:8} NGSolve takes {theirs / ours:.1f} times as long")


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="scripts/benchmark", description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"{', '.join(SIZES)}; default: the two smallest")
    parser.add_argument("--repeat", type=int, default=3, help="runs of each (default 3)")
    parser.add_argument("--ngsolve", metavar="PYTHON", help="a Python with NGSolve (pip install ngsolve)")
    options = parser.parse_args()
    unknown = [case for case in options.cases if case not in SIZES]
    if unknown:
        parser.error(f"no case {', '.join(unknown)}; there are {', '.join(SIZES)}")
    for case in options.cases or ["2d-15k", "3d-20k"]:
        compare(case, options.repeat, options.ngsolve)


if __name__ == "__main__":
    main()
