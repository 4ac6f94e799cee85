"""Structured meshes: cells between the points of a lattice, whole or split into simplices, in the gmsh model."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Literal

import gmsh
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from piezomat.forms.arrays import Array, Integers
from piezomat.meshes.gmsh_io import model as gmsh_model
from piezomat.meshes.gmsh_io.model import CELLS

Side = tuple[int, Literal[0, -1]]
GMSH_TYPE = {cell: kind for kind, cell in CELLS.items()}
BOXES = {1: "interval", 2: "quadrilateral", 3: "hexahedron"}
SIMPLICES = {1: "interval", 2: "triangle", 3: "tetrahedron"}


class Lattice:
    """Points in rows, columns (and layers) and the cells between them.

    `points` has shape (rows, columns(, layers), dim) with order * cells + 1 points along each axis. Each box
    is one cell, or is split along one diagonal into 2 triangles or 6 tetrahedra, which match between boxes.
    """

    def __init__(self, points: Array, order: int, tensor: bool) -> None:
        self.points, self.order, self.tensor = points, order, tensor
        self.shape = points.shape[:-1]

    @classmethod
    def box(cls, axes: Sequence[Array], order: int, tensor: bool) -> Lattice:
        """Lattice of a box with these cell ends along its axes."""
        fine = [np.interp(np.arange(order * (len(a) - 1) + 1) / order, np.arange(len(a)), a) for a in axes]
        return cls(np.stack(np.meshgrid(*fine, indexing="ij"), axis=-1), order, tensor)

    @property
    def dim(self) -> int:
        """Dimension of the cells."""
        return len(self.shape)

    def cells(self) -> Integers:
        """Points of each cell (n, nodes), numbered through the lattice, in gmsh's order."""
        return np.ravel_multi_index(tuple(np.moveaxis(self._index(self.shape), -1, 0)), self.shape)

    def facets(self, side: Side) -> Integers:
        """Points of each facet (n, nodes) on a side (axis, first or last), in gmsh's order."""
        axis, end = side
        on_side = self._index(tuple(np.delete(self.shape, axis)))
        index = np.insert(on_side, axis, end % self.shape[axis], axis=-1)
        return np.ravel_multi_index(tuple(np.moveaxis(index, -1, 0)), self.shape)

    def move(self, moved: Callable[[Array], Array]) -> None:
        """Move the points: `moved` gives their new positions, as an array of the same shape."""
        self.points = moved(self.points)

    def distort(self, fraction: float, seed: int) -> None:
        """Move the corners inside by up to this fraction of the least cell size along each axis.

        Edges stay straight. The same seed gives the same mesh.
        """
        dim, order = self.dim, self.order
        corners = self.points[(slice(None, None, order),) * dim].copy()
        spacing = np.array([np.diff(corners, axis=d)[..., d].min() for d in range(dim)])
        inside = (slice(1, -1),) * dim
        move = np.random.default_rng(seed).uniform(-fraction, fraction, corners.shape)
        corners[inside] += (move * spacing)[inside]
        index = np.stack(np.meshgrid(*(np.arange(n) for n in self.shape), indexing="ij"), axis=-1)
        low, high = index // order, -(-index // order)
        if self.tensor:
            ends = [np.where(choice, high, low) for choice in np.ndindex((2,) * dim)]
        else:
            ends = [low, high]
        self.points = np.mean([corners[tuple(np.moveaxis(end, -1, 0))] for end in ends], axis=0)

    def _index(self, shape: tuple[int, ...]) -> Integers:
        """Lattice index (n, nodes, dim) of the nodes of the cells of a lattice of this shape."""
        dim, order = len(shape), self.order
        counts = [(n - 1) // order for n in shape]
        boxes = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1).reshape(-1, 1, dim)
        nodes = [np.rint(order * offset).astype(np.int64) for offset in _nodes(dim, order, self.tensor)]
        return np.concatenate([order * boxes + offset for offset in nodes])


def _nodes(dim: int, order: int, tensor: bool) -> list[Array]:
    """Nodes (nodes, dim) in the unit box of the cells that fill it, in gmsh's order."""
    kind = GMSH_TYPE[(BOXES if tensor else SIMPLICES)[dim], order]
    local = np.reshape(gmsh.model.mesh.getElementProperties(kind)[4], (-1, dim))
    if tensor or dim == 1:
        return [0.5 * (local + 1)]
    simplices = []
    for axes in permutations(range(dim)):
        corners = np.zeros((dim + 1, dim))
        for step, axis in enumerate(axes):
            corners[step + 1 :, axis] = 1
        if np.linalg.det(corners[1:] - corners[0]) < 0:
            corners[[-2, -1]] = corners[[-1, -2]]
        simplices.append(corners[0] + local @ (corners[1:] - corners[0]))
    return simplices


@dataclass(frozen=True)
class BodyPatch:
    """Lattice that is a body or a part of it, with the facet groups of its sides."""

    body: str
    lattice: Lattice
    sides: Mapping[Side, Sequence[str]]


class PatchMesh:
    """Mesh of patches in the current gmsh model, with its bodies and facet groups.

    Every patch has tags of its own, so that patches may be added to several models which then become one.
    """

    def __init__(self, dim: int) -> None:
        self.dim = dim
        self.nodes = self.elements = 0
        self.entities = [0] * (dim + 1)  # of each dimension
        self.bodies: dict[str, list[int]] = {}
        self.groups: dict[str, list[int]] = {}

    def add(self, *patches: BodyPatch) -> None:
        """Add patches with cells of one kind that share nodes where they meet, and none with patches added before."""
        x = np.concatenate([patch.lattice.points.reshape(-1, patch.lattice.points.shape[-1]) for patch in patches])
        number = merged(x) if len(patches) > 1 else np.arange(len(x))
        _, first = np.unique(number, return_index=True)
        x = np.pad(x[first], ((0, 0), (0, 3 - x.shape[1])))
        tags = self.nodes + 1 + np.arange(len(x))
        self.nodes += len(x)
        start = 0
        cells: dict[str, list[Integers]] = {}
        facets: dict[tuple[str, ...], list[Integers]] = {}
        for patch in patches:
            mine = tags[number[start : start + np.prod(patch.lattice.shape)]]
            start += len(mine)
            cells.setdefault(patch.body, []).append(mine[patch.lattice.cells()])
            for side, groups in patch.sides.items():
                facets.setdefault(tuple(groups), []).append(mine[patch.lattice.facets(side)])
        # gmsh takes longer the more entities there are: one for each body, one for its facets of the same groups.
        lattice, first_entity = patches[0].lattice, self.entities[self.dim] + 1
        for body, nodes in cells.items():
            entity = self._entity(self.dim)
            if entity == first_entity:
                gmsh.model.mesh.addNodes(self.dim, entity, tags, x.ravel())
            self._elements(self.dim, entity, np.concatenate(nodes), lattice)
            self.bodies.setdefault(body, []).append(entity)
        for groups, nodes in facets.items():
            entity = self._entity(self.dim - 1)
            self._elements(self.dim - 1, entity, np.concatenate(nodes), lattice)
            for group in groups:
                self.groups.setdefault(group, []).append(entity)

    def _entity(self, dim: int) -> int:
        self.entities[dim] += 1
        return gmsh.model.addDiscreteEntity(dim, self.entities[dim])

    def _elements(self, dim: int, entity: int, nodes: Integers, lattice: Lattice) -> None:
        kind = GMSH_TYPE[(BOXES if lattice.tensor else SIMPLICES)[dim], lattice.order]
        tags = self.elements + 1 + np.arange(len(nodes))
        self.elements += len(nodes)
        gmsh.model.mesh.addElementsByType(entity, kind, tags, nodes.ravel())

    def finish(self, groups: Iterable[str]) -> None:
        """Name bodies and facet groups, these in the given order."""
        gmsh_model.add_groups(self.dim, self.bodies)
        gmsh_model.add_groups(self.dim - 1, {name: self.groups[name] for name in groups})


def merged(x: Array) -> Integers:
    """Numbers (n,) of points (n, d), equal for points in the same place."""
    pairs = cKDTree(x).query_pairs(1e-9 * float(np.ptp(x, axis=0).max()), output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(x), len(x)))
    return connected_components(graph, directed=False)[1]
