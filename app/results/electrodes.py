"""Voltage and charge of the electrodes at a converged state."""

from __future__ import annotations

from dataclasses import dataclass

from piezomat.assembly.problem import Problem
from piezomat.assembly.terms import Terms


@dataclass(frozen=True)
class ElectrodeState:
    """An electrode's potential, V, and its free charge, pC (2D: pC/um)."""

    voltage: float
    charge: float


def electrode_states(problem: Problem, terms: Terms) -> list[ElectrodeState]:
    """State of each electrode at the last residual, in the order of the scene. Collective."""
    model, constraints = problem.model, problem.model.constraints
    count = len(constraints.electrodes)
    if not count:
        return []
    voltages = model.potential_scale * constraints.potentials.values(problem.state)
    # The residual is that of what lies in the bodies, across contacts, and of the charges given: without these it is
    # minus the charge.
    sums = [constraints.ties.sums(vector)[:count] for vector in (terms.loads.vector, problem.residual_with_reactions)]
    charges = (sums[0] - sums[1]) / model.potential_scale - terms.circuits.charges(problem.state)
    return [ElectrodeState(float(v), float(q)) for v, q in zip(voltages, charges, strict=True)]
