"""The summary of a run: what summary.json holds, and what `Result.summary` is without files."""

from __future__ import annotations

import logging
import math
import platform
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib import metadata
from typing import Any

import numpy as np
from mpi4py import MPI

from piezomat import __version__
from piezomat.contact.interfaces import Interfaces
from piezomat.discretization.model import Model
from piezomat.forms import fenicsx
from piezomat.results.ranks import described, load_per_rank
from piezomat.usage import Timer, peak_memory_mb

log = logging.getLogger("piezomat")

SUMMARY_KEYS = tuple(
    "title converged reason ranks dofs cells bodies recipe warnings steps capacitance timings peak_memory_mb shares "
    "versions".split()
)


def summary(comm: MPI.Comm, rows: Sequence[Mapping[str, Any]], values: Mapping[str, Any]) -> dict[str, Any]:
    """The summary with the keys `SUMMARY_KEYS`, in numbers that JSON has: None for what is not finite. Collective.

    `ranks`, `steps`, `peak_memory_mb` and `versions` are added; ValueError unless `values` has exactly the others.
    """
    known = {"ranks": comm.size, "steps": rows, "peak_memory_mb": peak_memory_mb(comm), "versions": versions()}
    content = known | dict(values)
    wrong = sorted(set(content) ^ set(SUMMARY_KEYS))
    if wrong:
        raise ValueError(f"keys of the summary that are missing or unknown: {', '.join(wrong)}")
    return {key: _json(content[key]) for key in SUMMARY_KEYS}


def summary_values(
    model: Model,
    contact: Interfaces | None,
    timer: Timer,
    capacitance: list[list[list[float]]],
    outcome: Mapping[str, Any],
) -> dict[str, Any]:
    """The values that `summary` asks for, of a run that has ended with this `outcome`. Collective."""
    loads = load_per_rank(model, contact)
    if model.comm.size > 1:
        log.info("%s", described(loads))
    recipe = model.scene.outcome
    return dict(outcome) | {
        "title": model.scene.title,
        "dofs": model.unknowns.total,
        "cells": model.mesh.topology.index_map(model.dim).size_global,
        "bodies": list(model.bodies.bodies),
        "recipe": None if recipe is None else asdict(recipe),
        "capacitance": {"electrodes": model.electrode_names, "matrices": capacitance},
        "timings": timer.timings(model.comm),
        "shares": loads,
    }


def versions() -> dict[str, str]:
    """Versions of piezomat and of the programs that it uses; those that are not installed are left out."""
    from petsc4py import PETSc

    found = {
        "piezomat": __version__,
        "dolfinx": fenicsx.VERSION,
        "petsc": ".".join(str(number) for number in PETSc.Sys.getVersion()),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "mpi": re.split("[,\n]", MPI.Get_library_version())[0].strip("\x00 "),
    }
    for name in ("gmsh", "mpi4py", "pyvista"):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            # a distribution's module may come without metadata
            version = getattr(sys.modules.get(name), "__version__", None)
            if version is not None:
                found[name] = str(version)
    return found


def _json(value: Any) -> Any:
    """The value with numpy's numbers as Python's, and None for what is not finite (JSON has no nan)."""
    if isinstance(value, Mapping):
        return {str(key): _json(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_json(entry) for entry in value]
    value = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(value, float) and not math.isfinite(value) else value
