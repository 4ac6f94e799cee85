"""Processor seconds and memory of whole runs: two fibers pressed together, in 2D and 3D, against other programs.

Linear elements, material pvdf, R = 0.5 um, five steps to an approach of 0.05 um, one pass of quadrature points,
normal penalty 1e5 MPa/um, electric penalty 0.1 pC/(V um2) that fades out over 0.002 um, relative residual 1e-8, one
processor, one thread. Each run is a process of its own and is measured with its start-up. Piezomat makes its mesh,
except with --mesh; the other programs read the same mesh from a file. The programs run in turn, and each requires its
own residual to fall to 1e-8 of its reactions. The heads of benchmark_ngsolve.py and benchmark_getfem.py say what
differs. Force and potential are printed to compare.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from statistics import median

from piezomat.meshes.gmsh_io.model import MeshError
from piezomat.scene import Scene
from scripts.studies.other_programs import PROGRAMS, installed
from scripts.studies.two_fibers import Cost, Failed, measured, run_command, scene_of_mesh, scene_of_shape, write_mesh

SIZES = {
    "2d-4k": ("facing_halves", 0.016, 0.076),
    "2d-15k": ("facing_halves", 0.008, 0.038),
    "2d-59k": ("facing_halves", 0.004, 0.019),
    "2d-235k": ("facing_halves", 0.002, 0.0095),
    "3d-20k": ("crossed_fibers", 0.0355, 0.144),
    "3d-79k": ("crossed_fibers", 0.0201, 0.091),
    "3d-236k": ("crossed_fibers", 0.013, 0.065),
    "3d-583k": ("crossed_fibers", 0.0093, 0.0485),
    "3d-1080k": ("crossed_fibers", 0.0077, 0.0401),
}
SURFACES = ("lower_contact", "upper_contact")
LAW = {"passes": 1, "normal_penalty": 1e5, "electric_penalty": 0.1, "electric_range": 0.002}


def compare(name: str, scene: Scene, surfaces: list[str], repeat: int, programs: list[str]) -> dict[str, list[Cost]]:
    """Run a case `repeat` times, the programs in turn, and print a line a program. Returns the costs by program."""
    with tempfile.TemporaryDirectory() as scratch:
        file, mesh = Path(scratch) / "scene.toml", Path(scratch) / "mesh.msh"
        file.write_text(scene.to_toml(), encoding="utf-8")
        commands = {"piezomat": (run_command(file), {})}
        for program, (command, environment) in installed(programs).items():
            commands[program] = [*command, str(mesh), "--surfaces", *surfaces], environment
        if programs:
            write_mesh(file, mesh)
        runs: dict[str, list[Cost]] = {program: [] for program in commands}
        for _ in range(repeat):
            for program, command in commands.items():
                try:
                    runs[program].append(measured(*command))
                except Failed as error:
                    print(f"{name:8} {program:9} failed: {error}", flush=True)
    for program, costs in runs.items():
        if costs:
            answer = costs[0].answer
            print(
                f"{name:8} {program:9} {answer['unknowns']:8d} unknowns {spread([c.seconds for c in costs]):>22} s "
                f"{median(c.memory for c in costs):6.0f} MB  iterations {answer['newton']}  "
                f"force {answer['force']:.6f}  potential {answer['potential']:.5f}",
                flush=True,
            )
    return runs


def spread(values: list[float]) -> str:
    """Median, least and largest."""
    digits = 1 if max(values) < 100 else 0
    return f"{median(values):.{digits}f} ({min(values):.{digits}f} to {max(values):.{digits}f})"


def where(case: str, costs: list[Cost]) -> str:
    """A row of the table of where piezomat's time goes: shares of the wall clock of the process, in per cent."""
    cost = sorted(costs, key=lambda c: c.wall)[len(costs) // 2]
    timings = cost.answer["timings"]
    parts = {name: timings[name] for name in timings if name not in ("total", "output")}
    parts["other"] = timings["total"] - sum(parts.values())
    parts["start-up"] = cost.wall - timings["total"]
    return f"{case:8} {cost.wall:.1f} s: " + ", ".join(
        f"{name} {100 * s / cost.wall:.0f} %" for name, s in parts.items()
    )


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = argparse.ArgumentParser(prog="scripts/benchmark", description=__doc__.splitlines()[0])
    made.add_argument("cases", nargs="*", metavar="CASE", help=f"{', '.join(SIZES)}; default: 2d-15k 3d-20k")
    made.add_argument(
        "--mesh",
        nargs="+",
        default=[],
        metavar="FILE",
        help="mesh files (gmsh) of two fibers of R = 0.5 um: bodies lower and upper, facet groups bottom and top",
    )
    made.add_argument(
        "--surfaces",
        nargs=2,
        default=list(SURFACES),
        metavar=("SLAVE", "MASTER"),
        help=f"facet groups of the mesh files that come into contact (default: {' '.join(SURFACES)})",
    )
    made.add_argument("--repeat", type=int, default=3, help="runs of each (default 3)")
    made.add_argument(
        "--with", dest="programs", nargs="+", choices=list(PROGRAMS), default=[], help="programs, installed if need be"
    )
    return made


def cases_of(options: argparse.Namespace) -> dict[str, tuple[Scene, list[str]]]:
    """Name -> scene and contact surfaces of what the command line lists. Raises ValueError, MeshError."""
    unknown = [case for case in options.cases if case not in SIZES]
    if unknown:
        raise ValueError(f"no case {', '.join(unknown)}; there are {', '.join(SIZES)}")
    default = [] if options.mesh else ["2d-15k", "3d-20k"]
    cases = {case: (scene_of_shape(*SIZES[case], LAW), list(SURFACES)) for case in options.cases or default}
    for file in options.mesh:
        scene = scene_of_mesh(Path(file), LAW | {"pairs": [options.surfaces]})
        cases[Path(file).name] = scene, options.surfaces
    return cases


def main() -> None:
    """Run what the command line lists and print the tables."""
    options = parser().parse_args()
    try:
        cases = cases_of(options)
    except (ValueError, MeshError) as error:
        parser().error(str(error))
    print(__doc__.split("\n\n", 1)[1])
    results = {name: compare(name, *case, options.repeat, options.programs) for name, case in cases.items()}
    print("\nwhere the time of piezomat goes (wall clock)")
    for case, runs in results.items():
        if runs["piezomat"]:
            print(where(case, runs["piezomat"]))
    for program in options.programs:
        print(f"\n{program} over piezomat, run by run: processor seconds, memory")
        for case, runs in results.items():
            pairs = list(zip(runs["piezomat"], runs[program], strict=False))
            if pairs:
                seconds = spread([theirs.seconds / ours.seconds for ours, theirs in pairs])
                memory = median(theirs.memory / ours.memory for ours, theirs in pairs)
                print(f"{case:8} {seconds}  {memory:.2f}")


if __name__ == "__main__":
    main()
