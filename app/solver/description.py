"""The discrete problem and its solvers in one line."""

from __future__ import annotations

from piezomat.assembly.problem import Problem
from piezomat.contact.interfaces import Interfaces
from piezomat.solver.linear import Direct, LinearSolver


def describe(problem: Problem, contact: Interfaces | None, linear: LinearSolver) -> str:
    """One line for the log: size, physics, solver."""
    model = problem.model
    physics = "displacement and potential" if model.electric else "displacement"
    how = "one linear solve a step" if problem.is_linear else "Newton's method"
    solver = "direct" if isinstance(linear, Direct) else "Krylov with multigrid"
    interfaces = "no contact" if contact is None else contact.pairs.described()
    return f"{model.unknowns.total} unknowns ({physics}), {interfaces}, {how}, {solver} linear solver"
