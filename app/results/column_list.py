"""The columns that the history of a scene has, with units and meanings, as text."""

from __future__ import annotations

from mpi4py import MPI

from piezomat.assembly.problem import Problem
from piezomat.assembly.terms import Terms
from piezomat.contact.setup import interfaces_of
from piezomat.discretization.model import Model
from piezomat.results.quantities import GROUPS, unit_in
from piezomat.results.run_mesh import mesh_of_run
from piezomat.scene import Scene
from piezomat.usage import Timer


def columns_of(scene: Scene, comm: MPI.Comm) -> str:
    """The columns of the history of a scene as text; nothing is solved. Collective."""
    model = Model(scene, mesh_of_run(scene, comm))
    problem = Problem(model, Terms.of(model, interfaces_of(model)), Timer())
    try:
        return column_list(problem)
    finally:
        problem.close()


def column_list(problem: Problem) -> str:
    """The history's columns of a problem as text: name, unit, meaning, one a line."""
    lines = []
    for group in GROUPS:
        for place in group.places(problem):
            for quantity in (q for q in group.quantities if q.applies(problem.model)):
                unit = unit_in(quantity, problem.model.dim)
                lines += [(name, unit, quantity.meaning) for name in quantity.columns(problem.model.dim, place)]
    first, second = (max(len(line[i]) for line in lines) for i in (0, 1))
    return "\n".join(f"{name:<{first}}  {unit:<{second}}  {meaning}" for name, unit, meaning in lines)
