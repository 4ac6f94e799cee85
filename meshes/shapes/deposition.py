"""Deposition of fibers one by one, stiff or bending: each comes to rest on those below it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from piezomat.forms.arrays import Array
from piezomat.meshes.builders.centre_lines import Face, Fiber, Segments, segment_distances

Faces = tuple[Face | None, Face | None]

ROUNDS = 200  # largest number of corrections of a fiber's height until it touches those below without overlap
TOUCHING = 1e-9  # largest remaining overlap, in radii


class Bed:
    """The fibers laid so far, on a floor at height 0."""

    def __init__(self, bend_radius: float | None, gap: float) -> None:
        """bend_radius (um): least radius of curvature of a fiber that bends; None: stiff. gap (um): between fibers."""
        self.fibers: list[Fiber] = []
        self.bend_radius, self.gap = bend_radius, gap
        self._segments: Segments | None = None
        self._tree: cKDTree | None = None

    def lay(self, name: str, plan: Array, radius: float, faces: Faces = (None, None)) -> Fiber:
        """Lay a fiber along points (n, 2) seen from above; returns it at rest.

        The tips of ends that `faces` cut are part of the fiber, so that they overlap nothing either.
        A stiff fiber stays level at the height of its first contact. A bending fiber follows the fibers below as
        closely as its radius of curvature allows and touches them at least at one place.
        """
        flat = Fiber(name, np.column_stack([plan, np.full(len(plan), radius)]), radius, faces).flush()
        along, x = flat.samples() if self.bend_radius is not None else (flat.curve.x, flat.points)
        below = self._below(flat)
        wanted = np.full(len(x), radius)
        if below is not None:
            if self.bend_radius is not None:
                wanted = self._supports(x, below, wanted)
            else:
                mine = Segments.of([flat])
                balls = np.concatenate([mine.start, mine.end])
                wanted[:] = self._supports(balls, below, np.tile(mine.radius, 2)).max()
        fiber = self._at(flat, x, self._drape(along, wanted))
        for _ in range(ROUNDS if below is not None else 0):
            lift, places = self._missing(fiber, below)
            if not len(lift) or lift.max() <= TOUCHING * radius:
                break
            if self.bend_radius is None:
                wanted = wanted + lift.max()
            else:
                rise = np.zeros(len(x))
                near = np.clip(np.searchsorted(fiber.curve.x, places), 1, len(along) - 1)
                for k in (near - 1, near):
                    np.maximum.at(rise, k, lift)
                wanted = wanted + rise
            fiber = self._at(fiber, x, self._drape(along, wanted))
        # Rigid and small: up out of a remaining overlap, or down into contact.
        for _ in range(ROUNDS if below is not None else 0):
            lift, _ = self._missing(fiber, below)
            move = max(lift.max(initial=-np.inf), -fiber.lowest)
            if abs(move) <= TOUCHING * radius:
                break
            fiber = self._at(fiber, x, fiber.points[:, 2] + move)
        self._add(fiber)
        return fiber

    @property
    def top(self) -> float:
        """Height of the highest fiber (um)."""
        return max((float(f.points[:, 2].max()) + f.radius for f in self.fibers), default=0.0)

    def _at(self, fiber: Fiber, x: Array, height: Array) -> Fiber:
        """Fiber through points x at other heights. An end once square stays square, so that it does not alternate."""
        return Fiber(fiber.name, np.column_stack([x[:, :2], height]), fiber.radius, fiber.faces).flush()

    def _drape(self, along: Array, wanted: Array) -> Array:
        """Heights (n,) of a fiber not below `wanted` (n,): constant, or with a curvature of at most 1 / bend_radius.

        Lasry and Lions (Israel J. Math. 55, 1986): the supremum of downward parabolas, then the infimum of upward ones
        twice as narrow, is a curve on or above the wanted one whose curvature is bounded in both directions.
        """
        if self.bend_radius is None:
            return np.full(len(along), wanted.max())
        square = (along[:, None] - along) ** 2 / (2.0 * self.bend_radius)
        raised = (wanted - 0.5 * square).max(axis=1)
        return (raised + square).min(axis=1)

    def _below(self, flat: Fiber) -> Segments | None:
        """Segments that the fiber crosses in the view from above."""
        if self._tree is None:
            return None
        mine = Segments.of([flat])
        x = np.concatenate([mine.start, mine.end])[:, :2]
        reach = flat.radius + self._thickest + self.gap + 2.0 * self._longest
        near = np.unique(np.concatenate([np.asarray(n, np.int64) for n in self._tree.query_ball_point(x, reach)]))
        return self._segments[near.astype(np.int64)] if len(near) else None

    def _supports(self, x: Array, below: Segments, radius: Array) -> Array:
        """Lowest heights (n,) at which single balls at x (n, 3) of a radius (n,) do not overlap segments below."""
        a, u = below.start[:, :2], (below.end - below.start)[:, :2]
        share = np.einsum("nkd,kd->nk", x[:, None, :2] - a, u) / np.maximum((u * u).sum(axis=1), 1e-300)
        share = np.clip(share, 0.0, 1.0)
        off = x[:, None, :2] - a - share[..., None] * u
        clear = (radius[:, None] + below.radius + self.gap) ** 2 - (off**2).sum(axis=2)
        height = below.start[:, 2] + share * (below.end - below.start)[:, 2] + np.sqrt(np.maximum(clear, 0.0))
        return np.maximum(radius, np.where(clear > 0.0, height, -np.inf).max(axis=1))

    def _missing(self, fiber: Fiber, below: Segments) -> tuple[Array, Array]:
        """Rise (n,), um, that removes each overlap, negative for a gap, and its parameter (n,) along the fiber."""
        mine = Segments.of([fiber])
        reach = fiber.radius + self._thickest + self.gap + 2.0 * self._longest
        middle = cKDTree(0.5 * (below.start + below.end))
        found = middle.query_ball_point(0.5 * (mine.start + mine.end), reach)
        i = np.repeat(np.arange(len(found)), [len(n) for n in found])
        j = np.concatenate([np.asarray(n, np.int64) for n in found]).astype(np.int64)
        distance, s, _, away = segment_distances(mine.start[i], mine.end[i], below.start[j], below.end[j])
        missing = mine.radius[i] + below.radius[j] + self.gap - distance
        # Raising by dz moves the nearest points apart by dz times the upward part of the line between them.
        upward = np.maximum(away[:, 2] / np.maximum(distance, 1e-300), 0.3)
        return missing / upward, mine.along[i, 0] + s * (mine.along[i, 1] - mine.along[i, 0])

    def _add(self, fiber: Fiber) -> None:
        self.fibers.append(fiber)
        segments = Segments.of([fiber])
        self._segments = segments if self._segments is None else self._segments.followed_by(segments)
        middle = 0.5 * (self._segments.start + self._segments.end)
        self._tree = cKDTree(middle[:, :2])
        self._longest = float(np.linalg.norm(self._segments.end - self._segments.start, axis=1).max())
        self._thickest = float(self._segments.radius.max())


def lay_all(
    plans: Sequence[tuple[str, Array, float, Faces]], bend_radius: float | None = None, gap: float = 0.0
) -> list[Fiber]:
    """Lay fibers (name, points (n, 2) seen from above, radius, faces that cut it) one by one."""
    bed = Bed(bend_radius, gap)
    for plan in plans:
        bed.lay(*plan)
    return bed.fibers
