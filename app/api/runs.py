"""Runs of scenes from Python, and results that are read from their folder."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mpi4py import MPI

from piezomat import simulation
from piezomat.api.result import Result
from piezomat.api.stored import InFolder, InMemory
from piezomat.assembly.problem import Problem
from piezomat.contact.interfaces import Interfaces
from piezomat.results.files import read_history
from piezomat.results.vtk import ResultsError
from piezomat.scene import Scene
from piezomat.scene.toml import Overrides

log = logging.getLogger("piezomat")


def run(
    scene: str | Path | Mapping[str, Any] | Scene,
    overrides: Overrides = (),
    *,
    comm: MPI.Comm = MPI.COMM_WORLD,
    out: str | Path | None = None,
    quiet: bool = False,
) -> Result:
    """The result of a scene: a file, a shipped scene's name, a dict of its sections or a Scene. Collective over `comm`.

    overrides: values by key, {"geometry.radius": 0.2, "boundaries.1.potential": 5}, or texts KEY=VALUE. out: folder for
    the results; without it no file is written. quiet: no progress is printed, nor is it where the level of the
    logger `piezomat` is above INFO. Warnings go to that logger, and are in the result.

    SceneError: the scene is wrong. NotConverged, Interrupted: the run has ended early.
    """
    loaded = Scene.load(scene, overrides)
    kept, folder = InMemory(), Path(out) if out is not None else None

    def keep(problem: Problem, contact: Interfaces | None, row: Mapping[str, Any]) -> None:
        kept.keep(problem, contact, row["step"])

    silent = quiet or log.level > logging.INFO
    finished = simulation.run(loaded, comm, folder, quiet=silent, watch=keep)
    return Result(finished.history, finished.summary, kept, dim=finished.model.dim, out=folder, finished=finished)


def open(directory: str | Path) -> Result:
    """The result in the folder of a run, finished or not. Not collective. ResultsError: there is none."""
    folder = Path(directory)
    history = read_history(folder / "history.csv")
    try:
        text = (folder / "summary.json").read_text(encoding="utf-8")
        summary = json.loads(text)
    except FileNotFoundError:  # a run that has not ended
        summary = {}
    except (OSError, ValueError) as error:
        raise ResultsError(f"cannot read {folder / 'summary.json'}: {error}") from error
    dim = 3 if any(name.startswith("force_z@") for row in history[:1] for name in row) else 2
    return Result(history, summary, InFolder(folder), dim=dim, out=folder)
