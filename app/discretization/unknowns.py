"""The unknowns of a model: displacement and, with permittivity, potential at the nodes of a blocked Lagrange space.

What belongs to no node of the mesh, such as the potential of an electrode or the travel of a plane, is an unknown of a
reference node.
"""

from __future__ import annotations

from typing import Any

import dolfinx
import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.meshes import parallel
from piezomat.meshes.contact.surface import node_coordinates


class Unknowns:
    """Which unknowns there are, which rank owns them, and where they stand in distributed vectors.

    A vector holds the unknowns node by node: the components of the displacement (um), then, in an electric model, the
    potential divided by `Model.potential_scale`. A rank's nodes are the owned ones, then the ghosts. The reference
    nodes come after all nodes of the mesh, on the last rank.

    space: blocked Lagrange space of the mesh's order
    comm: communicator of the mesh
    dim: components of the displacement
    electric: whether each node has a potential
    block: unknowns of a node, dim or dim + 1
    owned: number of nodes of the mesh that this rank owns
    references: number of reference nodes; references_here: of those that this rank owns
    local: number of nodes that this rank holds, ghosts included
    first_node: global number of the first owned node
    total: number of unknowns at the nodes of the mesh over all ranks
    origin (dim,), um: a point near the mesh, the same on all ranks; zero where the mesh is near zero
    coordinates (local, dim), um: the nodes in the undeformed state, relative to the origin: gaps of contact are
        differences of positions, and lose no digits far from zero
    """

    def __init__(self, mesh: Any, order: int, *, electric: bool, references: int = 0) -> None:
        self.comm: MPI.Comm = mesh.comm
        self.dim: int = mesh.geometry.dim
        self.electric = electric
        self.block: int = self.dim + electric
        self.space = fenicsx.lagrange(mesh, order, self.block)
        index_map = self.space.dofmap.index_map
        self.owned: int = index_map.size_local
        self.local: int = index_map.size_local + index_map.num_ghosts
        self.first_node: int = index_map.local_range[0]
        self.total: int = index_map.size_global * self.block
        self.references = references
        self.references_here = references if self.comm.rank == self.comm.size - 1 else 0
        coordinates = node_coordinates(self.space)
        self.origin = _origin(self.comm, coordinates)
        self.coordinates = coordinates - self.origin

    def reference_node(self, reference: int) -> int:
        """Global number of a reference node."""
        return self.total // self.block + reference

    def reference_number(self, reference: int, component: int) -> int:
        """Global number of an unknown of a reference node."""
        return self.reference_node(reference) * self.block + component

    def empty_vector(self, comm: MPI.Comm) -> PETSc.Vec:
        """A distributed vector on a communicator of the mesh's ranks. Collective.

        PETSc keeps what Python has released until its communicator is cleaned up. That of the mesh ends before the
        vectors of a run do, whose memory would then stay: 4 MB of 26,000 unknowns.
        """
        here = (self.owned + self.references_here) * self.block
        return PETSc.Vec().createMPI((here, self.total + self.references * self.block), self.block, comm)

    def ghosted_vector(self, comm: MPI.Comm) -> PETSc.Vec:
        """A vector of the unknowns of the mesh alone, with room for ghosts, as forms are assembled into. Collective."""
        index_map = self.space.dofmap.index_map
        ghosts = index_map.ghosts.astype(PETSc.IntType)
        return PETSc.Vec().createGhost(ghosts, (self.owned * self.block, self.total), self.block, comm)

    def by_node(self, vector: PETSc.Vec) -> Array:
        """View (owned, block) of this rank's values of a vector at the nodes of the mesh, for reading."""
        return vector.array_r[: self.owned * self.block].reshape(self.owned, self.block)

    def set_by_node(self, vector: PETSc.Vec, values: Array) -> None:
        """Give a vector these values (owned, block) at the nodes of the mesh. Not collective, but for all ranks."""
        vector.array[: values.size] = values.ravel()

    def displacements(self, vector: PETSc.Vec) -> Array:
        """View (owned, dim) of this rank's displacement part of a vector, for reading."""
        return self.by_node(vector)[:, : self.dim]

    def all_displacements(self, vector: PETSc.Vec) -> Array:
        """View (owned + references_here, dim) of that part, the motions at reference nodes included, for reading."""
        return vector.array_r.reshape(-1, self.block)[:, : self.dim]

    def potentials(self, vector: PETSc.Vec) -> Array:
        """View (owned,) of this rank's potential part of a vector, for reading."""
        return self.by_node(vector)[:, self.dim]

    def norms(self, vector: PETSc.Vec) -> Array:
        """Euclidean norms of the displacement part and, in an electric model, the potential part. Collective."""
        squares = vector.array_r.reshape(-1, self.block) ** 2
        parts = [squares[:, : self.dim].sum()]
        if self.electric:
            parts.append(squares[:, -1].sum())
        return np.sqrt(parallel.total(self.comm, np.array(parts)))

    def numbers(self, nodes: Integers) -> NDArray[np.int32]:
        """Numbers (k * block,) of all unknowns of nodes (k,): global of global nodes, local of local nodes."""
        return (nodes[:, None] * self.block + np.arange(self.block)).ravel().astype(PETSc.IntType)

    def displacement_numbers(self) -> NDArray[np.int32]:
        """Global numbers of the owned displacements, those of reference nodes included."""
        return (self._owned_nodes()[:, None] * self.block + np.arange(self.dim)).ravel().astype(PETSc.IntType)

    def potential_numbers(self) -> NDArray[np.int32]:
        """Global numbers of the owned potentials, those of reference nodes included."""
        return (self._owned_nodes() * self.block + self.dim).astype(PETSc.IntType)

    def nodes_of(self, facets: NDArray[np.int32]) -> NDArray[np.int64]:
        """Owned nodes on facets of any rank. Collective."""
        nodes = dolfinx.fem.locate_dofs_topological(self.space, self.dim - 1, facets)
        return np.asarray(nodes[nodes < self.owned], np.int64)

    def touched(self, cells: Booleans) -> Booleans:
        """Whether one of these cells (of this rank,) of any rank touches each local node (local,). Collective."""
        nodes = fenicsx.dofmap(self.space)
        touched = np.zeros(self.local)
        touched[nodes[cells[: len(nodes)]]] = 1.0
        return fenicsx.sum_over_ranks(self.space, touched) > 0.0

    def _owned_nodes(self) -> NDArray[np.int64]:
        return np.arange(self.first_node, self.first_node + self.owned + self.references_here)


def _origin(comm: MPI.Comm, x: Array) -> Array:
    """A point (dim,) near the nodes x (n, dim) of all ranks, um, from which they differ by exact numbers. Collective.

    A multiple of a power of two that is no smaller than the mesh: the difference of two numbers of one size is exact.
    """
    low = parallel.least(comm, x.min(axis=0, initial=np.inf))
    high = parallel.largest(comm, x.max(axis=0, initial=-np.inf))
    unit = 2.0 ** np.ceil(np.log2((high - low).max()))
    return unit * np.round(0.5 * (low + high) / unit)
