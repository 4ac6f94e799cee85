"""The columns that the history of a scene has, with units and meanings, as text."""

from __future__ import annotations

from mpi4py import MPI

from piezomat.contact.setup import interfaces_of
from piezomat.discretization.model import Model
from piezomat.results.quantities import GROUPS, unit_in
from piezomat.results.run_mesh import mesh_of_run
from piezomat.scene import Scene


def columns_of(scene: Scene, comm: MPI.Comm) -> str:
    """The columns of the history of a scene as text: name, unit, meaning, one a line; nothing is solved. Collective."""
    model = Model(scene, mesh_of_run(scene, comm))
    contact = interfaces_of(model)
    lines = []
    for group in GROUPS:
        for place in group.places(model, contact):
            for quantity in (q for q in group.quantities if q.applies(model)):
                unit = unit_in(quantity, model.dim)
                lines += [(name, unit, quantity.meaning) for name in quantity.columns(model.dim, place)]
    first, second = (max(len(line[i]) for line in lines) for i in (0, 1))
    return "\n".join(f"{name:<{first}}  {unit:<{second}}  {meaning}" for name, unit, meaning in lines)
