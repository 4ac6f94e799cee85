"""A run of piezomat that writes no results: python -m scripts.studies.benchmark_run SCENE, one JSON line."""

from __future__ import annotations

import json
import sys

from mpi4py import MPI

from piezomat.usage import importing

with importing():  # as the command line does
    from piezomat.scene import Scene
    from piezomat.simulation import run

done = run(Scene.load(sys.argv[1]), MPI.COMM_WORLD)
last = done.history[-1]
answer = {
    "unknowns": done.model.unknowns.total,
    "newton": [row["newton"] for row in done.history],
    "linear_solves": [row["linear_solves"] for row in done.history],
    "force": last["force_y@top" if done.model.dim == 2 else "force_z@top"],
    "potential": last.get("mean_potential@top"),
    "pressure": next(value for name, value in last.items() if name.startswith("max_pressure@")),  # of the one pair
    "timings": done.problem.timer.timings(MPI.COMM_WORLD),
}
print(json.dumps(answer))
