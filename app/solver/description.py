"""The discrete problem and its solvers in one line."""

from __future__ import annotations

from piezomat.assembly.problem import Problem
from piezomat.discretization.model import Model
from piezomat.solver.linear import Direct, Multigrid


def describe(model: Model, problem: Problem, linear: Direct | Multigrid) -> str:
    """One line for the log: size, physics, solver."""
    physics = "displacement and potential" if model.electric else "displacement"
    how = "one linear solve a step" if problem.is_linear else "Newton's method"
    solver = "direct" if isinstance(linear, Direct) else "Krylov with multigrid"
    contact = "no contact" if problem.contact is None else problem.contact.pairs.described()
    return f"{model.unknowns.total} unknowns ({physics}), {contact}, {how}, {solver} linear solver"
