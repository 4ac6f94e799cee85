"""Cells and facets of a distributed mesh: volumes of cells, facets on the boundary."""

from __future__ import annotations

from typing import Any

import dolfinx
import numpy as np
from numpy.typing import NDArray

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array


def cell_volumes(mesh: Any) -> Array:
    """Volume (2D: area) of each local cell, from its vertices and the map's Jacobian at its centre."""
    dim = mesh.topology.dim
    vertices = mesh.geometry.x[fenicsx.geometry_dofmap(mesh)][:, : {2: 4, 3: 8}[dim], :dim]
    if fenicsx.cell_name(mesh) in ("triangle", "tetrahedron"):
        edges = vertices[:, 1 : dim + 1] - vertices[:, :1]
        return np.abs(np.linalg.det(edges)) / (2.0 if dim == 2 else 6.0)
    # Tensor vertices are numbered with the first axis running fastest.
    signs = np.array([[1.0 if (v >> axis) & 1 else -1.0 for v in range(2**dim)] for axis in range(dim)])
    return np.abs(np.linalg.det(np.einsum("av,cvi->cai", signs, vertices) / 2 ** (dim - 1)))


def exterior_facets(mesh: Any) -> NDArray[np.int32]:
    """Local indices of the facets of this rank that lie on the boundary of the mesh. Collective."""
    tdim = mesh.topology.dim
    mesh.topology.create_connectivity(tdim - 1, tdim)
    return np.asarray(dolfinx.mesh.exterior_facet_indices(mesh.topology), np.int32)
