"""Fibers meshed by sweeping the mesh of a disc along a centre line: bricks, or tetrahedra that split them.

All arrays are of a whole fiber, so that mats of a hundred fibers take seconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import gmsh
import numpy as np

from piezomat.forms.arrays import Array, Integers
from piezomat.meshes.builders.centre_lines import FLUSH_SHARE, RAMP, Face, Fiber
from piezomat.meshes.builders.frames import frames
from piezomat.meshes.builders.sections import Disc
from piezomat.meshes.builders.sizes import Size
from piezomat.meshes.builders.structured import BOXES, GMSH_TYPE, SIMPLICES, merged

# The prism over a triangle a, b, c (in the order of its numbers), cut into tetrahedra: (corner, level) of each node.
# Every side of the prism is cut from its lower to its higher number, so that neighbours match.
TETRAHEDRA = (
    ((0, 0), (1, 0), (2, 0), (2, 1)),
    ((0, 0), (1, 0), (1, 1), (2, 1)),
    ((0, 0), (0, 1), (1, 1), (2, 1)),
)
SIDE_TRIANGLES = (((0, 0), (1, 0), (1, 1)), ((0, 0), (0, 1), (1, 1)))
TURNS = 60  # Newton iterations to the intersection of each line with the face; a straight fiber takes two


@dataclass(frozen=True)
class Section:
    """Meshed disc: points (n, 2); point numbers of cells (c, order + 1, order + 1) and of rim edges (e, order + 1)."""

    points: Array
    cells: Integers
    rim: Integers
    order: int

    @classmethod
    def disc(cls, radius: float, size: Size, order: int) -> Section:
        """Disc about (0, 0) of quadrilaterals of this size, all with the same orientation."""
        patches = Disc(radius, ("rim",) * 6).patches(size, order)
        x = np.concatenate([patch.points.reshape(-1, 2) for patch in patches])
        number = merged(x)
        _, first = np.unique(number, return_index=True)
        cells, rim, start = [], [], 0
        for patch in patches:
            rows, columns = patch.points.shape[:2]
            grid = number[start : start + rows * columns].reshape(rows, columns)
            start += rows * columns
            if patch.sides:
                rim.append(_windows(grid[:, -1], order))
            rows_of = _windows(np.arange(rows), order)
            columns_of = _windows(np.arange(columns), order)
            boxes = grid[rows_of[:, None, :, None], columns_of[None, :, None, :]]
            cells.append(boxes.reshape(-1, order + 1, order + 1))
        points, found = x[first], np.concatenate(cells)
        a, b, c = (points[found[:, i, j]] for i, j in ((0, 0), (-1, 0), (0, -1)))
        turned = _area(b - a, c - a) < 0.0
        found[turned] = np.swapaxes(found[turned], 1, 2)
        return cls(points, found, np.concatenate(rim), order)


@dataclass(frozen=True)
class Swept:
    """Mesh of a fiber: nodes x (n, 3); cells, lateral facets and facets of both ends by node, in gmsh's order."""

    x: Array
    cells: Integers
    lateral: Integers
    ends: tuple[Integers, Integers]


def sweep(section: Section, fiber: Fiber, along: Array, tensor: bool) -> Swept:
    """Mesh of a fiber with a section at each parameter `along` (order * layers + 1,) of its centre line.

    tensor: bricks instead of tetrahedra. Towards an end that is flush with a face the sections turn into the face.
    """
    order, width = section.order, len(section.points)
    origin, s, t = frames(fiber, along)
    x = origin[:, None] + section.points[:, :1] * s[:, None] + section.points[:, 1:] * t[:, None]
    for end, face in enumerate(fiber.faces):
        if face is not None:
            _turn_into(face, end, x, section, fiber, along, t)
    levels = order * np.arange((len(along) - 1) // order)
    cell, lateral, end = (_bricks if tensor else _tetrahedra)(section)

    def stacked(inside: tuple[Integers, Integers]) -> Integers:
        points, level = inside
        return (width * (levels[:, None, None] + level) + points).reshape(-1, points.shape[1])

    return Swept(x.reshape(-1, 3), stacked(cell), stacked(lateral), (end, end + width * (len(along) - 1)))


def _turn_into(face: Face, end: int, x: Array, section: Section, fiber: Fiber, along: Array, t: Array) -> None:
    """Move the nodes x (levels, points, 3) along the fiber so that its last sections turn into a face that cuts it.

    end: 0 or 1; t (levels, 3): second vector of the `frames`. Each node moves on its line parallel to the centre line,
    so that the lateral surface does not change.
    """
    last, inward, beyond = -end, FLUSH_SHARE * fiber.length, fiber.overhang(end)
    limits = (-inward, beyond) if end else (-beyond, inward)

    def places(levels: Integers, by: Array) -> tuple[Array, Array]:
        center, slope = fiber.at(along[levels, None] + by)
        tangent = slope / np.linalg.norm(slope, axis=-1, keepdims=True)
        up = t[levels, None] - (t[levels, None] * tangent).sum(axis=-1, keepdims=True) * tangent
        up /= np.linalg.norm(up, axis=-1, keepdims=True)
        return center + section.points[:, :1] * np.cross(up, tangent) + section.points[:, 1:] * up, slope

    by = np.zeros((1, len(section.points)))
    here = np.arange(len(along))[[last]]
    for _ in range(TURNS):
        found, slope = places(here, by)
        off = face.where - found[..., face.axis]
        by = np.clip(by + off / slope[..., face.axis], *limits)
        if abs(off).max() < 1e-13 * fiber.length:
            break
    furthest = abs(by).max()
    if furthest > 0.0:
        zone = min(RAMP * furthest, 0.5 * fiber.length)
        share = np.clip(1.0 - abs(along - along[last]) / zone, 0.0, 1.0)
        order = section.order
        share = np.interp(np.arange(len(along)) / order, np.arange(len(along[::order])), share[::order])
        near = np.flatnonzero(share)
        x[near] = places(near, share[near, None] * by)[0]
    x[last, :, face.axis] = face.where


def add(swept: Swept, order: int, tensor: bool, first_node: int) -> tuple[int, int, tuple[int, int]]:
    """Add a fiber to the current gmsh model, with nodes from `first_node` on: its volume, lateral face and two ends."""
    kinds = BOXES if tensor else SIMPLICES
    volume = gmsh.model.addDiscreteEntity(3)
    tags = first_node + np.arange(len(swept.x))
    gmsh.model.mesh.addNodes(3, volume, tags, swept.x.ravel())
    gmsh.model.mesh.addElementsByType(volume, GMSH_TYPE[kinds[3], order], [], tags[swept.cells].ravel())
    faces = []
    for facets in (swept.lateral, *swept.ends):
        faces.append(gmsh.model.addDiscreteEntity(2))
        gmsh.model.mesh.addElementsByType(faces[-1], GMSH_TYPE[kinds[2], order], [], tags[facets].ravel())
    return volume, faces[0], (faces[1], faces[2])


def _windows(numbers: Integers, order: int) -> Integers:
    """Runs (n, order + 1) of consecutive numbers, each starting at the end of the previous one."""
    return numbers[order * np.arange((len(numbers) - 1) // order)[:, None] + np.arange(order + 1)]


def _local(kind: str, order: int) -> Array:
    """Coordinates (nodes, dim) of a cell's nodes in units of their distance, in gmsh's order; simplices barycentric."""
    _, dim, _, _, local, _ = gmsh.model.mesh.getElementProperties(GMSH_TYPE[kind, order])
    local = np.reshape(local, (-1, dim))
    if kind in BOXES.values():
        return np.rint(0.5 * order * (local + 1.0)).astype(np.int64)
    return np.rint(order * np.column_stack([1.0 - local.sum(axis=1), local])).astype(np.int64)


def _bricks(section: Section) -> tuple[tuple[Integers, Integers], tuple[Integers, Integers], Integers]:
    """Bricks: section points (n, nodes) and levels (nodes,) of a layer's cells and lateral facets; facets of an end."""
    order = section.order
    i, j, k = _local("hexahedron", order).T
    u, v = _local("quadrilateral", order).T
    return (section.cells[:, i, j], k), (section.rim[:, u], v), section.cells[:, u, v]


def _area(a: Array, b: Array) -> Array:
    """Signed area spanned by two vectors of the plane. (NumPy 2 has the cross product of vectors of space only.)"""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _tetrahedra(section: Section) -> tuple[tuple[Integers, Integers], tuple[Integers, Integers], Integers]:
    """Tetrahedra, as `_bricks`: a quadrilateral is two triangles, a prism over a triangle three tetrahedra."""
    order, cells = section.order, section.cells
    corners = [[(0, 0), (order, 0), (order, order)], [(0, 0), (order, order), (0, order)]]
    places = np.repeat(np.array(corners), len(cells), axis=0)  # (triangles, 3, 2) within the quadrilateral
    of = np.tile(np.arange(len(cells)), 2)
    number = cells[of[:, None], places[..., 0], places[..., 1]]
    rank = np.argsort(number, axis=1)
    places = np.take_along_axis(places, rank[..., None], axis=1)
    a, b, c = (section.points[np.take_along_axis(number, rank, axis=1)[:, i]] for i in range(3))
    left = _area(b - a, c - a) > 0.0

    weights = _local("tetrahedron", order)
    points, levels = [], []
    for cut in TETRAHEDRA:
        corner, level = np.array(cut).T
        # The orientation of a tetrahedron depends on the cut and on the orientation of the reordered triangle.
        solid = np.array([[*((0, 0), (1, 0), (0, 1))[k], h] for k, h in cut], float)
        positive = (np.linalg.det(solid[1:] - solid[0]) > 0.0) == left
        for chosen, nodes in ((positive, weights), (~positive, weights[:, [0, 1, 3, 2]])):
            inside = np.einsum("nk,tkd->tnd", nodes, places[chosen][:, corner]) // order
            points.append(cells[of[chosen][:, None], inside[..., 0], inside[..., 1]])
            levels.append(np.tile(nodes @ level, (len(points[-1]), 1)))
    flat = _local("triangle", order)
    inside = np.einsum("nk,tkd->tnd", flat, places) // order
    end = cells[of[:, None], inside[..., 0], inside[..., 1]]

    rising = section.rim[:, 0] < section.rim[:, -1]
    rim = np.where(rising[:, None], section.rim, section.rim[:, ::-1])
    sides = [np.array(cut) for cut in SIDE_TRIANGLES]
    lateral = np.concatenate([rim[:, flat @ side[:, 0]] for side in sides])
    heights = np.concatenate([np.tile(flat @ side[:, 1], (len(rim), 1)) for side in sides])
    return (np.concatenate(points), np.concatenate(levels)), (lateral, heights), end
