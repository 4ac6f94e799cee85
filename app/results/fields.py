"""Fields in the cells and values at the contact points, computed from a converged state."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl

from piezomat.assembly.problem import Problem
from piezomat.contact.interfaces import Interfaces
from piezomat.discretization.material_axes import polings
from piezomat.discretization.model import Model
from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array, Integers
from piezomat.forms.evaluation import center_expression
from piezomat.forms.kinematics import deformation_gradient, push_forward
from piezomat.forms.response import CenterResponse
from piezomat.results.vtk import ContactPoints, FieldPiece, grid

MOST_PLACES = 31  # bits of the files' integers


class FieldOutput:
    """Field pieces of a problem's solutions; cell values are those at the cells' centres.

    With finite kinematics they are current quantities: Cauchy stress, spatial field and electric displacement; but the
    strain is that of Green and Lagrange, and the poling that before any load.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        model = problem.model
        self._grid = grid(model.mesh)
        nodes, geometry = fenicsx.dofmap(model.unknowns.space), fenicsx.geometry_dofmap(model.mesh)
        self._node = np.zeros(len(self._grid.points), np.int64)
        self._node[geometry] = nodes
        arguments = model.regions, model.materials, model.bodies.cell_body, model.kinematics, model.plane
        self._response = CenterResponse(model.trial_state, *arguments, model.potential_scale, model.axes)
        self._place_names, self._places = marked_places(model)
        self._poling = polings(model.scene, model.bodies, model.axes)
        self._gradient: Any = None
        if model.kinematics == "finite":
            gradient = ufl.grad(model.trial_state)
            entries = [gradient[i, j] for i in range(model.dim) for j in range(model.dim)]
            self._gradient = center_expression(ufl.as_vector(entries), model.mesh)

    def piece(self, solution: Array | None = None) -> FieldPiece:
        """This rank's fields of the present solution, or of another one's values on this rank. Collective."""
        model = self.problem.model
        function = self.problem.solution()
        if solution is not None:
            function.x.array[:] = solution
        values = function.x.array.reshape(-1, model.unknowns.block)[self._node]
        cells = len(self._grid.cells)
        (strain, stress, density), field = self._response.evaluate()
        potential = model.potential_scale * values[:, model.dim] if model.electric else None
        if self._gradient is not None:
            gradient = fenicsx.at_centers(self._gradient, model.mesh).reshape(cells, model.dim, model.dim)
            f = deformation_gradient(gradient, strain[:, 2])
            stress, field, density = push_forward(f, stress, field, density)
        electric = {"potential": potential, "electric_field": field, "electric_displacement": density}
        return FieldPiece(
            self._grid,
            _in_space(values[:, : model.dim]),
            stress,
            model.bodies.cell_body,
            **(electric if model.electric else {}),
            strain=strain,
            poling=self._poling,
            body_names=tuple(model.bodies.bodies),
            places=self._places[self._node],
            place_names=self._place_names,
        )


def marked_places(model: Model) -> tuple[tuple[str, ...], Integers]:
    """Names of the boundaries and electrodes, the first 31, and a bit for each at this rank's nodes. Collective."""
    unknowns = model.unknowns
    nodes = [(name, unknowns.nodes_of(model.bodies.facets[name])) for name in model.constraints.groups]
    nodes += [(e.electrode.name, e.nodes) for e in model.constraints.electrodes]
    names = tuple(dict.fromkeys(name for name, _ in nodes))[:MOST_PLACES]
    marks = np.zeros((unknowns.local, len(names)), bool)
    for name, chosen in nodes:
        if name in names:
            marks[chosen, names.index(name)] = True
    bits = fenicsx.sum_over_ranks(unknowns.space, marks @ 2.0 ** np.arange(len(names)))
    return names, bits.astype(np.int64)


def contact_points(contact: Interfaces, model: Model) -> ContactPoints:
    """This rank's contact points near another surface or a plane, at the last evaluation."""
    columns: list[list[Array]] = [[] for _ in range(7)]
    for p in contact.point_sets:
        rows = p.projected_points
        gap = p.projection.gap
        pressure = -p.response.traction * p.points.weight[rows] / p.points.area[rows]
        jump = p.jump if p.jump is not None else np.zeros(len(gap))
        status = p.law[rows].status(p.gap, p.history[rows])
        place, numbers = p.position + model.unknowns.origin, p.numbers_in_results(contact.pairs)
        parts = [place, p.projection.normal, gap, pressure, status, numbers, jump]
        for column, part in zip(columns, parts, strict=True):
            column.append(part)
    position, normal, gap, pressure, status, pair, jump = (np.concatenate(column) for column in columns)
    names = {int(number): contact.pairs.result_name(int(number)) for number in np.unique(pair)}
    return ContactPoints(
        _in_space(position), _in_space(normal), gap, pressure, status, pair, jump if model.electric else None, names
    )


def _in_space(vectors: Array) -> Array:
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))
