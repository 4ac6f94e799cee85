"""Geodesic distance of nodes along their connected part: the shortest path through its cells from one of its ends."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import Any

import numpy as np
import scipy.sparse
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc
from scipy.sparse.csgraph import dijkstra

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.meshes.contact.surface import global_numbers, node_coordinates
from piezomat.meshes.ghost_scatter import GhostScatter


def geodesic_distance(space: Any, node_part: Integers, parts: int) -> Array:
    """Geodesic distance (n,), um, of the local nodes of a space from one end of their connected part. Collective.

    The path follows edges and diagonals of cells; the distance of a node that is no corner of a cell is inf. The end is
    the node furthest from the one with the least coordinates, which is an end of a fiber.

    node_part (n,): connected part of each local node; parts: their number
    """
    x, cells = node_coordinates(space), fenicsx.dofmap(space)[:, : fenicsx.corners_per_cell(space.mesh)]
    corner = np.isin(np.arange(len(x)), cells)
    ways, least = _ways(x, cells), _least_over_ranks(space)
    keys, distance = x, np.zeros(0)
    for _ in range(2):
        keys = np.where(corner[:, None], keys, np.inf)
        root = corner & _is_first(space.mesh.comm, keys, node_part, parts)
        distance = _distances(space.mesh.comm, ways, root, least)
        keys = np.column_stack([-distance, x])
    return distance


def _ways(x: Array, cells: NDArray[np.int32]) -> scipy.sparse.csr_matrix:
    """Lengths (n, n) of the edges and diagonals of cells."""
    pairs = [np.sort(cells[:, list(pair)], axis=1) for pair in combinations(range(cells.shape[1]), 2)]
    first, last = np.unique(np.concatenate(pairs), axis=0).T
    length = np.linalg.norm(x[first] - x[last], axis=1)
    one_way = scipy.sparse.csr_matrix((length, (first, last)), shape=(len(x), len(x)))
    return one_way + one_way.T


def _distances(comm: MPI.Comm, ways: scipy.sparse.csr_matrix, root: Booleans, least: Callable[[Array], Array]) -> Array:
    """Length (n,) of the shortest path to a root. Collective.

    Each rank continues from the distances that others have found, until no rank finds a shorter path.
    """
    count = len(root)
    distance = np.where(root, 0.0, np.inf)
    shorter = True
    while shorter:
        known = least(distance)
        # An additional node, connected to each node by an edge as long as the known distance.
        start = np.flatnonzero(np.isfinite(known))
        row = scipy.sparse.csr_matrix((known[start], start, [0, len(start)]), shape=(1, count))
        graph = scipy.sparse.bmat([[None, row], [scipy.sparse.csr_matrix((count, 1)), ways]], format="csr")
        distance = dijkstra(graph, indices=0)[1:]
        shorter = comm.allreduce(bool((distance < known).any()), op=MPI.LOR)
    return distance


def _is_first(comm: MPI.Comm, keys: Array, part: Integers, parts: int) -> Booleans:
    """Whether the keys (n, k) of a node are lexicographically the least of its part on any rank. Collective."""
    least = np.full((parts, keys.shape[1]), np.inf)
    order = np.lexsort((*keys.T[::-1], part))
    here, first = np.unique(part[order], return_index=True)
    least[here] = keys[order[first]]
    for other in comm.allgather(least):
        column = (other != least).argmax(axis=1)[:, None]
        less = np.take_along_axis(other, column, 1) < np.take_along_axis(least, column, 1)
        least = np.where(less, other, least)
    return (keys == least[part]).all(axis=1)


def _least_over_ranks(space: Any) -> Callable[[Array], Array]:
    """Function of values (n,) at the local nodes of a space: the least of any rank. Its calls are collective."""
    index_map = space.dofmap.index_map
    nodes = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
    numbers = global_numbers(space, nodes).astype(PETSc.IntType)
    whole = PETSc.Vec().createMPI((index_map.size_local, None), comm=space.mesh.comm)
    exchange = GhostScatter(whole, PETSc.IS().createGeneral(numbers, comm=MPI.COMM_SELF))

    def least(values: Array) -> Array:
        whole.array[:] = -np.inf
        exchange.maximum(-values, whole)
        return -exchange.gather(whole)

    return least
