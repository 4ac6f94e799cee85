"""All that depends on the version of DOLFINx (0.5 in Debian 12, 0.9 in Debian 13, 0.11 on PyPI) and of its PETSc.

This is what has changed from one to another, and what lies below the public interface (`dolfinx.cpp`, layouts of
arrays), which may change. No other module reads a version.
"""

from __future__ import annotations

import logging
from functools import partial
from typing import Any

import piezomat.forms.petsc  # noqa: F401

# isort: split
import basix
import dolfinx
import dolfinx.io
import dolfinx.jit
import ffcx
import numpy as np
import ufl
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

VERSION: str = dolfinx.__version__
RELEASE = tuple(int(number) for number in VERSION.split(".")[:2])
NEW, NEWEST = RELEASE >= (0, 9), RELEASE >= (0, 11)
if RELEASE[0] != 0 or RELEASE[1] not in (5, 9, 11):  # no Debian release has what came between
    raise ImportError(f"piezomat runs on DOLFINx 0.5, 0.9 and 0.11, not on {VERSION}")

ADD = dolfinx.la.InsertMode.add if NEW else dolfinx.cpp.la.ScatterMode.add
EQUISPACED = basix.LagrangeVariant.equispaced
# Why SNES stopped: this has a new name in the PETSc of 0.11 (3.25).
_reasons = PETSc.SNES.ConvergedReason
NOT_A_NUMBER = _reasons.DIVERGED_FUNCTION_NANORINF if NEWEST else _reasons.DIVERGED_FNORM_NAN

# The form compiler logs every call of the C compiler to the root logger.
for _handler in logging.getLogger().handlers:
    _handler.setLevel(logging.WARNING)
# The form compiler reads options, such as a plug-in for the C compiler, from files of the home and the working folder,
# which may be a stranger's: no files, as with PETSc and gmsh. A process waits for a form that another one compiles, for
# 10 s by default: too short for those of bricks where many runs start at once.
JIT_TIMEOUT = 120
for _module, _ours in ((dolfinx.jit, {"timeout": JIT_TIMEOUT}), (ffcx.options if NEW else ffcx.parameters, {})):
    setattr(_module, "_load_options" if NEW else "_load_parameters", lambda ours=_ours: (ours, {}))
# PETSc 3.22 ends with a list of unused options, such as those of a solver that no step needed.
PETSc.Options()["options_left"] = "no"


def lagrange(mesh: Any, order: int, components: int) -> Any:
    """Blocked Lagrange space of the given order with `components` unknowns at each node."""
    return _space(mesh, "Lagrange", order, components)


def piecewise_constant(mesh: Any, components: int) -> Any:
    """Blocked space of `components` constants in each cell."""
    return _space(mesh, "DG", 0, components)


def _space(mesh: Any, family: str, order: int, components: int) -> Any:
    if NEW:
        return dolfinx.fem.functionspace(mesh, (family, order, (components,)))
    element = ufl.VectorElement(family, mesh.ufl_cell(), order, dim=components)
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

    cells (n, nodes): input node numbers in DOLFINx order; x (N, dim): their coordinates; on rank 0, empty elsewhere
    destinations (n,): rank of each cell, on rank 0; default equally many cells for each, in their order

    DOLFINx's own partition is never asked for: PT-Scotch's waited for ever once in a few thousand small meshes (7.0.3,
    4 ranks on 2 cores; its ranks had taken different branches).
    """
    gdim = comm.bcast(x.shape[1])
    if destinations is None:
        destinations = np.arange(len(cells)) * comm.size // max(len(cells), 1)
    partition = partial(_partition, np.asarray(destinations, np.int32) if comm.rank == 0 else np.empty(0, np.int32))
    if NEW:
        element = basix.ufl.element("Lagrange", cell_type, order, lagrange_variant=EQUISPACED, shape=(gdim,))
        # The order of the last arguments has changed since 0.9, their names have not.
        arguments = {"cells": cells, "x": x, "e": ufl.Mesh(element), "partitioner": partition}
        return dolfinx.mesh.create_mesh(comm, **arguments)
    cell = ufl.Cell(cell_type, geometric_dimension=gdim)
    scalar = ufl.FiniteElement("Lagrange", cell, order, variant="equispaced")
    domain = ufl.Mesh(ufl.VectorElement(scalar))
    create_partitioner = dolfinx.cpp.mesh.create_cell_partitioner
    return dolfinx.mesh.create_mesh(
        comm, cells, x, domain, dolfinx.cpp.mesh.GhostMode.none, create_partitioner(partition)
    )


def _partition(ranks: NDArray[np.int32], comm: Any, parts: int, *graph: Any) -> Any:
    """Destination ranks of each cell, with the signature of a DOLFINx partitioner.

    Since 0.9 (graph: cell types, cells) only the cell's own rank; 0.5 (graph: cells that share a facet, whether ghosts
    are needed) also the ranks of its neighbours, from which it finds the vertices that ranks share.
    """
    neighbours = None if NEW or not graph[1] else graph[0]
    return _destinations(ranks, neighbours)


def _destinations(ranks: NDArray[np.int32], neighbours: Any | None) -> Any:
    """Destination ranks of each cell: its own first, then those of its `neighbours`, cells across its facets."""
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
    """Local indices and values of tagged entities of dimension `dim`, given on any rank. Collective.

    entities (n, nodes): input node numbers in DOLFINx order; an entity that is not in the mesh is dropped
    values (n,): tags
    """
    topology = mesh.topology
    topology.create_entities(dim)
    topology.create_connectivity(dim, 0)
    topology.create_connectivity(dim, topology.dim)
    if NEW:
        vertices, local_values = dolfinx.io.distribute_entity_data(mesh, dim, entities, values)
        graph = dolfinx.graph.adjacencylist(vertices)
    else:
        vertices, local_values = dolfinx.cpp.io.distribute_entity_data(mesh._mesh, dim, entities, values)
        graph = dolfinx.cpp.graph.AdjacencyList_int32(vertices)
    tags = dolfinx.mesh.meshtags_from_entities(mesh, dim, graph, local_values.astype(np.int32))
    return tags.indices, tags.values


def dofmap(space: Any) -> NDArray[np.int32]:
    """Local block numbers of the nodes of each local cell, (cells, nodes)."""
    return _table(space.dofmap.list, space.dofmap.dof_layout.num_dofs)


def geometry_dofmap(mesh: Any) -> NDArray[np.int32]:
    """Local geometry nodes of each local cell, (cells, nodes)."""
    links = mesh.geometry.dofmaps[0] if NEWEST else mesh.geometry.dofmap
    return _table(links, nodes_per_cell(mesh))


def _table(links: Any, columns: int) -> NDArray[np.int32]:
    return links if NEW else links.array.reshape(links.num_nodes, columns)


def node_ids(mesh: Any) -> NDArray[np.int64]:
    """Input number of each local geometry node."""
    return np.asarray(mesh.geometry.input_global_indices, np.int64)


def original_cells(mesh: Any) -> NDArray[np.int64]:
    """Input number of each local cell."""
    return np.asarray(mesh.topology.original_cell_index, np.int64)


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
    element = mesh.geometry.cmaps[0] if NEWEST else mesh.geometry.cmap
    return int(element.create_dof_layout().num_dofs)


def matrix_from_csr(matrix: PETSc.Mat | None, sizes: Any, block: int, csr: Any, comm: MPI.Comm) -> PETSc.Mat:
    """Matrix with the sparsity pattern and values of `csr`, in place of the given one. Collective.

    PETSc 3.18 can change the pattern of a matrix in use, which saves the memory of a second one; 3.22 then writes
    beyond its arrays on several ranks, so that the matrix is a new one.
    """
    if matrix is not None and PETSc.Sys.getVersion()[:2] <= (3, 18):
        matrix.setPreallocationCSR(csr)
        return matrix
    if matrix is not None:
        matrix.destroy()  # this reference; solvers drop theirs when they receive the new matrix
    return PETSc.Mat().createAIJ(sizes, bsize=block, csr=csr, comm=comm)


def corners_per_cell(mesh: Any) -> int:
    """Number of corners of a cell, also on a rank that has none."""
    return dolfinx.cpp.mesh.cell_num_entities(mesh.topology.cell_type, 0)


def degree(argument: Any) -> int:
    """Polynomial order of the element of a function, a form's argument or a space."""
    return int(_value(argument.ufl_element().degree))


def domain(argument: Any) -> ufl.Mesh:
    """UFL's mesh of a function, or of a form's argument."""
    return argument.ufl_function_space().ufl_domain()


def dimension(argument: Any) -> int:
    """Dimension of the space in which the mesh of a function, or of a form's argument, lies."""
    return int(_value(domain(argument).geometric_dimension))


def cell_name(mesh: Any) -> str:
    """Cells of a mesh, DOLFINx's or UFL's: triangle, quadrilateral, tetrahedron or hexahedron."""
    ufl_mesh = mesh if isinstance(mesh, ufl.Mesh) else mesh.ufl_domain()
    return str(_value(ufl_mesh.ufl_cell().cellname))


def _value(attribute: Any) -> Any:
    """Value of an attribute that is a property in new versions of UFL and was a method before."""
    return attribute() if callable(attribute) else attribute


def sum_over_ranks(space: Any, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values at the local nodes, summed over the ranks that share each node. Collective."""
    scalar = lagrange(space.mesh, degree(space), 1)
    total = dolfinx.fem.Function(scalar)
    order = np.zeros(len(values), np.int32)
    order[dofmap(space)] = dofmap(scalar)
    total.x.array[order] = values
    total.x.scatter_reverse(ADD)
    total.x.scatter_forward()
    return total.x.array[order]


def at_centers(expression: Any, mesh: Any) -> NDArray[np.float64]:
    """Values (cells, components) of a `center_expression` in this rank's cells."""
    cells = np.arange(mesh.topology.index_map(mesh.topology.dim).size_local, dtype=np.int32)
    values = expression.eval(mesh, cells) if NEW else expression.eval(cells)
    return values.reshape(len(cells), values.shape[-1])
