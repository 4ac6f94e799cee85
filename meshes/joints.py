"""How the cells of a mesh hang together: the facets that they share, cells folded over, and doubtful joints.

Cells are given by their corners in gmsh's order, all in one process. The cost is that of sorting the facets.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from piezomat.forms.arrays import Array, Booleans, Integers

# Corners of each facet of a cell.
FACET_CORNERS = {
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quadrilateral": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "tetrahedron": ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)),
    "hexahedron": ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}
# Facets lie on each other when they are no further apart than this share of their size.
ON_EACH_OTHER = 1e-5
OPPOSITE = -0.99  # cosine of the normals of facets that lie on each other


@dataclass(frozen=True)
class Joint:
    """A doubtful joint between two bodies, or inside of one: numbers of both, how many nodes, and where one of them is.

    kind "double nodes": their facets lie on each other, each with nodes of its own, although no contact acts between
    them. kind "hinge": they share the nodes but no facet around these. bonded: whether the two belong to one
    connected part (double nodes), or are joined by facets elsewhere (hinge).
    """

    kind: Literal["double nodes", "hinge"]
    bodies: tuple[int, int]
    bonded: bool
    nodes: int
    place: tuple[float, ...]


@dataclass(frozen=True)
class CellFacets:
    """All facets of cells: of each cell its facets in turn, m in total.

    x (N, d): nodes, um; corners (n, k): corners of cells
    nodes (m, c): corners of facets; place (m, c): which corners of the cell they are, both sorted by node
    cell (m,): cell of each facet
    """

    cell_type: str
    x: Array
    corners: Integers

    @cached_property
    def cell(self) -> Integers:
        return np.repeat(np.arange(len(self.corners)), len(FACET_CORNERS[self.cell_type]))

    @cached_property
    def around(self) -> Integers:
        """Corners (m, c) of facets in their order around the facet."""
        table = np.array(FACET_CORNERS[self.cell_type])
        return self.corners[:, table].reshape(-1, table.shape[1])

    @cached_property
    def _order(self) -> Integers:
        return np.argsort(self.around, axis=1, kind="stable")

    @cached_property
    def nodes(self) -> Integers:
        return np.take_along_axis(self.around, self._order, axis=1)

    @cached_property
    def place(self) -> Integers:
        table = np.tile(np.array(FACET_CORNERS[self.cell_type]), (len(self.corners), 1))
        return np.take_along_axis(table, self._order, axis=1)

    @cached_property
    def shared(self) -> tuple[Integers, Integers]:
        """Pairs of facets with the same corners."""
        order, same = self._sorted
        at = np.flatnonzero(same)
        return order[at], order[at + 1]

    @cached_property
    def exterior(self) -> Integers:
        """Facets that belong to one cell alone."""
        order, same = self._sorted
        again = np.zeros(len(order), bool)
        again[:-1] |= same
        again[1:] |= same
        return np.sort(order[~again])

    @cached_property
    def _sorted(self) -> tuple[Integers, Booleans]:
        # Sums of random numbers of the nodes are equal for equal sets and practically never for others.
        key = np.random.default_rng(0).integers(2**62, size=len(self.x))[self.nodes].sum(axis=1)
        order = np.argsort(key, kind="stable")
        return order, np.diff(key[order]) == 0

    def outward(self, facets: Integers) -> tuple[Array, Array]:
        """Middles (f, d) and unit normals (f, d) of facets, away from their cells; zero for a facet without area."""
        points = self.x[self.around[facets]]
        middle = points.mean(axis=1)
        if points.shape[2] == 2:
            edge = points[:, 1] - points[:, 0]
            normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
        else:
            diagonals = (0, 2), (1, 3)
            (i, j), (k, m) = diagonals if points.shape[1] == 4 else ((0, 1), (0, 2))
            normal = np.cross(points[:, j] - points[:, i], points[:, m] - points[:, k])
        away = middle - self.x[self.corners[self.cell[facets]]].mean(axis=1)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        sign = np.where(np.einsum("md,md->m", normal, away) < 0.0, -1.0, 1.0)[:, None]
        return middle, sign * normal / np.where(length > 0.0, length, 1.0)

    def folded(self) -> Integers:
        """Facets whose two cells lie on the same side of them: cells that overlap."""
        a, b = self.shared
        return a[np.einsum("md,md->m", self.outward(a)[1], self.outward(b)[1]) > 0.0]


def connected_parts(cells: Integers) -> Integers:
    """Connected part (n,) of each cell with these nodes (n, k): cells that share nodes; in the order of first cells."""
    # One graph of cells and nodes, each cell linked to its nodes.
    count, nodes = cells.shape
    cell, node = np.repeat(np.arange(count), nodes), count + cells.ravel()
    label = _components(int(node.max()) + 1, cell, node)[:count]
    _, first, part = np.unique(label, return_index=True, return_inverse=True)
    number = np.empty(len(first), np.int32)
    number[np.argsort(first)] = np.arange(len(first))
    return number[part]


def doubtful_joints(facets: CellFacets, cell_body: Integers, cell_part: Integers) -> list[Joint]:
    """Double nodes and hinges of a mesh; cell_body (n,), cell_part (n,): body and connected part of each cell."""
    return [*_double_nodes(facets, cell_body, cell_part), *_hinges(facets, cell_body)]


def _double_nodes(facets: CellFacets, cell_body: Integers, cell_part: Integers) -> list[Joint]:
    """Facets of one body or of one connected part that lie on each other."""
    i, j = _on_each_other(facets)
    body, part = cell_body[facets.cell], cell_part[facets.cell]
    apart = (body[i] != body[j]) & (part[i] != part[j])  # these may meet in contact
    i, j = i[~apart], j[~apart]
    pair = np.sort(np.stack([body[i], body[j]], axis=1), axis=1)
    bonded = part[i] == part[j]
    found = []
    for row in np.unique(np.column_stack([pair, bonded]), axis=0):
        rows = (pair == row[:2]).all(axis=1) & (bonded == row[2])
        ours, theirs = facets.nodes[i[rows]], facets.nodes[j[rows]]
        tip = ours[(ours[:, :, None] == theirs[:, None, :]).any(axis=2)]
        nodes = np.setdiff1d(np.concatenate([ours, theirs]), tip)
        double = cKDTree(facets.x[nodes]).query_pairs(
            ON_EACH_OTHER * _size(facets, i[rows]).min(), output_type="ndarray"
        )
        count = len(nodes) - len(np.unique(double[:, 1]))
        place = facets.x[nodes[double[0, 0] if len(double) else 0]]
        found.append(Joint("double nodes", (int(row[0]), int(row[1])), bool(row[2]), count, tuple(place.tolist())))
    return found


def _size(facets: CellFacets, which: Integers) -> Array:
    """Largest distance (f,) of a corner from the middle of its facet, um."""
    points = facets.x[facets.nodes[which]]
    return np.linalg.norm(points - points.mean(axis=1, keepdims=True), axis=2).max(axis=1)


def _on_each_other(facets: CellFacets) -> tuple[Integers, Integers]:
    """Pairs of exterior facets: the middle of the first lies on the second, and their normals are opposite."""
    outside = facets.exterior
    middle, normal = facets.outward(outside)
    size = _size(facets, outside)
    tree = cKDTree(middle)
    near = tree.query_ball_point(middle, size * (1.0 + ON_EACH_OTHER), return_sorted=False)
    count = np.array([len(found) for found in near], int)
    i = np.concatenate([np.asarray(found, np.int64) for found in near]) if len(near) else np.zeros(0, np.int64)
    j = np.repeat(np.arange(len(outside)), count)
    facing = np.einsum("md,md->m", normal[i], normal[j]) < OPPOSITE
    i, j = i[facing], j[facing]
    height = np.abs(np.einsum("md,md->m", middle[i] - middle[j], normal[j]))
    flat = height <= ON_EACH_OTHER * size[j]
    i, j = i[flat], j[flat]
    inside = np.ones(len(i), bool)
    around = facets.x[facets.around[outside[j]]]
    corners = around.shape[1]
    if corners > 2:  # an edge is covered by the ball around it
        for k in range(corners):
            start, end = around[:, k], around[:, (k + 1) % corners]
            inward = np.cross(normal[j], end - start)
            side = np.einsum("md,md->m", inward, middle[i] - start)
            middle_side = np.einsum("md,md->m", inward, middle[j] - start)
            inside &= side * np.sign(middle_side) >= -ON_EACH_OTHER * np.abs(middle_side)
    return outside[i[inside]], outside[j[inside]]


def _hinges(facets: CellFacets, cell_body: Integers) -> list[Joint]:
    """Nodes around which the cells fall into groups that no facet at the node joins."""
    boundary = np.zeros(len(facets.x), bool)
    boundary[facets.nodes[facets.exterior]] = True
    a, b = facets.shared
    at_boundary = boundary[facets.corners]
    item = np.cumsum(at_boundary.ravel()).reshape(at_boundary.shape) - 1  # a cell at one of its boundary nodes
    keep = boundary[facets.nodes[a]]
    first = item[facets.cell[a][:, None], facets.place[a]][keep]
    second = item[facets.cell[b][:, None], facets.place[b]][keep]
    group = _components(int(at_boundary.sum()), first, second)
    node, cell = facets.corners[at_boundary], np.nonzero(at_boundary)[0]
    _, start = np.unique(group, return_index=True)  # a group has one node
    start = start[np.lexsort((cell_body[cell[start]], node[start]))]
    again = np.flatnonzero(np.diff(node[start]) == 0)
    if not len(again):
        return []
    block = _components(len(facets.corners), facets.cell[a], facets.cell[b])
    one, other = cell[start[again]], cell[start[again + 1]]
    pair = np.sort(np.stack([cell_body[one], cell_body[other]], axis=1), axis=1)
    key = np.column_stack([pair, block[one] == block[other]])
    found = []
    for row in np.unique(key, axis=0):
        nodes = np.unique(node[start[again[(key == row).all(axis=1)]]])
        place = tuple(facets.x[nodes[0]].tolist())
        found.append(Joint("hinge", (int(row[0]), int(row[1])), bool(row[2]), len(nodes), place))
    return found


def _components(size: int, first: Integers, second: Integers) -> Integers:
    """Component (size,) of each item, with links between `first` and `second`."""
    graph = coo_matrix((np.ones(len(first), np.int8), (first, second)), shape=(size, size))
    return connected_components(graph, directed=False)[1]
