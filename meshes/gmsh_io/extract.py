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

# A cell is degenerate when its least Jacobian is this small beside its greatest.
DEGENERATE = 1e-6
FACETS = {
    "triangle": "interval",
    "quadrilateral": "interval",
    "tetrahedron": "triangle",
    "hexahedron": "quadrilateral",
}
CORNERS = {"interval": 2, "triangle": 3, "quadrilateral": 4}


@dataclass(frozen=True)
class Arrays:
    """Mesh in one process.

    x (N, dimension), um; cells (n, nodes), facets (m, nodes): node numbers in DOLFINx order; cell_body (n,): numbers of
    bodies; facet_values (m,): numbers of combinations, each a tuple of indices into facet_groups, because a facet may
    belong to several groups.
    """

    cell_type: str
    order: int
    x: Array
    cells: Integers
    cell_body: NDArray[np.int32]
    bodies: tuple[str, ...]
    facets: Integers
    facet_values: NDArray[np.int32]
    facet_groups: tuple[str, ...]
    combinations: tuple[tuple[int, ...], ...]

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return self.x.shape[1]

    def head(self) -> Arrays:
        """Same mesh without cells, nodes and facets, for ranks that hold none."""
        names = ("x", "cells", "cell_body", "facets", "facet_values")
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
        raise MeshError(f"cells of type {name} cannot be used (second order needs complete cells: 9, 27 nodes)")
    tags, x = gmsh_model.nodes()
    at = np.argsort(tags)
    tags, x = tags[at], x[at]
    # Only nodes of cells are kept, in the order of their tags.
    used = np.unique(np.concatenate([found.nodes.ravel() for _, found in cells]))
    if not np.isin(used, tags).all():
        raise MeshError("some cells have nodes that do not exist")
    x = x[np.searchsorted(tags, used)]
    _check_cells(dim, [(found, np.searchsorted(used, found.nodes)) for _, found in cells], x)

    all_cells = np.concatenate([np.searchsorted(used, found.nodes) for _, found in cells])
    cell_body = np.concatenate([np.full(len(found.tags), body, np.int32) for body, found in cells])
    _check_once(all_cells, cell_body, bodies)

    name = CELLS[kind][0]
    permutation = fenicsx.gmsh_permutation(name, cells[0][1].nodes.shape[1])
    facets, values, combinations = _facets(dim, (FACETS[name], order), facet_groups, used)
    return Arrays(
        cell_type=name,
        order=order,
        x=np.ascontiguousarray(x[:, :dim]),
        cells=all_cells[:, permutation],
        cell_body=cell_body,
        bodies=tuple(body.name for body in bodies),
        facets=facets,
        facet_values=values,
        facet_groups=tuple(group.name for group in facet_groups),
        combinations=combinations,
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


def _check_cells(dim: int, cells: list[tuple[Elements, Integers]], x: Array) -> None:
    """Raise MeshError where nodes are not finite or not in a plane, or cells are inverted or degenerate."""
    if not np.isfinite(x).all():
        raise MeshError("a node has coordinates that are not finite")
    if dim == 2 and np.ptp(x[:, 2]) > 1e-9 * np.ptp(x, axis=0).max():
        low, high = x[:, 2].min(), x[:, 2].max()
        raise MeshError(f"a 2D mesh must lie in a plane of x and y, but its z goes from {low:g} to {high:g}")
    for found, nodes in cells:
        least = gmsh.model.mesh.getElementQualities(found.tags, "minDetJac")
        greatest = gmsh.model.mesh.getElementQualities(found.tags, "maxDetJac")
        bad = ~(least > DEGENERATE * np.abs(greatest))
        if dim == 2:
            # gmsh measures a plane cell against its own normal. The normal of a whole surface may point either way.
            bad |= ~(_turns(x[nodes], found.type) > 0)
        if bad.any():
            first = x[nodes[np.flatnonzero(bad)[0]]].mean(axis=0)[:dim]
            place = ", ".join(f"{c:.4g}" for c in first)
            raise MeshError(f"inverted or degenerate cells: {int(bad.sum())}, the first at ({place})")


def _turns(x: Array, kind: int) -> Array:
    """Signed area (n,) of plane cells (n, nodes, 3), positive for the orientation of most of them."""
    corners = x[:, : CORNERS[CELLS[kind][0]], :2]
    following = np.roll(corners, -1, axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        area = 0.5 * (corners[..., 0] * following[..., 1] - corners[..., 1] * following[..., 0]).sum(axis=1)
    return area * (1.0 if 2 * (area > 0).sum() >= len(area) else -1.0)


def _facets(
    dim: int, cell: tuple[str, int], found: list[Group], used: Integers
) -> tuple[Integers, NDArray[np.int32], tuple[tuple[int, ...], ...]]:
    """Facets (m, nodes) of groups, the number (m,) of the combination of groups of each, and the combinations."""
    name, order = cell
    width = {"interval": order + 1, "triangle": 3 * order, "quadrilateral": (order + 1) ** 2}[name]
    nodes, member = [np.empty((0, width), np.int64)], [np.empty(0, np.int32)]
    for number, group in enumerate(found):
        for part in (part for entity in group.entities for part in gmsh_model.elements(dim - 1, entity)):
            if CELLS.get(part.type) != cell or not np.isin(part.nodes, used).all():
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


def not_facets(group: str) -> MeshError:
    """Error of a group with elements that are not facets of cells."""
    return MeshError(f"facets of the group {group!r} are not facets of the cells")
