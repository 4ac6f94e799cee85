"""What bodies cover of a plane: the area of their projection along its normal."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from piezomat.forms.arrays import Array
from piezomat.meshes import parallel

PIXELS = 512  # across the larger extent of the projection; a mat's area is then right to some 1e-4
BATCH = 1_000_000  # pixels that are tested at once


def covered_area(comm: MPI.Comm, facets: Array, normal: Array) -> float:
    """Area of the projection along a unit normal (d,) of flat facets on all ranks, um2 (2D: um). Collective.

    facets (f, n, d): corners, um: of lines, triangles or quadrilaterals
    """
    across = np.linalg.svd(normal[None])[2][1:]
    flat = facets @ across.T
    if flat.shape[2] == 1:
        return _length(np.concatenate(comm.allgather(np.sort(flat[:, :, 0], axis=1)[:, [0, -1]])))
    low = parallel.least(comm, flat.min(axis=(0, 1), initial=np.inf))
    extent = parallel.largest(comm, flat.max(axis=(0, 1), initial=-np.inf)) - low
    count = np.maximum(np.ceil(PIXELS * extent / extent.max()).astype(int), 1)
    triangles = np.concatenate([flat[:, [0, 1, 2]], flat[:, [1, 2, 3]]] if flat.shape[1] == 4 else [flat])
    pixels = _pixels((triangles - low) / (extent / count), count)
    comm.Allreduce(MPI.IN_PLACE, pixels, op=MPI.MAX)
    return float(pixels.mean() * extent.prod())


def _length(intervals: Array) -> float:
    """Length of the union of intervals (f, 2)."""
    low, high = intervals[np.argsort(intervals[:, 0])].T
    before = np.concatenate([[-np.inf], np.maximum.accumulate(high)[:-1]])
    return float(np.maximum(high - np.maximum(low, before), 0.0).sum())


def _pixels(triangles: Array, count: Array) -> Array:
    """Whether the middle of each pixel lies in a triangle, 0 or 1; triangles (f, 3, 2) in pixels from the first one."""
    pixels = np.zeros(count, np.uint8)
    first = np.clip(np.ceil(triangles.min(axis=1) - 0.5).astype(int), 0, count - 1)
    width = np.clip(np.floor(triangles.max(axis=1) - 0.5).astype(int), 0, count - 1) - first + 1
    each = np.maximum(width, 0).prod(axis=1)
    batch = np.cumsum(each) // BATCH
    for some in (np.flatnonzero(batch == k) for k in np.unique(batch)):
        of = np.repeat(some, each[some])
        place = np.arange(len(of)) - np.repeat(np.cumsum(each[some]) - each[some], each[some])
        pixel = first[of] + np.column_stack(np.divmod(place, width[of, 1]))
        a, b, c = (triangles[of, k] for k in range(3))
        sides = np.stack([_turn(q - p, pixel + 0.5 - p) for p, q in ((a, b), (b, c), (c, a))])
        inside = (sides >= 0.0).all(axis=0) | (sides <= 0.0).all(axis=0)
        pixels[tuple(pixel[inside].T)] = 1
    return pixels


def _turn(u: Array, v: Array) -> Array:
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
