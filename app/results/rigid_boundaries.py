"""How far rigid boundaries have moved at a converged state."""

from __future__ import annotations

import numpy as np

from piezomat.assembly.problem import Problem
from piezomat.discretization.constraints import load_factor


def travels(problem: Problem, factors: dict[str, float]) -> list[float]:
    """How far each rigid boundary has moved along the force on it (any way without one), um. Collective.

    At a load level, in the order of the scene.
    """
    constraints = problem.model.constraints
    values = iter(constraints.motions.values(problem.state))
    found = []
    for rigid in constraints.rigid:
        row = rigid.boundary
        factor, given = load_factor(row, factors), row.displacement or [None] * problem.model.dim
        moved = np.array([next(values) if i in rigid.tied else factor * value for i, value in enumerate(given)])
        force = np.linalg.norm(row.force)
        found.append(float(moved @ np.array(row.force) / force if force > 0.0 else np.linalg.norm(moved)))
    return found
