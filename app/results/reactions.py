"""What the surroundings do to the model at a facet group: force, free charge, and the mean of the potential there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.assembly.problem import Problem
from piezomat.discretization.constraints import Condition
from piezomat.forms.arrays import Array
from piezomat.meshes import parallel


@dataclass(frozen=True)
class Reaction:
    """At a facet group: force (d,) that the surroundings exert, uN; mean displacement (d,), um; free charge, pC; mean
    potential, V (or nan)."""

    force: Array
    displacement: Array
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
    means = _means(problem, conditions[0])
    potential = model.potential_scale * means[model.dim] if model.electric else float("nan")
    return Reaction(
        total[: model.dim] + applied[: model.dim],
        means[: model.dim],
        float(charge + applied[model.dim]),
        float(potential),
    )


def _means(problem: Problem, condition: Condition) -> Array:
    """Means over a boundary of the displacement's components and the potential unknown, (block,). Collective."""
    model = problem.model
    values = problem.solution().x.array.reshape(-1, model.unknowns.block)[condition.nodes]
    return parallel.total(model.comm, condition.weights @ values) / condition.area
