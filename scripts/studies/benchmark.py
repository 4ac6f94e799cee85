"""Processor seconds and memory of whole runs: two fibers pressed together, in 2D and 3D, against other programs.

Linear elements, material pvdf, R = 0.5 um, five steps to an approach of 0.05 um, one pass of quadrature points,
normal penalty 1e5 MPa/um, electric penalty 0.1 pC/(V um2) that fades out over 0.002 um, relative residual 1e-8, one
processor, one thread. A run is a process of its own, start-up included; ours makes its mesh, others get the same mesh
in a file. The programs run in turn. What is equal and what is not stands in the heads of benchmark_ngsolve.py and
benchmark_getfem.py; each program asks its own residual to fall to 1e-8 of its reactions. Force and potential are
printed to compare.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from statistics import median

from scripts.studies.other_programs import OTHERS, installed
from scripts.studies.two_fibers import Cost, Failed, measured, pressed, run_of, write_mesh

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
LAW = {"passes": 1, "normal_penalty": 1e5, "electric_penalty": 0.1, "electric_range": 0.002}


def compare(case: str, repeat: int, others: list[str]) -> dict[str, list[Cost]]:
    """Run a case so many times, the programs in turn; a line a program, then where the time of ours goes."""
    with tempfile.TemporaryDirectory() as scratch:
        scene, mesh = Path(scratch) / "scene.toml", Path(scratch) / "mesh.msh"
        scene.write_text(pressed(*SIZES[case], LAW).to_toml(), encoding="utf-8")
        commands = {"piezomat": (run_of(scene), {})}
        for name, (command, environment) in installed(others).items():
            commands[name] = [*command, str(mesh)], environment
        if others:
            write_mesh(scene, mesh)
        runs: dict[str, list[Cost]] = {name: [] for name in commands}
        for _ in range(repeat):
            for name, command in commands.items():
                try:
                    runs[name].append(measured(*command))
                except Failed as error:
                    print(f"{case:8} {name:9} failed: {error}", flush=True)
    for name, costs in runs.items():
        if costs:
            answer = costs[0].answer
            print(
                f"{case:8} {name:9} {answer['unknowns']:8d} unknowns {spread([c.seconds for c in costs]):>22} s "
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
    """A row of the table of where the time of our run goes: shares of the process's wall clock, in per cent."""
    cost = sorted(costs, key=lambda c: c.wall)[len(costs) // 2]
    timings = cost.answer["timings"]
    parts = {name: timings[name] for name in timings if name not in ("total", "output")}
    parts["other"] = timings["total"] - sum(parts.values())
    parts["start-up"] = cost.wall - timings["total"]
    return f"{case:8} {cost.wall:.1f} s: " + ", ".join(
        f"{name} {100 * s / cost.wall:.0f} %" for name, s in parts.items()
    )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="scripts/benchmark", description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"{', '.join(SIZES)}; default: 2d-15k 3d-20k")
    parser.add_argument("--repeat", type=int, default=3, help="runs of each (default 3)")
    parser.add_argument(
        "--with", dest="others", nargs="+", choices=list(OTHERS), default=[], help="programs, installed if need be"
    )
    options = parser.parse_args()
    unknown = [case for case in options.cases if case not in SIZES]
    if unknown:
        parser.error(f"no case {', '.join(unknown)}; there are {', '.join(SIZES)}")
    print(__doc__.split("\n\n", 1)[1])
    results = {case: compare(case, options.repeat, options.others) for case in options.cases or ["2d-15k", "3d-20k"]}
    print("\nwhere the time of piezomat goes (wall clock)")
    for case, runs in results.items():
        print(where(case, runs["piezomat"]))
    for name in options.others:
        print(f"\n{name} over piezomat, run by run: processor seconds, memory")
        for case, runs in results.items():
            pairs = list(zip(runs["piezomat"], runs[name], strict=False))
            if pairs:
                seconds = spread([theirs.seconds / ours.seconds for ours, theirs in pairs])
                memory = median(theirs.memory / ours.memory for ours, theirs in pairs)
                print(f"{case:8} {seconds}  {memory:.2f}")


if __name__ == "__main__":
    main()
