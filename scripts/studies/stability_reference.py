"""The force on two half discs pressed together, computed without the contact code: the reference of two maps.

Equal elastic half discs meet on the plane between them, so that each presses on a rigid plane without friction: nodal
displacements are bounded by the plane, and an active set finds the ones that touch. There is no search, no penalty and
no second mesh. The numbers in stability_maps.py are printed by

    .venv/bin/python -m scripts.studies.stability_reference
"""

from __future__ import annotations

import math

import dolfinx
import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from mpi4py import MPI

from piezomat.assembly.problem import Problem
from piezomat.assembly.terms import Terms
from piezomat.discretization.model import Model
from piezomat.meshes.body_mesh import create
from piezomat.scene import Scene
from piezomat.usage import Timer

RADIUS = 0.5
ITERATIONS = 60


def force(approach: float, facet: float, order: int, kinematics: str) -> float:
    """Force, uN/um, at an approach (um) of the flat faces, with contact facets of a given size (um)."""
    scene = Scene(
        geometry={"shape": "facing_halves", "radius": RADIUS},
        mesh={"size": 0.04, "contact_size": facet, "order": order},
        model={"kinematics": kinematics},
        bodies={"lower": "elastic", "upper": "elastic"},
        boundaries=[{"on": "bottom", "displacement": [0, 0]}, {"on": "top", "displacement": [0, 0]}],
    )
    bodies = create(MPI.COMM_SELF, scene.geometry, scene.sizes)
    model = Model(scene, bodies)
    problem = Problem(model, Terms.of(model, None), Timer())
    touching = dolfinx.fem.locate_dofs_topological(model.unknowns.space, 1, bodies.facets["lower_contact"])
    lower = np.flatnonzero(np.repeat(model.parts.node_part == model.parts.node_part[touching[0]], 2))
    fixed = np.intersect1d(model.constraints.fixed, lower)
    up = np.setdiff1d(2 * touching + 1, fixed)
    way = -model.unknowns.coordinates[up // 2, 1] - 0.5 * approach  # to the plane
    active = way < 0.0
    for _ in range(ITERATIONS):
        problem.residual(problem.state, problem.state.duplicate())
        forces, u = problem.residual_with_reactions.array_r.copy(), problem.state.array_r.copy()
        problem.linearize(problem.state)
        rows, columns, values = problem.bulk_stiffness().getValuesCSR()
        tangent = scipy.sparse.csr_matrix((values, columns, rows))
        change = np.zeros(len(u))
        change[up[active]] = way[active] - u[up[active]]
        free = np.setdiff1d(lower, np.concatenate([fixed, up[active]]))
        change[free] = scipy.sparse.linalg.spsolve(tangent[free][:, free].tocsc(), -(forces + tangent @ change)[free])
        problem.state.array[:] = u + change
        push = -(forces + tangent @ change)[up]
        new = np.where(active, push > 0.0, (u + change)[up] > way)
        if (new == active).all() and np.abs(change).max() < 1e-9 * approach:
            return float(push[active].sum())
        active = new
    raise ArithmeticError("the active set does not settle")


if __name__ == "__main__":
    for kinematics in ("small", "finite"):
        for approach in (0.005, 0.02):
            for facets in (768, 1536):
                size = 2.0 * math.pi * RADIUS / facets
                found = [force(approach, size * order, order, kinematics) for order in (1, 2)]
                print(
                    f"{kinematics} approach {approach:g}, {facets} facets a circle, order 1 and 2: {found}", flush=True
                )
