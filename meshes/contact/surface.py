"""Contact surfaces: the boundary facets of a body or of a facet group that this rank holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.facets import FacetKind, facet_kind_of
from piezomat.forms.contact.gap import point_normals
from piezomat.meshes.mesh_entities import exterior_facets


@dataclass(frozen=True)
class Surface:
    """Boundary facets of this rank; every boundary facet of the mesh is on exactly one rank.

    nodes (f, n): local node (block) numbers of the function space; the corners of smoothed facets
    reference (f, n, d): undeformed coordinates, um; with the added nodes of smoothed facets
    orientation (f,): +1 or -1, the sign that turns the facet's normal outward
    key (f,): a number of the facet that does not depend on the partition
    cells (f,): local cell
    rounding (f, k, d): offsets of the k added nodes of smoothed facets (`forms.contact.smoothing`); k = 0 without
    """

    name: str
    kind: FacetKind
    nodes: NDArray[np.int32]
    reference: Array
    orientation: Array
    key: Integers
    cells: NDArray[np.int32]
    rounding: Array

    def __len__(self) -> int:
        return len(self.nodes)


def node_coordinates(space: Any) -> Array:
    """Reference coordinates (n, d), um, of the local nodes of a Lagrange space of the mesh's order."""
    mesh = space.mesh
    nodes = fenicsx.dofmap(space)
    index_map = space.dofmap.index_map
    x = np.zeros((index_map.size_local + index_map.num_ghosts, mesh.geometry.dim))
    x[nodes] = mesh.geometry.x[fenicsx.geometry_dofmap(mesh)[: len(nodes)], : mesh.geometry.dim]
    return x


def surface(space: Any, name: str, facets: NDArray[np.int32], order: int) -> Surface:
    """Surface of the local boundary `facets` (f,) of the mesh of `space`. Collective."""
    mesh = space.mesh
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(dim - 1, dim)
    mesh.topology.create_connectivity(dim, dim - 1)
    kind = facet_kind_of(fenicsx.cell_name(mesh), order)
    closure = np.array(fenicsx.facet_closure(space))
    cells = _facet_cells(mesh, facets)
    facets_of_cell = mesh.topology.connectivity(dim, dim - 1).array.reshape(-1, len(closure))
    places = np.argmax(facets_of_cell[cells] == facets[:, None], axis=1)
    cell_nodes = fenicsx.dofmap(space)
    x = node_coordinates(space)
    nodes = cell_nodes[cells[:, None], closure[places]].astype(np.int32).reshape(-1, len(kind.nodes))
    reference = x[nodes]
    outward = reference.mean(axis=1) - x[cell_nodes[cells]].mean(axis=1)
    normal = point_normals(kind, np.tile(kind.middle, (len(nodes), 1)), reference, np.ones(len(nodes)))
    orientation = np.where(np.einsum("md,md->m", normal, outward) > 0.0, 1.0, -1.0)
    key = fenicsx.original_cells(mesh)[cells] * 8 + places
    return Surface(name, kind, nodes, reference, orientation, key, cells, reference[:, :0])


def global_numbers(space: Any, nodes: NDArray[np.int32]) -> Integers:
    """Global numbers of local nodes of a space, in the same shape."""
    numbers = space.dofmap.index_map.local_to_global(nodes.ravel())
    return np.asarray(numbers, np.int64).reshape(nodes.shape)


def multiplicity(space: Any, surface: Surface) -> Array:
    """Number (f, n) of facets of the surface, on all ranks, that share each node of each facet. Collective."""
    counts = np.zeros(space.dofmap.index_map.size_local + space.dofmap.index_map.num_ghosts)
    np.add.at(counts, surface.nodes, 1.0)
    return fenicsx.sum_over_ranks(space, counts)[surface.nodes]


def body_facets(space: Any, cell_body: NDArray[np.int32], body: int) -> NDArray[np.int32]:
    """Local boundary facets of one body. Collective."""
    exterior = exterior_facets(space.mesh)
    return exterior[cell_body[_facet_cells(space.mesh, exterior)] == body]


def _facet_cells(mesh: Any, facets: NDArray[np.int32]) -> NDArray[np.int32]:
    """Cell (f,) of each boundary facet; the connectivity must exist."""
    links = mesh.topology.connectivity(mesh.topology.dim - 1, mesh.topology.dim)
    return links.array[links.offsets[facets]]
