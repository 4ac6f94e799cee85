"""All that differs between versions of DOLFINx, and nothing else.

`forms` and `meshes` import this module too; it imports nothing of the project.
"""

from __future__ import annotations

import logging
from typing import Any

import dolfinx
import numpy as np
import ufl
from mpi4py import MPI
from numpy.typing import NDArray

VERSION: str = dolfinx.__version__

# The form compiler tells the root logger of every C compiler call.
for _handler in logging.getLogger().handlers:
    _handler.setLevel(logging.WARNING)


def lagrange(mesh: Any, order: int, components: int) -> Any:
    """Blocked Lagrange space of the given order with `components` unknowns a node."""
    element = ufl.VectorElement("Lagrange", mesh.ufl_cell(), order, dim=components)
    return dolfinx.fem.FunctionSpace(mesh, element)


def piecewise_constant(mesh: Any, components: int) -> Any:
    """Blocked space of `components` constants a cell."""
    element = ufl.VectorElement("DG", mesh.ufl_cell(), 0, dim=components)
    return dolfinx.fem.FunctionSpace(mesh, element)


def create_mesh(
    comm: MPI.Comm,
    cells: NDArray[np.int64],
    x: NDArray[np.float64],
    cell_type: str,
    order: int,
    destinations: NDArray[np.int32] | None = None,
) -> Any:
    """Distributed mesh with Lagrange geometry of the given order, without ghost cells. Collective.

    `cells` (n, nodes) holds input node numbers in DOLFINx order and `x` (N, dim) their coordinates, both on
    rank 0 (empty elsewhere). `destinations` (n,) on rank 0 forces the rank of each cell.
    """
    gdim = comm.bcast(x.shape[1])
    cell = ufl.Cell(cell_type, geometric_dimension=gdim)
    scalar = ufl.FiniteElement("Lagrange", cell, order, variant="equispaced")
    domain = ufl.Mesh(ufl.VectorElement(scalar))
    ghost_mode = dolfinx.cpp.mesh.GhostMode.none
    if comm.bcast(destinations is not None):
        ranks = np.empty(0, np.int32) if destinations is None else np.asarray(destinations, np.int32)

        def place(comm: Any, parts: int, neighbours: Any, ghosts: bool) -> Any:
            return _destinations(ranks, neighbours if ghosts else None)

        partitioner = dolfinx.cpp.mesh.create_cell_partitioner(place)
    else:
        partitioner = dolfinx.cpp.mesh.create_cell_partitioner()
    return dolfinx.mesh.create_mesh(comm, cells, x, domain, ghost_mode, partitioner)


def _destinations(ranks: NDArray[np.int32], neighbours: Any | None) -> Any:
    """Ranks that each cell goes to: its own first, then those of cells that share a facet with it.

    DOLFINx 0.5 finds the vertices that ranks share by these, also for a mesh without ghost cells.
    """
    cell, rank = np.arange(len(ranks)), ranks
    if neighbours is not None:
        near = np.repeat(cell, np.diff(neighbours.offsets))
        other = np.unique(np.stack([near, ranks[neighbours.array]], axis=1), axis=0)
        other = other[other[:, 1] != ranks[other[:, 0]]]
        cell, rank = np.concatenate([cell, other[:, 0]]), np.concatenate([ranks, other[:, 1]])
    offsets = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=len(ranks)))])
    # A stable order keeps a cell's own rank before the others.
    order = np.argsort(cell, kind="stable")
    return dolfinx.cpp.graph.AdjacencyList_int32(rank[order].astype(np.int32), offsets.astype(np.int32))


def gmsh_permutation(cell_type: str, nodes: int) -> NDArray[np.int64]:
    """Permutation p such that cells_dolfinx = cells_gmsh[:, p]."""
    return np.asarray(dolfinx.cpp.io.perm_gmsh(dolfinx.cpp.mesh.to_type(cell_type), nodes), np.int64)


def entities_from_nodes(
    mesh: Any, dim: int, entities: NDArray[np.int64], values: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Local indices and values of tagged entities, given anywhere by their input node numbers. Collective.

    `entities` (n, nodes) in DOLFINx order of nodes; an entity that does not exist in the mesh is dropped.
    """
    topology = mesh.topology
    topology.create_entities(dim)
    topology.create_connectivity(dim, 0)
    topology.create_connectivity(dim, topology.dim)
    vertices, local_values = dolfinx.cpp.io.distribute_entity_data(mesh._mesh, dim, entities, values)
    graph = dolfinx.cpp.graph.AdjacencyList_int32(vertices)
    tags = dolfinx.mesh.meshtags_from_entities(mesh, dim, graph, local_values.astype(np.int32))
    return tags.indices, tags.values


def dofmap(space: Any) -> NDArray[np.int32]:
    """Local block numbers of the nodes of each local cell, (cells, nodes)."""
    adjacency = space.dofmap.list
    return adjacency.array.reshape(adjacency.num_nodes, space.dofmap.dof_layout.num_dofs)


def geometry_dofmap(mesh: Any) -> NDArray[np.int32]:
    """Local geometry nodes of each local cell, (cells, nodes)."""
    adjacency = mesh.geometry.dofmap
    return adjacency.array.reshape(adjacency.num_nodes, nodes_per_cell(mesh))


def node_ids(mesh: Any) -> NDArray[np.int64]:
    """Input number of each local geometry node."""
    return np.asarray(mesh.geometry.input_global_indices, np.int64)


def original_cells(mesh: Any) -> NDArray[np.int64]:
    """Input number of each local cell."""
    return np.asarray(mesh.topology.original_cell_index, np.int64)


def exterior_facets(mesh: Any) -> NDArray[np.int32]:
    """Local indices of the facets of this rank that lie on the boundary of the mesh. Collective."""
    tdim = mesh.topology.dim
    mesh.topology.create_connectivity(tdim - 1, tdim)
    return np.asarray(dolfinx.mesh.exterior_facet_indices(mesh.topology), np.int32)


def facet_closure(space: Any) -> list[NDArray[np.int32]]:
    """Local nodes of the reference cell that lie on each of its facets."""
    dim = space.mesh.topology.dim
    layout = space.dofmap.dof_layout
    facets = dolfinx.cpp.mesh.cell_num_entities(space.mesh.topology.cell_type, dim - 1)
    return [np.asarray(layout.entity_closure_dofs(dim - 1, f), np.int32) for f in range(facets)]


def vtk_permutation(cell_type: str, nodes: int) -> NDArray[np.int64]:
    """Permutation p such that cells_vtk = cells_dolfinx[:, p]."""
    to_dolfinx = dolfinx.cpp.io.perm_vtk(dolfinx.cpp.mesh.to_type(cell_type), nodes)
    return np.argsort(np.asarray(to_dolfinx, np.int64))


def nodes_per_cell(mesh: Any) -> int:
    """Number of geometry nodes of a cell, also on a rank that has none."""
    return int(mesh.geometry.cmap.create_dof_layout().num_dofs)


def degree(argument: Any) -> int:
    """Polynomial order of the element of a function, or of a form's argument."""
    found = argument.ufl_element().degree
    return int(found() if callable(found) else found)


def cell_name(mesh: Any) -> str:
    """triangle, quadrilateral, tetrahedron or hexahedron."""
    return mesh.topology.cell_name()


def sum_over_ranks(space: Any, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values at the local nodes, summed over the ranks that share each node. Collective."""
    scalar = lagrange(space.mesh, space.ufl_element().degree(), 1)
    total = dolfinx.fem.Function(scalar)
    order = np.zeros(len(values), np.int32)
    order[dofmap(space)] = dofmap(scalar)
    total.x.array[order] = values
    total.x.scatter_reverse(dolfinx.cpp.la.ScatterMode.add)
    total.x.scatter_forward()
    return total.x.array[order]


def integral(form: Any) -> float:
    """Value of a compiled functional, summed over the ranks. Collective."""
    return form.mesh.comm.allreduce(dolfinx.fem.assemble_scalar(form), op=MPI.SUM)


def petsc_vector(function: Any) -> Any:
    """The PETSc vector that shares a function's values, ghosts included."""
    return function.vector


def center_expression(value: Any, mesh: Any) -> Any:
    """A UFL vector compiled for evaluation at the centre of every cell. Collective."""
    dim = mesh.topology.dim
    simplex = cell_name(mesh) in ("triangle", "tetrahedron")
    center = np.full((1, dim), 1.0 / (dim + 1) if simplex else 0.5)
    return dolfinx.fem.Expression(value, center)


def at_centers(expression: Any, mesh: Any) -> NDArray[np.float64]:
    """Values (cells, components) of a `center_expression` in this rank's cells."""
    cells = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
    return expression.eval(cells)


def cell_volumes(mesh: Any) -> NDArray[np.float64]:
    """Volume (2D: area) of each local cell, from its vertices and the map's Jacobian at its centre."""
    dim = mesh.topology.dim
    vertices = mesh.geometry.x[geometry_dofmap(mesh)][:, : {2: 4, 3: 8}[dim], :dim]
    if cell_name(mesh) in ("triangle", "tetrahedron"):
        edges = vertices[:, 1 : dim + 1] - vertices[:, :1]
        return np.abs(np.linalg.det(edges)) / (2.0 if dim == 2 else 6.0)
    # Tensor vertices are numbered with the first axis running fastest.
    signs = np.array([[1.0 if (v >> axis) & 1 else -1.0 for v in range(2**dim)] for axis in range(dim)])
    return np.abs(np.linalg.det(np.einsum("av,cvi->cai", signs, vertices) / 2 ** (dim - 1)))
