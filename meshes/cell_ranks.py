"""Which rank gets which cell: equally many for each, whole bodies where that can be."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from piezomat.forms.arrays import Array


def cell_ranks(centroids: Array, bodies: NDArray[np.int32], ranks: int) -> NDArray[np.int32]:
    """Rank (cells,) of cells with these centroids (cells, dim) and bodies (cells,).

    Recursive bisection of the bodies, in their order. The body in which a cut lies is cut across its longer side.
    On four ranks, 4 % of the nodes of two fibers in 2D lie on several of them, and 11 % of crossed ones of tetrahedra;
    cut in the order of gmsh's cells, 68 and 87 %.
    """
    rank = np.zeros(len(centroids), np.int32)
    parts = [(np.argsort(bodies, kind="stable"), 0, ranks)]
    while parts:
        cells, first, count = parts.pop()
        rank[cells] = first
        if count == 1 or not len(cells):
            continue
        cut = len(cells) * (count // 2) // count
        here = np.flatnonzero(bodies[cells] == bodies[cells[cut]])
        x = centroids[cells[here]]
        cells[here] = cells[here[np.argsort(x[:, np.ptp(x, axis=0).argmax()], kind="stable")]]
        parts += [(cells[:cut], first, count // 2), (cells[cut:], first + count // 2, count - count // 2)]
    return rank
