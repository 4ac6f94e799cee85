"""Parameter studies: one scene with other values of some keys, each combination a run, all in one table."""

from __future__ import annotations

import csv
import hashlib
import io
import itertools
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

from mpi4py import MPI

from piezomat import environment, simulation
from piezomat.api import runs
from piezomat.api.result import table
from piezomat.assembly.problem import Problem
from piezomat.contact.interfaces import Interfaces
from piezomat.meshes.parallel import on_root
from piezomat.progress import Progress
from piezomat.results.atomic import write_text
from piezomat.results.checkpoint import CheckpointError
from piezomat.results.files import read_history
from piezomat.results.folder import CHECKPOINT
from piezomat.results.run_scene import text_of
from piezomat.scene import Scene
from piezomat.scene.errors import shown

LONGEST = 80  # characters of a case's folder


@dataclass(frozen=True)
class Case:
    """One combination of values: by key, its scene, the name of its folder."""

    values: dict[str, Any]
    scene: Scene
    name: str


def sweep(
    scene: str | Path | Mapping[str, Any] | Scene,
    values: Mapping[str, Iterable[Any]],
    overrides: Mapping[str, Any] | None = None,
    *,
    steps: Literal["last", "all"] = "last",
    ranks: int = 1,
    out: str | Path | None = None,
    quiet: bool = False,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> Any:
    """A table of runs of a scene, one for each combination of the values of some keys. Collective over `comm`.

    values: {"geometry.radius": [0.2, 0.3], "contact.method": ["node", "point"]}; overrides: of all runs, by key.
    Columns: these keys, `converged`, and those of the history. A row for each run, of its last step, or with
    steps="all" for each step. A DataFrame with pandas, else a dict of arrays by column.
    out: each run has its results in a folder there, the table is `sweep.csv`, and runs that are done there are not
    repeated: a study that was interrupted goes on where it ended. ranks: processes of each run, which mpirun starts.

    All scenes are checked before the first run (SceneError). A run that does not converge keeps the steps that did.
    Interrupted: a signal came.
    """
    if ranks > 1 and comm.size > 1:
        raise ValueError("sweep(ranks=...) starts mpirun itself: call it on one rank, or leave ranks out")
    cases = _cases(scene, values, overrides or {})
    folder = Path(out) if out is not None else None
    rows: list[dict[str, Any]] = []
    title = f"{len(cases)} runs: {', '.join(values)}"
    with Progress(comm, title, len(cases), 0, quiet=quiet) as progress:
        for number, case in enumerate(cases, 1):
            began = perf_counter()
            history, converged, how = _rows(case, folder, ranks, comm)
            for row in history if steps == "all" else history[-1:] or [{}]:
                rows.append({key: _cell(value) for key, value in case.values.items()} | {"converged": converged} | row)
            what = ", ".join(f"{key} = {shown(value)}" for key, value in case.values.items())
            state = how if converged else f"{how}, NOT converged after step {len(history)}"
            progress.done(f"run {number}/{len(cases)}  {what}  {state}  {perf_counter() - began:.1f} s")
            if folder is not None:
                on_root(comm, lambda: write_text(folder / "sweep.csv", _csv(rows)))
    return table(rows)


def _cases(scene: Any, values: Mapping[str, Iterable[Any]], overrides: Mapping[str, Any]) -> list[Case]:
    keys = list(values)
    cases, names = [], set()
    for combination in itertools.product(*(list(values[key]) for key in keys)):
        chosen = dict(zip(keys, combination, strict=True))
        name = _name(chosen)
        if name in names:
            name = f"{name}_{len(names)}"
        names.add(name)
        cases.append(Case(chosen, Scene.load(scene, {**overrides, **chosen}), name))
    return cases


def _name(values: Mapping[str, Any]) -> str:
    """The folder of a case: its values, and a digest where these are too long for a name."""
    last = [key.rpartition(".")[2] for key in values]
    keys = last if len(set(last)) == len(last) else list(values)
    text = ",".join(f"{key}={value}" for key, value in zip(keys, values.values(), strict=True))
    name = re.sub(r"[^\w.=,+-]+", "_", text).lstrip(".-") or "run"
    if name == text and len(name) <= LONGEST:
        return name
    return f"{name[:LONGEST]}_{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def _rows(case: Case, folder: Path | None, ranks: int, comm: MPI.Comm) -> tuple[list[dict[str, Any]], bool, str]:
    """History of a case, whether it has converged, and whether it was run or found. Collective."""
    out = folder / case.name if folder is not None else None
    state = on_root(comm, lambda: _state(out, case.scene)) if out is not None else "new"
    if state == "done":
        return on_root(comm, lambda: _read(out, "found"))
    if ranks == 1:
        return _run_here(case, out, comm, resume=state == "begun")
    if out is not None:
        return _run_with_mpirun(case, out, ranks, resume=state == "begun")
    with tempfile.TemporaryDirectory(prefix="piezomat-sweep-") as made:
        return _run_with_mpirun(case, Path(made) / case.name, ranks, resume=False)


def _state(out: Path, scene: Scene) -> str:
    """What there is of a run of this scene: "done", "begun" (a checkpoint) or "new"."""
    try:
        if (out / "scene.toml").read_text(encoding="utf-8") != text_of(scene):
            return "new"
        summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
        if summary["converged"] or not summary["reason"].startswith("interrupted"):
            return "done"
    except (OSError, ValueError, KeyError):
        pass
    return "begun" if any((out / CHECKPOINT).glob("step_*.npz")) else "new"


def _run_here(case: Case, out: Path | None, comm: MPI.Comm, *, resume: bool) -> tuple[list[dict[str, Any]], bool, str]:
    rows: list[dict[str, Any]] = []

    def watch(problem: Problem, contact: Interfaces | None, row: Mapping[str, Any]) -> None:
        rows.append(dict(row))

    try:
        history = simulation.run(case.scene, comm, out, resume=resume, quiet=True, watch=watch).history
    except CheckpointError:
        return _run_here(case, out, comm, resume=False)
    except simulation.NotConverged:
        return (rows, False, "done") if out is None else on_root(comm, lambda: _read(out, "done"))
    return history, True, "resumed" if resume else "done"


def _run_with_mpirun(case: Case, out: Path, ranks: int, *, resume: bool) -> tuple[list[dict[str, Any]], bool, str]:
    with tempfile.TemporaryDirectory(prefix="piezomat-sweep-") as made:
        path = Path(made) / "scene.toml"
        path.write_text(text_of(case.scene), encoding="utf-8")
        what = ["resume", str(out)] if resume else ["run", str(path), "--out", str(out)]
        command = ["mpirun", "-n", str(ranks), sys.executable, "-m", "mpi4py", "-m", "piezomat", *what]
        done = subprocess.run(
            command, env=environment.for_mpirun(), stdin=subprocess.DEVNULL, capture_output=True, text=True
        )
    if done.returncode not in (0, 3):
        raise RuntimeError(f"{case.name}: {' '.join(done.stderr.split()) or f'mpirun ended with {done.returncode}'}")
    return _read(out, "resumed" if resume else "done")


def _read(out: Path, how: str) -> tuple[list[dict[str, Any]], bool, str]:
    return read_history(out / "history.csv"), runs.open(out).converged, how


def _cell(value: Any) -> Any:
    """A value of a key as a cell of the table: numbers and text as they are, the rest as TOML writes it."""
    return value if isinstance(value, (bool, int, float, str)) else shown(value)


def _csv(rows: Sequence[Mapping[str, Any]]) -> str:
    text = io.StringIO()
    names = list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.DictWriter(text, names, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
