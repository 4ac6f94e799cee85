"""State of a run in a checkpoint: saved at the end of a step, restored on any number of ranks."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from piezomat import __version__
from piezomat.assembly.problem import Problem
from piezomat.contact.interfaces import Interfaces
from piezomat.discretization.model import Model
from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.meshes.parallel import on_root
from piezomat.results import checkpoint
from piezomat.results.energy_balance import EnergyBalance
from piezomat.results.folder import CHECKPOINT, MESH
from piezomat.results.quantities import augments
from piezomat.results.run_scene import check_unchanged
from piezomat.scene import Scene
from piezomat.scene.errors import dotted
from piezomat.solver.load_steps import Stepper

Points = dict[str, tuple[NDArray[np.int64], Array]]


class Scalars(BaseModel):
    """What a checkpoint holds beside nodal values and contact points; of an older version without the last five.

    scene: the scene of the run as TOML. mesh: SHA-256 of its mesh file. version: of piezomat that has written it.
    references: unknowns of the electrodes' reference nodes. capacitance: matrices of the electrodes after each step.
    """

    model_config = ConfigDict(strict=True, frozen=True)

    history: list[dict[str, int | float | str]]
    size: float
    motion: float
    penetration: float
    places: int
    external_work: float
    stabilization: float
    scene: str | None = None
    mesh: str | None = None
    version: str = "0.1.0 or older"
    references: list[float] = []
    capacitance: list[list[list[float]]] = []


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
    model, contact, ties = problem.model, problem.contact, problem.model.constraints.ties
    ids = _node_ids(model)
    nodal = {
        "state": (ids, model.unknowns.by_node(problem.state)),
        "forces": (ids, model.unknowns.by_node(balance.forces)),
    }
    scalars = {
        "history": history,
        "size": stepper.size,
        "motion": stepper.last_motion,
        "penetration": contact.last_penetration if contact is not None else 0.0,
        "places": contact.points_per_facet() if contact is not None else 0,
        "external_work": balance.external_work,
        "stabilization": balance.stabilization_work,
        "scene": scene,
        "mesh": mesh,
        "version": __version__,
        "capacitance": capacitance,
        "references": ties.values(problem.state).tolist() if ties else [],
    }
    points = _points(contact, augmented=augments(model)) if contact is not None else {}
    checkpoint.save(problem.comm, folder, step, nodal, points, scalars)


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
    model, contact = problem.model, problem.contact
    scalars: Scalars = stored.scalars
    ids, width = _node_ids(model), model.unknowns.block
    for vector, name in ((problem.state, "state"), (balance.forces, "forces")):
        model.unknowns.set_by_node(vector, stored.nodal(name, ids, width))
    if len(scalars.references) == len(model.constraints.electrodes):
        model.constraints.ties.set_values(problem.state, scalars.references)
    balance.external_work = scalars.external_work
    balance.stabilization_work = scalars.stabilization
    stepper.size = scalars.size
    stepper.last_motion = scalars.motion
    if contact is not None:
        _restore_contact(contact, stored, augmented=augments(model))


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


def _points(contact: Interfaces, *, augmented: bool) -> Points:
    """History and multipliers of contact points, by their keys."""
    known = [p.history.touched for p in contact.point_sets]
    keys = np.concatenate([p.keys()[k] for p, k in zip(contact.point_sets, known, strict=True)])
    opening = np.concatenate([p.history.opening[k] for p, k in zip(contact.point_sets, known, strict=True)])
    points = {"opening": (keys, opening[:, None])}
    if augmented:
        shifts = [np.stack([p.multipliers.gap, p.multipliers.jump], axis=2).reshape(-1, 2) for p in contact.point_sets]
        points["shift"] = (np.concatenate([p.corner_keys() for p in contact.point_sets]), np.concatenate(shifts))
    if contact.has_segments:
        # Where pieces lie follows from states before this one.
        points["place"] = (
            np.concatenate([p.keys() for p in contact.surface_pairs]),
            np.concatenate([p.points.xi for p in contact.surface_pairs]),
        )
    return points


def _restore_contact(contact: Interfaces, stored: checkpoint.Checkpoint, *, augmented: bool) -> None:
    scalars: Scalars = stored.scalars
    contact.last_penetration = scalars.penetration
    for p in contact.surface_pairs:
        if p.segments:
            every = p.possible_keys(scalars.places)
            width = p.points.xi.shape[1]
            p.restore_points(*stored.points("place", every, width), scalars.places)
    for p in contact.point_sets:
        values, found = stored.points("opening", p.keys(), 1)
        p.history.touched[:] = found
        p.history.opening[:] = np.where(found, values[:, 0], 0.0)
        if augmented:
            values, _ = stored.points("shift", p.corner_keys(), 2)
            p.multipliers.gap[:], p.multipliers.jump[:] = values.T.reshape(2, *p.multipliers.gap.shape)


def _node_ids(model: Model) -> NDArray[np.int64]:
    """Numbers of the owned nodes in the mesh file."""
    unknowns = model.unknowns
    ids = np.zeros(unknowns.local, np.int64)
    ids[fenicsx.dofmap(unknowns.space)] = fenicsx.node_ids(model.mesh)[fenicsx.geometry_dofmap(model.mesh)]
    return ids[: unknowns.owned]
