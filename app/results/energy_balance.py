"""Work of the surroundings on the model and of its stabilization, summed over the converged parts of all steps.

The trapezoidal rule: the external work of a part is the mean of the nodal forces at its ends times the change of
displacement, plus the mean of the potentials times the change of charge. Planes count alike, with their force,
position, potential and charge. Where bonds snap, forces change too much for that: `snap_through_work` takes the place
of the mechanical part of all but planes by motion.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from piezomat.assembly.problem import Problem
from piezomat.assembly.terms import Terms
from piezomat.forms.arrays import Array
from piezomat.meshes import parallel


class EnergyBalance:
    """External work and stabilization work since the start of the run, pJ (2D: pJ/um). Methods are collective.

    external_work (float, pJ): of boundaries, loads, planes and electrodes.
    stabilization_work (float, pJ): of the springs on unconstrained bodies and of viscous bonds.
    forces (Vec, uN and pC): nodal reactions and loads at the end of the last part.
    planes (planes, 2 d + 2): force, position, charge and potential of each plane at the end of the last part.
    """

    def __init__(self, problem: Problem, terms: Terms) -> None:
        self.problem = problem
        self._terms = terms
        self.external_work = 0.0
        self.stabilization_work = 0.0
        self.forces = problem.model.new_vector()
        self._pushed = np.array([plane.is_pushed for plane in problem.model.scene.planes], bool)
        self.restart_planes()

    def restart_planes(self) -> None:
        """Take the planes' forces at the last evaluation of contact as the start of the next part."""
        self.planes = self._plane_values()

    def resume(self, external_work: float, stabilization_work: float, forces: Array) -> None:
        """Take up what a checkpoint holds: works, and forces (owned nodes, block)."""
        self.external_work, self.stabilization_work = external_work, stabilization_work
        self.problem.model.unknowns.set_by_node(self.forces, forces)

    def add_part(self, snap_through_work: Array | None = None) -> None:
        """Add the part of a step that has just converged.

        snap_through_work (2,): external work and energy set free, pJ, where bonds have snapped.
        """
        problem = self.problem
        by_node, d = problem.model.unknowns.by_node, problem.model.dim
        # The residual contains the loads and is zero where nothing is prescribed: without them it is both their forces
        # and the reactions.
        new = by_node(problem.residual_with_reactions) - by_node(self._terms.loads.vector)
        old, x, x0 = by_node(self.forces), by_node(problem.state), by_node(problem.converged_state)
        work = 0.0
        if snap_through_work is None:
            work = 0.5 * ((new[:, :d] + old[:, :d]) * (x[:, :d] - x0[:, :d])).sum()
        if problem.model.electric:
            work -= 0.5 * ((x[:, d] + x0[:, d]) * (new[:, d] - old[:, d])).sum()
        self.external_work += problem.comm.allreduce(float(work), op=MPI.SUM)
        if snap_through_work is not None:
            self.external_work += float(snap_through_work[0])
            self.stabilization_work += float(snap_through_work[1])
        self._add_planes(by_force=snap_through_work is None)
        self.stabilization_work += self._terms.stabilization.work(problem.state)
        problem.model.unknowns.set_by_node(self.forces, new)

    def _plane_values(self) -> Array:
        """Force (d,), position (d,), charge and potential of each plane, (planes, 2 d + 2)."""
        contact = self._terms.contact
        planes = contact.planes if contact is not None else []
        d = self.problem.model.dim
        values = np.zeros((len(planes), 2 * d + 2))
        for row, p in zip(values, planes, strict=True):
            row[:] = [*p.force, *p.offset, p.charge, p.potential or 0.0]
        summed = [*range(d), 2 * d]  # each rank has the force and charge of its own points
        values[:, summed] = parallel.total(self.problem.comm, values[:, summed])
        return values

    def _travels(self) -> Array:
        """Motions (k, d) of the planes by force in the last part, um."""
        constraints = self.problem.model.constraints
        values = constraints.travels.values
        change = values(self.problem.state) - values(self.problem.converged_state)
        return change[:, None] * constraints.motion_directions[len(constraints.motions) - len(change) :]

    def _add_planes(self, *, by_force: bool) -> None:
        d, new = self.problem.model.dim, self._plane_values()
        mean, change = 0.5 * (new + self.planes), new - self.planes
        # A step begins where planes by force touch a body: the way there takes no force.
        change[self._pushed, d : 2 * d] = self._travels() if by_force else 0.0
        self.external_work += float((mean[:, :d] * change[:, d : 2 * d]).sum() + mean[:, -1] @ change[:, -2])
        self.planes = new
