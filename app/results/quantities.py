"""The history of a run: its columns, and one row of numbers from a converged state."""

from __future__ import annotations

from typing import Any

import numpy as np

from piezomat.assembly.problem import Problem
from piezomat.contact.interfaces import Interfaces
from piezomat.contact.rigid_plane import RigidPlane
from piezomat.discretization.constraints import Condition
from piezomat.discretization.model import Model
from piezomat.forms.arrays import Array
from piezomat.meshes import parallel
from piezomat.results.energy_balance import EnergyBalance
from piezomat.solver.load_steps import Step, StepReport

AXES = ("x", "y", "z")
ENERGIES = ("elastic", "electric", "contact", "adhesion", "stabilization", "external_work", "dissipated")
EFFORT = ("newton", "krylov", "cutbacks", "seconds")


def columns(model: Model, pairs: list[str]) -> list[str]:
    """Names of the history's columns, in order."""
    names = ["step", "stage", *(f"factor:{name}" for name in model.scene.load.factors)]
    axes = AXES[: model.dim]
    for on in model.constraints.groups:
        names += [f"force_{axis}@{on}" for axis in axes]
        if model.electric:
            names += [f"charge@{on}", f"mean_potential@{on}"]
    for plane in model.scene.planes:
        names += [f"force_{axis}@{plane.name}" for axis in axes]
        names += [f"{name}@{plane.name}" for name in ("contact_area", "max_pressure", "max_penetration")]
        if model.electric:
            names += [f"charge@{plane.name}", f"mean_potential@{plane.name}"]
    for pair in pairs:
        names += [f"contact_force_{axis}@{pair}" for axis in axes]
        names += [f"{name}@{pair}" for name in ("contact_area", "max_pressure", "max_penetration")]
        if model.electric:
            names += [f"max_potential_jump@{pair}"]
        names += [f"bonded_area@{pair}"]
    return [*names, *ENERGIES, *EFFORT, *(["augmentations"] if augments(model) else [])]


def augments(model: Model) -> bool:
    """Whether the scene asks for augmentation."""
    return model.scene.contact is not None and model.scene.contact.augment is not None


def row(
    problem: Problem, balance: EnergyBalance, pairs: list[str], step: Step, report: StepReport, seconds: float
) -> dict[str, Any]:
    """One row of the history from the converged state. Collective; the same on all ranks."""
    model = problem.model
    problem.refresh()
    values: dict[str, Any] = {"step": step.number, "stage": step.stage}
    values |= {f"factor:{name}": value for name, value in step.after.items()}
    axes = AXES[: model.dim]
    for on, conditions in model.constraints.groups.items():
        force, charge = reaction(problem, conditions, step.after)
        values |= {f"force_{axis}@{on}": float(f) for axis, f in zip(axes, force, strict=True)}
        if model.electric:
            values |= {f"charge@{on}": charge, f"mean_potential@{on}": model.mean_potential(conditions[0])}
    energies = problem.energies(problem.state)
    contact = {"contact": 0.0, "adhesion": 0.0, "electric": 0.0, "dissipated": 0.0}
    if problem.contact is not None:
        if pairs:
            values |= _listed_pairs(problem.contact, model)
        for plane in problem.contact.planes:
            values |= plane_values(problem.contact, plane, model.electric)
        contact = problem.contact.energies()
    energies["electric"] += contact.pop("electric")
    values |= energies | contact
    values |= {"stabilization": balance.stabilization_work, "external_work": balance.external_work}
    values |= {"newton": report.newton, "krylov": report.krylov, "cutbacks": report.cutbacks, "seconds": seconds}
    if augments(model):
        values["augmentations"] = report.augmentations
    return values


def reaction(problem: Problem, conditions: list[Condition], factors: dict[str, float]) -> tuple[Array, float]:
    """Force (d,) that the surroundings exert on the model at a facet group, uN, and the free charge on it, pC."""
    model = problem.model
    total = np.zeros(model.dim + 1)
    for condition in conditions:
        for component, unknowns in condition.fixed.items():
            total[component] += problem.residual_with_reactions.array_r[unknowns].sum()
    total = parallel.total(model.comm, total)
    charge = -total[model.dim] / model.potential_scale if model.electric else 0.0
    applied = sum(model.loads.applied(condition, factors) for condition in conditions)
    return total[: model.dim] + applied[: model.dim], float(charge + applied[model.dim])


def _listed_pairs(contact: Interfaces, model: Model) -> dict[str, float]:
    names, table = pair_columns(model.dim, model.electric), pair_table(contact)
    values = {}
    for number, pair in contact.pairs.listed.items():
        found = table.get(number, np.zeros(model.dim + 5))
        values |= {f"{name}@{pair}": float(value) for name, value in zip(names, found, strict=False)}
    return values


def plane_values(contact: Interfaces, plane: RigidPlane, electric: bool) -> dict[str, float]:
    """Force that a plane exerts, area, largest pressure and penetration, charge of an electrode and its potential.

    Of an insulator the mean potential is that of the surfaces on it, nan where nothing touches it. Collective.
    """
    d, gap = contact.dim, plane.projection.gap
    area = plane.points.area[plane.near_points]
    closed = plane.gap <= 0.0
    potential = 0.0 if plane.surface_potential is None else float((area * plane.surface_potential) @ closed)
    sums = parallel.total(contact.comm, np.array([*plane.force, plane.charge, area @ closed, potential]))
    pressure = -plane.response.slope * plane.points.weight[plane.near_points] / area
    largest = np.array([pressure.max(initial=0.0), -gap.min(initial=0.0)])
    largest = parallel.largest(contact.comm, largest)
    values = {f"force_{axis}@{plane.name}": float(f) for axis, f in zip(AXES, sums[:d], strict=False)}
    values |= {f"contact_area@{plane.name}": float(sums[d + 1])}
    values |= {f"max_pressure@{plane.name}": float(largest[0]), f"max_penetration@{plane.name}": float(largest[1])}
    if electric:
        mean = float(sums[d + 2] / sums[d + 1]) if sums[d + 1] > 0.0 else float("nan")
        values |= {f"charge@{plane.name}": float(sums[d])}
        values |= {f"mean_potential@{plane.name}": mean if plane.potential is None else plane.potential}
    return values


def pair_table(contact: Interfaces) -> dict[int, Array]:
    """Of each pair that is in contact, by number, what `pair_columns` names, in this order. Collective.

    Force on the first of the pair (d,), area, bonded area, largest pressure, penetration and potential jump.
    """
    d = contact.dim
    mine: dict[int, Array] = {}
    for p in contact.surface_pairs:
        r, gap, rows = p.response, p.projection.gap, p.projected_points
        number, first = p.pair_numbers(contact.pairs)
        area = p.points.area[rows]
        closed = p.gap <= p.law[rows].equilibrium_gap
        # History is that of the converged step, so bonds that broke in it no longer count.
        bonded = p.law[rows].bonded(p.history[rows])
        together = closed | (p.law[rows].status(p.gap, p.history[rows]) == 2)
        jump = np.abs(p.jump) * together if p.jump is not None else np.zeros(len(gap))
        sums = np.column_stack([np.where(first, 1.0, -1.0)[:, None] * p.force, p.share * area * closed])
        sums = np.column_stack([sums, p.share * area * bonded])
        largest = np.column_stack([-r.slope * p.points.weight[rows] / area, -gap, jump])
        for pair in np.unique(number[closed | bonded | (r.slope != 0.0)]):
            of = number == pair
            row = mine.setdefault(int(pair), np.zeros(d + 5))
            row[: d + 2] += sums[of].sum(axis=0)
            row[d + 2 :] = np.maximum(row[d + 2 :], largest[of].max(axis=0))
    table: dict[int, Array] = {}
    for part in contact.comm.allgather(mine):
        for pair, values in part.items():
            row = table.setdefault(pair, np.zeros(d + 5))
            row[: d + 2] += values[: d + 2]
            row[d + 2 :] = np.maximum(row[d + 2 :], values[d + 2 :])
    return dict(sorted(table.items()))


def pair_columns(dim: int, electric: bool) -> list[str]:
    """Names of what `pair_table` holds of each pair."""
    names = [*(f"contact_force_{axis}" for axis in AXES[:dim]), "contact_area", "bonded_area"]
    return [*names, "max_pressure", "max_penetration", *(["max_potential_jump"] if electric else [])]
