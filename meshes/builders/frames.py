"""Frames along centre lines that twist as little as possible: at parameters, and at points near the line.

The unit vectors across the line are transported in parallel. On a line that is not plane they come round turned, by
minus the integral of its torsion.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from piezomat.forms.arrays import Array
from piezomat.meshes.builders.centre_lines import Fiber

# Length between the frames from which those at points near the line follow, in radii. On two turns of a helix of four
# radii, with a pitch of ten, a sixteenth of it changes them by at most 1e-7.
SPACING = 0.125
STEEP = 0.9  # upward part of a tangent from which on x takes the place of up
ITERATIONS = 5  # of Newton's method to the nearest parameter; quadratic from a sixteenth of a radius


def frames(fiber: Fiber, along: Array) -> tuple[Array, Array, Array]:
    """Points (n, 3) of the centre line and two unit vectors (n, 3) across it, which twist as little as possible.

    along (n,): increasing parameters. The second vector starts upward (along x where the line does). In the plane
    across the line at each parameter a vector is chosen; those at two parameters differ from parallel by an angle, and
    the angles add up.
    """
    x, tangent = fiber.curve(along), _unit(fiber.curve(along, 1))
    up = np.where(np.abs(tangent[:, 2:]) < STEEP, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    first = _unit(up - (up * tangent).sum(axis=-1, keepdims=True) * tangent)
    second = np.cross(first, tangent)
    carried = _transported(first[:-1], x[:-1], x[1:], tangent[:-1], tangent[1:])
    turn = np.arctan2((carried * second[1:]).sum(axis=-1), (carried * first[1:]).sum(axis=-1))
    angle = np.concatenate([[0.0], np.cumsum(turn)])[:, None]
    t = np.cos(angle) * first + np.sin(angle) * second
    return x, np.cross(t, tangent), t


def frames_near(fiber: Fiber, points: Array) -> tuple[Array, Array]:
    """Tangent and second vector of the `frames` (n, 3) where the centre line is nearest to points (n, 3), um.

    The points lie within the fiber. Beyond its ends, which may be flush with a face, it goes on straight.
    """
    along = _dense(fiber)
    x, _, t = frames(fiber, along)
    # Two candidates: where the ends of a ring meet, the nearest sample may be at the other end.
    near = along[cKDTree(x).query(points, k=2)[1]]
    nearest, low, high = near, np.maximum(near - along[1], 0.0), np.minimum(near + along[1], fiber.length)
    for _ in range(ITERATIONS):
        off, slope, bend = fiber.curve(nearest) - points[:, None], fiber.curve(nearest, 1), fiber.curve(nearest, 2)
        square = (slope**2).sum(axis=-1)
        rise = np.maximum(square + (off * bend).sum(axis=-1), 0.1 * square)
        nearest = np.clip(nearest - (off * slope).sum(axis=-1) / rise, low, high)
    choice = ((fiber.curve(nearest) - points[:, None]) ** 2).sum(axis=-1).argmin(axis=1)
    nearest = nearest[np.arange(len(points)), choice]
    # From a frame half a spacing away or more: over a step of no length reflections lose their direction.
    before = np.floor(nearest / along[1] - 0.5).astype(np.int64)
    start = np.where(before < 0, 1, before)
    tangent = _unit(fiber.curve(nearest, 1))
    return tangent, _transported(t[start], x[start], fiber.curve(nearest), _unit(fiber.curve(along[start], 1)), tangent)


def tangents(fiber: Fiber) -> Array:
    """Unit tangents (n, 3) of the centre line, an eighth of a radius apart."""
    return _unit(fiber.curve(_dense(fiber), 1))


def _dense(fiber: Fiber) -> Array:
    return np.linspace(0.0, fiber.length, max(2, int(np.ceil(fiber.length / (SPACING * fiber.radius))) + 1))


def _transported(vector: Array, start: Array, end: Array, tangent: Array, end_tangent: Array) -> Array:
    """Vectors (n, 3) across a line at `start`, where it has a `tangent`, transported to `end`: reflected twice.

    The error in the angle is of the fifth order in the step (Wang et al., ACM Trans. Graph. 27, 2008).
    """
    step = end - start
    return _reflected(_reflected(vector, step), end_tangent - _reflected(tangent, step))


def _reflected(vector: Array, normal: Array) -> Array:
    """Vectors (n, 3) reflected in planes with these normals (n, 3) of any length but zero."""
    share = (normal * vector).sum(axis=-1, keepdims=True) / (normal**2).sum(axis=-1, keepdims=True)
    return vector - 2.0 * share * normal


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
