"""From the current gmsh model to arrays in DOLFINx order, checked to be a valid mesh of bodies."""

from __future__ import annotations

from dataclasses import dataclass, replace

import gmsh
import numpy as np
from numpy.typing import NDArray

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array, Integers
from piezomat.meshes.gmsh_io import model as gmsh_model
from piezomat.meshes.gmsh_io.model import CELLS, Elements, Group, MeshError
from piezomat.meshes.joints import CellFacets, Joint, connected_parts, doubtful_joints

# A cell is degenerate when its least Jacobian is this small beside its greatest.
DEGENERATE = 1e-6
FACETS = {
    "triangle": "interval",
    "quadrilateral": "interval",
    "tetrahedron": "triangle",
    "hexahedron": "quadrilateral",
}
CORNERS = {"interval": 2, "triangle": 3, "quadrilateral": 4, "tetrahedron": 4, "hexahedron": 8}


@dataclass(frozen=True)
class Arrays:
    """Mesh in one process.

    x (N, dimension), um; cells (n, nodes), facets (m, nodes): node numbers in DOLFINx order; cell_body (n,): numbers of
    bodies; cell_part (n,): numbers of connected parts; facet_values (m,): numbers of combinations, each a tuple of
    indices into facet_groups, because a facet may belong to several groups; joints: the doubtful ones.
    """

    cell_type: str
    order: int
    x: Array
    cells: Integers
    cell_body: NDArray[np.int32]
    cell_part: NDArray[np.int32]
    bodies: tuple[str, ...]
    facets: Integers
    facet_values: NDArray[np.int32]
    facet_groups: tuple[str, ...]
    combinations: tuple[tuple[int, ...], ...]
    joints: tuple[Joint, ...]

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return self.x.shape[1]

    def head(self) -> Arrays:
        """Same mesh without cells, nodes and facets, for ranks that hold none."""
        names = ("x", "cells", "cell_body", "cell_part", "facets", "facet_values")
        return replace(self, **{name: getattr(self, name)[:0].copy() for name in names})


def mesh_arrays(order: int) -> Arrays:
    """Arrays of the current gmsh model, with cells of the given order. Raises MeshError."""
    dim = gmsh_model.cell_dimension()
    bodies, facet_groups = gmsh_model.body_and_facet_groups(dim)
    cells = _cells(dim, bodies)
    if CELLS.get(cells[0][1].type, ("", 0))[1] != order:
        gmsh.model.mesh.setOrder(order)
        cells = _cells(dim, bodies)
    kind = cells[0][1].type
    if CELLS.get(kind, ("", 0))[1] != order:
        name = gmsh_model.type_name(kind)
        raise MeshError(
            f"cells of type {name} cannot be used with mesh.order = 2: second order needs complete cells (9, 27 nodes)"
        )
    tags, x = gmsh_model.nodes()
    at = np.argsort(tags)
    tags, x = tags[at], x[at]
    # Only nodes of cells are kept, in the order of their tags.
    used = np.unique(np.concatenate([found.nodes.ravel() for _, found in cells]))
    if not np.isin(used, tags).all():
        raise MeshError("some cells have nodes that do not exist")
    x = x[np.searchsorted(tags, used)]
    all_cells = np.concatenate([np.searchsorted(used, found.nodes) for _, found in cells])
    cell_body = np.concatenate([np.full(len(found.tags), body, np.int32) for body, found in cells])
    _check_nodes(dim, x)
    _check_once(all_cells, cell_body, bodies)
    name = CELLS[kind][0]
    _check_cells(dim, np.concatenate([found.tags for _, found in cells]), x[all_cells])
    cell_facets = CellFacets(name, x[:, :dim], all_cells[:, : CORNERS[name]])
    _check_folds(cell_facets)
    cell_part = connected_parts(all_cells)

    permutation = fenicsx.gmsh_permutation(name, cells[0][1].nodes.shape[1])
    facets, values, combinations = _facets(dim, (FACETS[name], order), facet_groups, used)
    return Arrays(
        cell_type=name,
        order=order,
        x=np.ascontiguousarray(x[:, :dim]),
        cells=all_cells[:, permutation],
        cell_body=cell_body,
        cell_part=cell_part,
        bodies=tuple(body.name for body in bodies),
        facets=facets,
        facet_values=values,
        facet_groups=tuple(group.name for group in facet_groups),
        combinations=combinations,
        joints=tuple(doubtful_joints(cell_facets, cell_body, cell_part)),
    )


def _cells(dim: int, bodies: list[Group]) -> list[tuple[int, Elements]]:
    """Cells of each entity with the number of the body, all of one type, each cell in just one body."""
    cells: list[tuple[int, Elements]] = []
    for number, body in enumerate(bodies):
        mine = [(number, found) for entity in body.entities for found in gmsh_model.elements(dim, entity)]
        if not mine:
            raise MeshError(f"body {body.name!r} has no cells")
        cells += mine
    named = {entity for body in bodies for entity in body.entities}
    for _, entity in gmsh.model.getEntities(dim):
        if entity not in named and gmsh_model.elements(dim, entity):
            raise MeshError("some cells belong to no physical group, so to no body")
    kinds = {found.type for _, found in cells}
    for name in sorted(gmsh_model.type_name(kind) for kind in kinds):
        if not name.startswith(tuple(shape.capitalize() for shape in FACETS)):
            raise MeshError(f"cells of type {name} cannot be used, only {', '.join(FACETS)} cells")
    if len(kinds) > 1:
        names = " and ".join(sorted(gmsh_model.type_name(kind) for kind in kinds))
        raise MeshError(f"it mixes cells of different types ({names}); use one")
    return cells


def _check_once(cells: Integers, cell_body: NDArray[np.int32], bodies: list[Group]) -> None:
    """Raise MeshError where two cells have the same nodes."""
    # Sums of random numbers of the nodes are equal for equal sets and practically never for others.
    key = np.random.default_rng(0).integers(2**62, size=int(cells.max()) + 1)[cells].sum(axis=1)
    order = np.argsort(key)
    again = np.flatnonzero(np.diff(key[order]) == 0)
    if len(again):
        first, second = (bodies[cell_body[order[again[0] + i]]].name for i in (0, 1))
        if first == second:
            raise MeshError(f"body {first!r} has two cells with the same nodes")
        raise MeshError(f"bodies {first!r} and {second!r} have cells in common")


def _check_nodes(dim: int, x: Array) -> None:
    """Raise MeshError where nodes are not finite or, of a 2D mesh, not in a plane of x and y."""
    if not np.isfinite(x).all():
        raise MeshError("a node has coordinates that are not finite")
    if dim == 2 and np.ptp(x[:, 2]) > 1e-9 * np.ptp(x, axis=0).max():
        low, high = x[:, 2].min(), x[:, 2].max()
        raise MeshError(f"a 2D mesh must lie in a plane of x and y, but its z goes from {low:g} to {high:g}")


def _check_cells(dim: int, tags: Integers, x: Array) -> None:
    """Raise MeshError where cells, given by gmsh's tags (n,) and nodes (n, nodes, 3), are inverted or degenerate.

    Each cell is measured against its own orientation: surfaces and volumes may be drawn either way.
    """
    least, greatest = (gmsh.model.mesh.getElementQualities(tags, f"{name}DetJac") for name in ("min", "max"))
    low, high = np.minimum(np.abs(least), np.abs(greatest)), np.maximum(np.abs(least), np.abs(greatest))
    bad = ~((least * np.sign(greatest) > 0.0) & (low > DEGENERATE * high))
    if bad.any():
        first = np.flatnonzero(bad)[0]
        raise MeshError(f"inverted or degenerate cells: {int(bad.sum())}, the first at {_place(x[first, :, :dim])}")


def _check_folds(facets: CellFacets) -> None:
    """Raise MeshError where two cells lie on the same side of the facet that they share."""
    folded = facets.folded()
    if len(folded):
        place = _place(facets.x[facets.nodes[folded[0]]])
        raise MeshError(
            f"inverted or degenerate cells overlap their neighbours: at {len(folded)} facets, as at {place}"
        )


def _place(points: Array) -> str:
    """The middle of some points (n, d) in words."""
    return "(" + ", ".join(f"{c:.4g}" for c in points.mean(axis=0)) + ")"


def _facets(
    dim: int, cell: tuple[str, int], found: list[Group], used: Integers
) -> tuple[Integers, NDArray[np.int32], tuple[tuple[int, ...], ...]]:
    """Facets (m, nodes) of groups, the number (m,) of the combination of groups of each, and the combinations."""
    name, order = cell
    width = {"interval": order + 1, "triangle": 3 * order, "quadrilateral": (order + 1) ** 2}[name]
    nodes, member = [np.empty((0, width), np.int64)], [np.empty(0, np.int32)]
    for number, group in enumerate(found):
        for part in (part for entity in group.entities for part in gmsh_model.elements(dim - 1, entity)):
            if CELLS.get(part.type) != cell or not _are_in(part.nodes, used):
                raise not_facets(group.name)
            nodes.append(part.nodes)
            member.append(np.full(len(part.tags), number, np.int32))
    every, group_of = np.searchsorted(used, np.concatenate(nodes)), np.concatenate(member)
    corners = np.sort(every[:, : CORNERS[name]], axis=1)
    _, first, same = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    belongs = np.zeros((len(first), len(found)), bool)
    belongs[same.ravel(), group_of] = True
    patterns, value = np.unique(belongs, axis=0, return_inverse=True)
    combinations = tuple(tuple(np.flatnonzero(pattern).tolist()) for pattern in patterns)
    return (
        every[first][:, fenicsx.gmsh_permutation(name, width)],
        value.ravel().astype(np.int32),
        combinations,
    )


def _are_in(nodes: Integers, used: Integers) -> bool:
    """Whether all nodes are used ones, which are sorted."""
    place = np.minimum(np.searchsorted(used, nodes), len(used) - 1)
    return bool((used[place] == nodes).all())


def not_facets(group: str) -> MeshError:
    """Error of a group with elements that are not facets of cells."""
    return MeshError(f"facets of the group {group!r} are not facets of the cells")
