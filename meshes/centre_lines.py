"""Centre lines of fibers: smooth curves through points, and where fibers come near each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

STEP = 0.5  # length of the straight pieces that distances are measured between, in radii


@dataclass(frozen=True, eq=False)
class Fiber:
    """A fiber of one radius (um) about the natural cubic spline through points (n, 3), n >= 2."""

    name: str
    points: Array
    radius: float

    @cached_property
    def curve(self) -> CubicSpline:
        """The centre line over its parameter, the length of the chords between the points."""
        chords = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        return CubicSpline(np.concatenate([[0.0], np.cumsum(chords)]), self.points, bc_type="natural")

    @property
    def length(self) -> float:
        """Length of the centre line (um)."""
        return float(self.curve.x[-1])

    @property
    def volume(self) -> float:
        """Volume (um3)."""
        return np.pi * self.radius**2 * self.length

    def samples(self) -> tuple[Array, Array]:
        """Parameters (k,) and points (k, 3) along the centre line, at most half a radius apart."""
        along = np.linspace(0.0, self.length, max(2, int(np.ceil(self.length / (STEP * self.radius))) + 1))
        return along, self.curve(along)


@dataclass(frozen=True)
class Pieces:
    """Straight pieces of centre lines: ends (n, 3) each, fiber (n,), radius (n,), parameters (n, 2) of the ends."""

    start: Array
    end: Array
    fiber: Integers
    radius: Array
    along: Array

    @classmethod
    def of(cls, fibers: Sequence[Fiber]) -> Pieces:
        """The pieces of some fibers, in their order."""
        sampled = [fiber.samples() for fiber in fibers]
        counts = [len(x) - 1 for _, x in sampled]
        return cls(
            np.concatenate([x[:-1] for _, x in sampled]),
            np.concatenate([x[1:] for _, x in sampled]),
            np.repeat(np.arange(len(fibers)), counts),
            np.repeat([fiber.radius for fiber in fibers], counts),
            np.concatenate([np.stack([s[:-1], s[1:]], axis=1) for s, _ in sampled]),
        )

    def take(self, chosen: Integers) -> Pieces:
        """Some of the pieces."""
        return Pieces(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))

    def joined(self, others: Pieces) -> Pieces:
        """These pieces and others."""
        names = self.__dataclass_fields__
        return Pieces(*(np.concatenate([getattr(self, name), getattr(others, name)]) for name in names))

    def near(self, reach: float) -> tuple[Integers, Integers]:
        """Pairs of pieces of different fibers, the first of the lower number, whose surfaces may be within `reach`."""
        middle = 0.5 * (self.start + self.end)
        longest = float(np.linalg.norm(self.end - self.start, axis=1).max())
        pairs = cKDTree(middle).query_pairs(2.0 * float(self.radius.max()) + longest + reach, output_type="ndarray")
        pairs = pairs[self.fiber[pairs[:, 0]] != self.fiber[pairs[:, 1]]]
        swap = self.fiber[pairs[:, 0]] > self.fiber[pairs[:, 1]]
        pairs[swap] = pairs[swap, ::-1]
        return pairs[:, 0], pairs[:, 1]


@dataclass(frozen=True)
class Crossings:
    """Where fibers come near each other.

    fibers (n, 2): their numbers, the lower first. along (n, 2): parameters on each. gap (n,): distance of the surfaces
    there (um), the least of the neighbourhood; negative where they overlap.
    """

    fibers: Integers
    along: Array
    gap: Array


def near_places(fibers: Sequence[Fiber], reach: float) -> Crossings:
    """Every pair of straight pieces, of different fibers, whose surfaces are within `reach` (um) of each other."""
    pieces = Pieces.of(fibers)
    i, j = pieces.near(reach)
    distance, s, t, _ = segment_distances(pieces.start[i], pieces.end[i], pieces.start[j], pieces.end[j])
    gap = distance - pieces.radius[i] - pieces.radius[j]
    near = gap <= reach
    i, j, s, t = i[near], j[near], s[near], t[near]
    along = [pieces.along[k, 0] + u * (pieces.along[k, 1] - pieces.along[k, 0]) for k, u in ((i, s), (j, t))]
    numbers = np.stack([pieces.fiber[i], pieces.fiber[j]], axis=1)
    return Crossings(numbers, np.stack(along, axis=1), gap[near])


def crossings(fibers: Sequence[Fiber], reach: float) -> Crossings:
    """The places where two fibers are within `reach` (um), one for each stretch over which they stay so near."""
    found = near_places(fibers, reach)
    order = np.lexsort((found.along[:, 0], found.fibers[:, 1], found.fibers[:, 0]))
    numbers, along, gap = found.fibers[order], found.along[order], found.gap[order]
    if not len(gap):
        return found
    radius = np.array([fiber.radius for fiber in fibers])
    apart = np.diff(along[:, 0]) > 2.0 * STEP * radius[numbers[1:, 0]]
    new = np.concatenate([[True], (np.diff(numbers, axis=0) != 0).any(axis=1) | apart])
    stretch = np.cumsum(new) - 1
    nearest = np.lexsort((gap, stretch))
    first = nearest[np.flatnonzero(np.concatenate([[True], np.diff(stretch[nearest]) > 0]))]
    return Crossings(numbers[first], along[first], gap[first])


def segment_distances(a0: Array, a1: Array, b0: Array, b1: Array) -> tuple[Array, Array, Array, Array]:
    """Distance (n,) of straight pieces a and b (ends (n, 3)), where on each, in [0, 1], and the vector (n, 3) b to a.

    The least distance of two segments is either that of their lines or taken at an end of one of them (Ericson 2005,
    ch. 5.1.9).
    """
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    uu, uv, vv = ((p * q).sum(axis=1) for p, q in ((u, u), (u, v), (v, v)))
    uw, vw = (u * w).sum(axis=1), (v * w).sum(axis=1)
    area = uu * vv - uv**2
    parallel = area <= 1e-12 * uu * vv
    s = np.clip(np.where(parallel, 0.0, (uv * vw - vv * uw) / np.where(parallel, 1.0, area)), 0.0, 1.0)
    t = np.clip((vw + s * uv) / vv, 0.0, 1.0)
    s = np.clip((t * uv - uw) / uu, 0.0, 1.0)
    away = w + s[:, None] * u - t[:, None] * v
    return np.linalg.norm(away, axis=1), s, t, away
