"""Small meshes of the unit square and cube, and one Newton step, for the tests of the bulk forms."""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations, product
from typing import Any

import basix
import dolfinx
import dolfinx.fem.petsc
import numpy as np
import ufl
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array

DIMENSION = {"triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 3}


def unit_mesh(
    comm: MPI.Comm,
    cell_type: str,
    order: int,
    divisions: int,
    move: Callable[[Array], Array] | None = None,
) -> Any:
    """Structured mesh of the unit square or cube, its nodes (also those within a cell) moved x -> move(x)."""
    dim = DIMENSION[cell_type]
    element = basix.create_element(
        basix.ElementFamily.P, getattr(basix.CellType, cell_type), order, basix.LagrangeVariant.equispaced
    )
    steps = order * divisions
    if cell_type in ("quadrilateral", "hexahedron"):
        corners = [np.vstack([np.zeros(dim), np.eye(dim)])]
    else:  # Kuhn: one simplex for each order in which the axes are walked from corner to opposite corner
        corners = [np.vstack([np.zeros(dim), np.cumsum(np.eye(dim)[list(p)], 0)]) for p in permutations(range(dim))]
    shapes = [np.rint(order * (c[0] + element.points @ (c[1:] - c[0]))).astype(np.int64) for c in corners]
    weights = (steps + 1) ** np.arange(dim)
    origins = [order * np.array(origin) for origin in product(range(divisions), repeat=dim)]
    cells = np.array([(origin + shape) @ weights for origin in origins for shape in shapes])
    axes = np.meshgrid(*[np.arange(steps + 1) / steps] * dim, indexing="ij")
    x = np.column_stack([axis.ravel(order="F") for axis in axes])
    if move is not None:
        x = move(x)
    if comm.rank > 0:
        cells, x = cells[:0], x[:0]
    return fenicsx.create_mesh(comm, cells, x, cell_type, order)


def shaken(divisions: int, order: int, amount: float = 0.15) -> Callable[[Array], Array]:
    """Moves every node that is not on the boundary by up to `amount` of the node spacing, reproducibly."""

    def move(x: Array) -> Array:
        inside = np.all((x > 1e-9) & (x < 1 - 1e-9), axis=1)
        shift = np.random.default_rng(7).uniform(-amount, amount, x.shape) / (divisions * order)
        return x + inside[:, None] * shift

    return move


def nodes(space: Any) -> tuple[Array, int]:
    """Coordinates (nodes, 3) of the local nodes of a blocked space, ghosts too; how many this rank owns."""
    return space.tabulate_dof_coordinates(), space.dofmap.index_map.size_local


def boundary(x: Array, dim: int) -> NDArray[np.bool_]:
    """Which points lie on the boundary of the unit square or cube."""
    return np.any((x[:, :dim] < 1e-9) | (x[:, :dim] > 1 - 1e-9), axis=1)


def assemble_vector(form: Any) -> PETSc.Vec:
    """Residual summed over the ranks. Collective."""
    vector = dolfinx.fem.petsc.assemble_vector(dolfinx.fem.form(form))
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    return vector


def assemble_matrix(form: Any) -> PETSc.Mat:
    """Assembled matrix. Collective."""
    matrix = dolfinx.fem.petsc.assemble_matrix(dolfinx.fem.form(form))
    matrix.assemble()
    return matrix


def integral(form: Any, comm: MPI.Comm) -> float:
    """Value of a form without arguments, summed over the ranks. Collective."""
    return comm.allreduce(dolfinx.fem.assemble_scalar(dolfinx.fem.form(form)))


def newton_step(w: Any, residual: Any, tangent: Any, fixed: NDArray[np.bool_]) -> None:
    """w -= K^-1 F, the entries `fixed` (local nodes, components) of w held; exact if linear. Collective."""
    space = w.function_space
    index_map = space.dofmap.index_map
    components = space.dofmap.index_map_bs
    local = np.flatnonzero(fixed[: index_map.size_local])
    rows = (index_map.local_range[0] * components + local).astype(PETSc.IntType)
    matrix, vector = assemble_matrix(tangent), assemble_vector(residual)
    matrix.zeroRowsColumns(rows, 1.0)
    vector.setValues(rows, np.zeros(rows.size))
    vector.assemble()
    solver = PETSc.KSP().create(space.mesh.comm)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    if space.mesh.comm.size > 1:
        solver.getPC().setFactorSolverType("mumps")
    solver.setOperators(matrix)
    step = vector.duplicate()
    solver.solve(vector, step)
    w.x.array[: index_map.size_local * components] -= step.array_r[: index_map.size_local * components]
    w.x.scatter_forward()
    for item in (solver, matrix, vector, step):
        item.destroy()


def facet_measure(mesh: Any, places: list[tuple[int, float]]) -> Any:
    """ds with tag n on the n-th of the boundary planes (axis, position). Collective."""
    dim = mesh.topology.dim - 1
    found = [
        dolfinx.mesh.locate_entities_boundary(mesh, dim, lambda x, p=place: np.isclose(x[p[0]], p[1]))
        for place in places
    ]
    values = np.repeat(np.arange(len(places), dtype=np.int32), [f.size for f in found])
    facets = np.concatenate(found).astype(np.int32)
    order = np.argsort(facets)
    tags = dolfinx.mesh.meshtags(mesh, dim, facets[order], values[order])
    return ufl.Measure("ds", domain=mesh, subdomain_data=tags)


def wavy(space: Any, rng: np.random.Generator, amplitude: float) -> Any:
    """A Function with other smooth values in each component, the same on any number of ranks."""
    components, dim = space.dofmap.index_map_bs, space.mesh.geometry.dim
    function = dolfinx.fem.Function(space)
    waves = rng.uniform(-3, 3, (dim, components))
    x, _ = nodes(space)
    function.x.array[:] = (amplitude * np.sin(x[:, :dim] @ waves + rng.uniform(0, 6, components))).ravel()
    return function


def owned(values: Any) -> Array:
    """What this rank owns of a Function's values, as of a vector made from a form on the same space."""
    index_map = values.function_space.dofmap.index_map
    return values.x.array[: index_map.size_local * values.function_space.dofmap.index_map_bs]
