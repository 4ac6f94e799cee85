"""How far rigid boundaries have moved at a converged state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.assembly.problem import Problem
from piezomat.discretization.constraints import load_factor
from piezomat.forms.arrays import Array


@dataclass(frozen=True)
class Translation:
    """Displacement (d,) of a rigid boundary, um, and how far that is along the force on it (any way without one)."""

    displacement: Array
    travel: float


def translations(problem: Problem, factors: dict[str, float]) -> list[Translation]:
    """Translation of each rigid boundary at a load level, in the order of the scene. Collective."""
    constraints = problem.model.constraints
    values = iter(constraints.motions.values(problem.state))
    found = []
    for rigid in constraints.rigid:
        row = rigid.boundary
        factor, given = load_factor(row, factors), row.displacement or [None] * problem.model.dim
        moved = np.array([next(values) if i in rigid.tied else factor * value for i, value in enumerate(given)])
        force = np.linalg.norm(row.force)
        travel = moved @ np.array(row.force) / force if force > 0.0 else np.linalg.norm(moved)
        found.append(Translation(moved, float(travel)))
    return found
