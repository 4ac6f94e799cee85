"""Centre lines of fibers: cubic splines through points, and the places where two fibers are near each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from piezomat.forms.arrays import Array, Integers

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline


STEP = 0.5  # length of the straight segments that distances are measured between, in radii
STEEPEST = 70.0  # degrees: largest angle between a fiber and a face's normal at which its end is cut flush
RAMP = 3.0  # length over which sections turn into a face, over their largest displacement
MOST_BENT = 0.5  # largest radius over radius of curvature at which sections can turn
TIP = 8  # segments to the tip of an end cut at an angle
FLUSH_SHARE = 0.3  # largest share of its length that a fiber loses or gains at a flush end, on any side


@dataclass(frozen=True)
class Face:
    """The plane where coordinate `axis` is `where` (um), and the side of it that is outside: +1 above, -1 below."""

    axis: int
    where: float
    outside: int


@dataclass(frozen=True, eq=False)
class Fiber:
    """A fiber of one radius (um) about the natural cubic spline through points (n, 3), n >= 2.

    The first and the last point lie in the `faces` that cut it, if any. Its ends are flush with these faces, as if the
    fiber continued straight beyond them.
    """

    name: str
    points: Array
    radius: float
    faces: tuple[Face | None, Face | None] = (None, None)

    @cached_property
    def curve(self) -> CubicSpline:
        """The centre line over its parameter, the length of the chords between the points."""
        from scipy.interpolate import CubicSpline  # here: it takes a fifteenth of the time of a small scene

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

    def at(self, along: Array) -> tuple[Array, Array]:
        """Points and derivatives (..., 3) of the centre line at parameters (...,), straight beyond its ends."""
        inside = np.clip(along, 0.0, self.length)
        slope = self.curve(inside, 1)
        return self.curve(inside) + (along - inside)[..., None] * slope, slope

    def samples(self) -> tuple[Array, Array]:
        """Parameters (k,) and points (k, 3) along the centre line, at most half a radius apart."""
        along = np.linspace(0.0, self.length, max(2, int(np.ceil(self.length / (STEP * self.radius))) + 1))
        return along, self.curve(along)

    def cap(self, end: int) -> Array:
        """Ellipse (3, 3), um, of the flush first (0) or last (1) end: centre, half axes to the tip and across."""
        face = self.faces[end]
        normal, slope = np.eye(3)[face.axis], self.curve(end * self.length, 1)
        out = slope / np.linalg.norm(slope) * (1.0 if end else -1.0)
        cosine = face.outside * out[face.axis]
        lean = out - out[face.axis] * normal
        sine = np.linalg.norm(lean)
        lean = lean / sine if sine > 0.0 else np.roll(normal, 1)
        across = self.radius * np.cross(normal, lean)
        return np.stack([self.points[-end], self.radius / cosine * lean, across])

    @property
    def lowest(self) -> float:
        """Height of the lowest of its points and flush ends (um)."""
        caps = [self.cap(end)[:, 2] for end, face in enumerate(self.faces) if face is not None]
        return min([float(self.points[:, 2].min()) - self.radius, *(z - np.hypot(a, b) for z, a, b in caps)])

    def overhang(self, end: int) -> float:
        """Parameter by which the tip of a flush end lies beyond the end of the centre line."""
        slope = self.curve(end * self.length, 1)
        return float(abs(self.cap(end)[1] @ slope) / (slope @ slope))

    def flush(self) -> Fiber:
        """Same fiber without the faces that would cut it too flat for valid cells: its ends there are square."""
        kept = tuple(face if face and self._can_be_flush(end) else None for end, face in enumerate(self.faces))
        return self if kept == self.faces else replace(self, faces=kept)

    def _can_be_flush(self, end: int) -> bool:
        """Whether the fiber is long enough, steep enough wherever the face cuts it, and bends little there."""
        face, most = self.faces[end], FLUSH_SHARE * self.length
        inward = np.linspace(0.0, most, int(np.ceil(most / (0.1 * self.radius))) + 1)
        x, slope = self.at(inward if end == 0 else self.length - inward)
        cosine = face.outside * (1.0 if end else -1.0) * slope[:, face.axis] / np.linalg.norm(slope, axis=1)
        room = face.outside * (face.where - x[:, face.axis])
        whole = room >= self.radius * np.sqrt(np.maximum(1.0 - cosine**2, 0.0)) * (1.0 - 1e-9)
        if not whole.any() or cosine[: whole.argmax() + 1].min() < np.cos(np.radians(STEEPEST)):
            return False
        overhang = self.overhang(end)
        near = inward <= RAMP * overhang
        bend = self.curve(inward if end == 0 else self.length - inward, 2)
        curvature = np.linalg.norm(np.cross(slope, bend), axis=1) / np.linalg.norm(slope, axis=1) ** 3
        return overhang <= most and curvature[near].max() * self.radius <= MOST_BENT


@dataclass(frozen=True)
class Segments:
    """Straight segments that approximate centre lines, continued to the tips of flush ends.

    start, end (n, 3), um; fiber (n,): its number; radius (n,), um; along (n, 2): parameters of both ends.
    """

    start: Array
    end: Array
    fiber: Integers
    radius: Array
    along: Array

    @classmethod
    def of(cls, fibers: Sequence[Fiber]) -> Segments:
        """Segments of fibers, in their order."""
        found = [segment for number, fiber in enumerate(fibers) for segment in cls._of(number, fiber)]
        return cls(*(np.concatenate(values) for values in zip(*found, strict=True)))

    @classmethod
    def _of(cls, number: int, fiber: Fiber) -> Iterator[tuple[NDArray, ...]]:
        """Values of the fields for a fiber between its ends, then for the tip of each flush end.

        The tip of a flush end lies about the half axis of its ellipse. Its radius falls to zero as that of a circle.
        """

        def segments(along: Array, x: Array, radius: Array) -> tuple[NDArray, ...]:
            ends = np.stack([along[:-1], along[1:]], axis=1)
            return x[:-1], x[1:], np.full(len(x) - 1, number), radius, ends

        along, x = fiber.samples()
        yield segments(along, x, np.full(len(x) - 1, fiber.radius))
        angle = np.linspace(0.0, 0.5 * np.pi, TIP + 1)
        for end, face in enumerate(fiber.faces):
            if face is not None and fiber.overhang(end) > 0.0:
                center, half, _ = fiber.cap(end)
                beyond = end * fiber.length + (1.0 if end else -1.0) * fiber.overhang(end) * np.sin(angle)
                yield segments(beyond, center + np.sin(angle)[:, None] * half, fiber.radius * np.cos(angle[:-1]))

    def __getitem__(self, chosen: Integers) -> Segments:
        """Segments of these numbers."""
        return Segments(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))

    def followed_by(self, others: Segments) -> Segments:
        """These segments, then others."""
        names = self.__dataclass_fields__
        return Segments(*(np.concatenate([getattr(self, name), getattr(others, name)]) for name in names))

    def near(self, reach: float) -> tuple[Integers, Integers]:
        """Pairs of segments of different fibers, lower number first, whose surfaces may be within `reach` (um)."""
        middle = 0.5 * (self.start + self.end)
        longest = float(np.linalg.norm(self.end - self.start, axis=1).max())
        pairs = cKDTree(middle).query_pairs(2.0 * float(self.radius.max()) + longest + reach, output_type="ndarray")
        pairs = pairs[self.fiber[pairs[:, 0]] != self.fiber[pairs[:, 1]]]
        swap = self.fiber[pairs[:, 0]] > self.fiber[pairs[:, 1]]
        pairs[swap] = pairs[swap, ::-1]
        return pairs[:, 0], pairs[:, 1]


@dataclass(frozen=True)
class Crossings:
    """Places where two fibers are near each other.

    fibers (n, 2): their numbers, the lower first; along (n, 2): parameters of both; gap (n,), um: least distance of the
    surfaces in the neighbourhood, negative where they overlap.
    """

    fibers: Integers
    along: Array
    gap: Array


def near_places(fibers: Sequence[Fiber], reach: float) -> Crossings:
    """All pairs of segments of different fibers whose surfaces are within `reach` (um)."""
    segments = Segments.of(fibers)
    i, j = segments.near(reach)
    distance, s, t, _ = segment_distances(segments.start[i], segments.end[i], segments.start[j], segments.end[j])
    gap = distance - segments.radius[i] - segments.radius[j]
    near = gap <= reach
    i, j, s, t = i[near], j[near], s[near], t[near]
    along = [segments.along[k, 0] + u * (segments.along[k, 1] - segments.along[k, 0]) for k, u in ((i, s), (j, t))]
    numbers = np.stack([segments.fiber[i], segments.fiber[j]], axis=1)
    return Crossings(numbers, np.stack(along, axis=1), gap[near])


def crossings(fibers: Sequence[Fiber], reach: float) -> Crossings:
    """Places where two fibers are within `reach` (um): the nearest of each stretch over which they stay within it."""
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
    """Distance (n,) of segments a and b with ends (n, 3), parameters (n,) in [0, 1] on both, and vector (n, 3) b to a.

    The least distance of two segments is that of their lines or is attained at an end of one of them (Ericson 2005,
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
