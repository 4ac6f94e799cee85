"""State of a run in a checkpoint: saved at the end of a step, restored on any number of ranks."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from piezomat import __version__
from piezomat.assembly.problem import Problem
from piezomat.discretization.model import Model
from piezomat.forms import fenicsx
from piezomat.meshes.parallel import on_root
from piezomat.results import checkpoint
from piezomat.results.energy_balance import EnergyBalance
from piezomat.results.folder import CHECKPOINT, MESH
from piezomat.results.run_scene import check_unchanged
from piezomat.scene import Scene
from piezomat.scene.errors import dotted
from piezomat.solver.load_steps import Stepper


class Scalars(BaseModel):
    """What a checkpoint holds beside nodal values and contact points; of an older version without the last seven.

    scene: the scene of the run as TOML. mesh: SHA-256 of its mesh file. version: of piezomat that has written it.
    references: unknowns of the reference nodes, potentials first. capacitance: matrices of the electrodes after each
    step. of_terms: numbers in the histories of the terms, which an older version has beside the others.
    """

    model_config = ConfigDict(strict=True, frozen=True)

    history: list[dict[str, int | float | str]]
    size: float
    motion: float
    external_work: float
    stabilization: float
    scene: str | None = None
    mesh: str | None = None
    version: str = "0.1.0 or older"
    references: list[float] = []
    stabilization_factor: float | None = None
    of_terms: dict[str, float] = {}
    capacitance: list[list[list[float]]] = []

    @model_validator(mode="before")
    @classmethod
    def _of_older_version(cls, data: Any) -> Any:
        if not isinstance(data, dict) or "of_terms" in data:
            return data
        return data | {"of_terms": {name: data[name] for name in ("penetration", "places") if name in data}}


def save(
    folder: Path,
    step: int,
    problem: Problem,
    stepper: Stepper,
    balance: EnergyBalance,
    history: list[dict[str, Any]],
    capacitance: list[list[list[float]]],
    scene: str,
    mesh: str,
) -> None:
    """Write the end of a step, problem and contact being evaluated there, to a folder of checkpoints. Collective.

    capacitance, scene, mesh: see `Scalars`. Raises what `checkpoint.save` does.
    """
    model, constraints = problem.model, problem.model.constraints
    ids = _node_ids(model)
    nodal = {
        "state": (ids, model.unknowns.by_node(problem.state)),
        "forces": (ids, model.unknowns.by_node(balance.forces)),
    }
    histories = problem.saved_histories()
    scalars = {
        "history": history,
        **stepper.saved(),
        "of_terms": histories.scalars,
        "external_work": balance.external_work,
        "stabilization": balance.stabilization_work,
        "scene": scene,
        "mesh": mesh,
        "version": __version__,
        "capacitance": capacitance,
        "references": constraints.references.values(problem.state).tolist(),
    }
    checkpoint.save(problem.comm, folder, step, nodal, histories.points, scalars)


def find(comm: MPI.Comm, out: Path, scene: Scene) -> checkpoint.Checkpoint:
    """The newest sound checkpoint of the run in `out`, of this scene and of the mesh beside it. Collective.

    Its scalars are a `Scalars`. CheckpointError: there is none. SceneError: the scene is another one
    (`run_scene.check_unchanged`).
    """
    folder = out / CHECKPOINT
    stored = checkpoint.load(comm, folder, _checked)

    def check() -> None:
        if stored.scalars.scene is not None:
            check_unchanged(scene, stored.scalars.scene, stored.step, out)
        if not (folder / MESH).is_file():
            raise checkpoint.CheckpointError(f"there is no mesh in {folder}")
        if stored.scalars.mesh not in (None, sha256(folder / MESH)):
            raise checkpoint.CheckpointError(f"{folder / MESH} is not the mesh that the run began with")

    try:
        on_root(comm, check)
    except OSError as error:
        raise checkpoint.CheckpointError(f"cannot read {folder / MESH}: {error.strerror or error}") from error
    return stored


def restore(stored: checkpoint.Checkpoint, problem: Problem, stepper: Stepper, balance: EnergyBalance) -> None:
    """Take state and contact from a checkpoint that was found; they then hold what they held. Collective.

    What an evaluation computes is left out. CheckpointError: the checkpoint does not fit the problem.
    """
    model = problem.model
    scalars: Scalars = stored.scalars
    ids, width = _node_ids(model), model.unknowns.block
    state, forces = (stored.nodal(name, ids, width) for name in ("state", "forces"))
    model.unknowns.set_by_node(problem.state, state)
    references = model.constraints.references
    if len(scalars.references) == len(references):
        references.set_values(problem.state, scalars.references)
    last = scalars.history[-1] if scalars.history else {}
    factors = {name: last.get(f"factor:{name}", 0.0) for name in model.scene.load.factors}
    try:
        problem.resume(factors, stored.points, scalars.of_terms)
    except KeyError as error:  # the same on all ranks
        raise checkpoint.CheckpointError(f"{stored.path} has no number {error} of the terms' histories") from None
    balance.resume(scalars.external_work, scalars.stabilization, forces)
    stepper.resume(scalars.size, scalars.motion, scalars.stabilization_factor)


def sha256(path: Path) -> str:
    """Digest of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _checked(step: int, scalars: Any) -> Scalars:
    """The scalars of a checkpoint of that step; ValueError where they are none."""
    try:
        found = Scalars.model_validate(scalars)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise ValueError(f"{dotted(first['loc'])}: {first['msg']}") from None
    if [row.get("step") for row in found.history] != list(range(1, step + 1)):
        raise ValueError(f"its history is not that of {step} steps")
    return found


def _node_ids(model: Model) -> NDArray[np.int64]:
    """Numbers of the owned nodes in the mesh file."""
    unknowns = model.unknowns
    ids = np.zeros(unknowns.local, np.int64)
    ids[fenicsx.dofmap(unknowns.space)] = fenicsx.node_ids(model.mesh)[fenicsx.geometry_dofmap(model.mesh)]
    return ids[: unknowns.owned]
