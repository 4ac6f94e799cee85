"""State of a run in a checkpoint: saved at the end of a step, restored on any number of ranks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezomat.assembly.problem import Problem
from piezomat.contact.interfaces import Interfaces
from piezomat.discretization.model import Model
from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.results import checkpoint
from piezomat.results.energy_balance import EnergyBalance
from piezomat.results.quantities import augments
from piezomat.solver.load_steps import Stepper

Points = dict[str, tuple[NDArray[np.int64], Array]]


def save(
    folder: Path, step: int, problem: Problem, stepper: Stepper, balance: EnergyBalance, history: list[dict[str, Any]]
) -> None:
    """Write the end of a step, problem and contact being evaluated there, to a folder of checkpoints. Collective.

    Raises what `checkpoint.save` does.
    """
    model, contact = problem.model, problem.contact
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
    }
    points = _points(contact, augmented=augments(model)) if contact is not None else {}
    checkpoint.save(problem.comm, folder, step, nodal, points, scalars)


def load(folder: Path, problem: Problem, stepper: Stepper, balance: EnergyBalance) -> tuple[int, list[dict[str, Any]]]:
    """Restore the newest checkpoint of a folder; its step and the history so far. Collective.

    State and contact then hold what they held, except what an evaluation computes. Raises what `checkpoint.load` does.
    """
    model, contact = problem.model, problem.contact
    stored = checkpoint.load(problem.comm, folder)
    ids = _node_ids(model)
    problem.state.array[:] = stored.nodal("state", ids).ravel()
    balance.forces.array[:] = stored.nodal("forces", ids).ravel()
    balance.external_work = stored.scalars["external_work"]
    balance.stabilization_work = stored.scalars["stabilization"]
    stepper.size = stored.scalars["size"]
    stepper.last_motion = stored.scalars["motion"]
    if contact is not None:
        _restore_contact(contact, stored, augmented=augments(model))
    return stored.step, list(stored.scalars["history"])


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
    contact.last_penetration = stored.scalars["penetration"]
    for p in contact.surface_pairs:
        if p.segments:
            every = p.possible_keys(stored.scalars["places"])
            p.restore_points(*stored.points("place", every), stored.scalars["places"])
    for p in contact.point_sets:
        values, found = stored.points("opening", p.keys())
        p.history.touched[:] = found
        p.history.opening[:] = np.where(found, values[:, 0], 0.0)
        if augmented:
            values, _ = stored.points("shift", p.corner_keys())
            p.multipliers.gap[:], p.multipliers.jump[:] = values.T.reshape(2, *p.multipliers.gap.shape)


def _node_ids(model: Model) -> NDArray[np.int64]:
    """Numbers of the owned nodes in the mesh file."""
    unknowns = model.unknowns
    ids = np.zeros(unknowns.local, np.int64)
    ids[fenicsx.dofmap(unknowns.space)] = fenicsx.node_ids(model.mesh)[fenicsx.geometry_dofmap(model.mesh)]
    return ids[: unknowns.owned]
