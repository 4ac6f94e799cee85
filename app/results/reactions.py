"""What the surroundings do to the model at a facet group: force, free charge, and the mean of the potential there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from piezomat.assembly.problem import Problem
from piezomat.discretization.constraints import Condition
from piezomat.forms.arrays import Array
from piezomat.meshes import parallel


@dataclass(frozen=True)
class Reaction:
    """At a facet group: force (d,) that the surroundings exert, uN; free charge, pC; mean potential, V (or nan)."""

    force: Array
    charge: float
    mean_potential: float


def reaction(problem: Problem, conditions: list[Condition], factors: dict[str, float]) -> Reaction:
    """Reaction on a facet group with these conditions at a load level, of the converged state. Collective."""
    model = problem.model
    total = np.zeros(model.dim + 1)
    for condition in conditions:
        for component, unknowns in condition.fixed.items():
            total[component] += problem.residual_with_reactions.array_r[unknowns].sum()
    for component, unknowns in model.constraints.tied_on[conditions[0].boundary.on].items():
        total[component] += problem.residual_with_reactions.array_r[unknowns].sum()
    total = parallel.total(model.comm, total)
    charge = -total[model.dim] / model.potential_scale if model.electric else 0.0
    applied = sum(model.loads.applied(condition, factors) for condition in conditions)
    potential = _mean_potential(problem, conditions[0]) if model.electric else float("nan")
    return Reaction(total[: model.dim] + applied[: model.dim], float(charge + applied[model.dim]), potential)


def _mean_potential(problem: Problem, condition: Condition) -> float:
    """Mean of the potential over a boundary, V."""
    model = problem.model
    psi = problem.solution().x.array.reshape(-1, model.unknowns.block)[condition.nodes, model.dim]
    total = model.comm.allreduce(float(condition.weights @ psi), op=MPI.SUM)
    return model.potential_scale * total / condition.area
