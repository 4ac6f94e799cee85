"""Parallel fibers, square, hexagonal or packed at random: discs in 2D, cylinders along x in 3D."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree

from piezomat.forms.arrays import Array, Integers
from piezomat.meshes.builders.centre_lines import Fiber
from piezomat.meshes.builders.extrude import Body, Frame, draw
from piezomat.meshes.builders.sections import Disc
from piezomat.meshes.builders.sizes import MeshSizes
from piezomat.meshes.shapes.fiber_shape import CONTACT_ZONE, CROSSING, FiberShape, Outcome

Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]


class FiberArray(FiberShape):
    """2D discs or, with `length`, 3D cylinders along x, in a box from the origin across (x in 2D, y in 3D) and upwards.

    square: one above the other; hexagonal: every second row half a fiber further; random: dropped one by one, each
    rolling to rest on two others, on a wall and another, or on the floor. Bodies `fiber_1` and so on, from below.
    """

    shape: Literal["fiber_array"] = "fiber_array"
    arrangement: Literal["square", "hexagonal", "random"] = "square"
    columns: Count = Field(3, description="fibers side by side; of a random packing the width over two radii")
    rows: Count = Field(3, description="rows, from below; of a random packing columns x rows is the number of fibers")
    radius: Positive = Field(0.5, description="mean radius (um)")
    radius_spread: float = Field(
        0.0, ge=0, le=0.5, description="random: standard deviation of the radius over its mean"
    )
    length: Positive | None = Field(None, description="length along x (um); absent: 2D")
    gap: float = Field(0.0, description="distance between neighbours, half of it to floor and walls (um)")
    seed: Annotated[int, Field(ge=0)] = Field(0, description="random: the same seed packs the same fibers")

    @property
    def dimension(self) -> int:
        return 2 if self.length is None else 3

    @cached_property
    def discs(self) -> Array:
        """Across, up and radius (n, 3) of each fiber (um)."""
        if self.arrangement == "random":
            # While they fall, radii are larger by half the gap.
            return self._packed(0.5 * self.gap)
        pitch = 2.0 * self.radius + self.gap
        shifted = 0.5 if self.arrangement == "hexagonal" else 0.0
        rise = np.sqrt(1.0 - shifted**2)
        row, column = (index.ravel() for index in np.indices((self.rows, self.columns)))
        across = (0.5 + column + shifted * (row % 2)) * pitch
        up = (0.5 + rise * row) * pitch
        return np.column_stack([across, up, np.full(len(up), self.radius)])

    def _packed(self, skin: float) -> Array:
        random = np.random.default_rng(self.seed)
        count = self.columns * self.rows
        spread = np.sqrt(np.log1p(self.radius_spread**2))
        radii = self.radius * np.exp(spread * random.standard_normal(count) - 0.5 * spread**2) + skin
        width = max(2.0 * (self.radius + skin) * self.columns, 2.0 * radii.max())
        placed = np.zeros((0, 3))
        for radius in radii:
            x = random.uniform(radius, width - radius)
            places = _resting_places(placed, radius, x, width)
            near = places[np.abs(places[:, 0] - x) <= 3.0 * radius]
            choice = near if len(near) else places
            place = choice[np.lexsort((choice[:, 0], np.round(choice[:, 1], 9)))[0]]
            placed = np.vstack([placed, [*place, radius]])
        placed = placed[np.argsort(placed[:, 1], kind="stable")]
        return placed - [0.0, 0.0, skin]

    @cached_property
    def fibers(self) -> tuple[Fiber, ...]:
        length = 1.0 if self.length is None else self.length
        return tuple(
            Fiber(f"fiber_{i}", np.array([[0.0, y, z], [length, y, z]]), float(r))
            for i, (y, z, r) in enumerate(self.discs, start=1)
        )

    def end_groups(self) -> dict[str, tuple[int, float]]:
        return {} if self.length is None else {"left": (0, 0.0), "right": (0, self.length)}

    def facet_groups(self) -> tuple[str, ...]:
        return ("surfaces",) if self.length is None else super().facet_groups()

    def size(self) -> float:
        least = 2.0 * float(self.discs[:, 2].min())
        return least if self.length is None else min(least, self.length)

    @property
    def area(self) -> float:
        return float(np.diff(self._box[:, 0])[0]) * (self.length or 1.0)

    @cached_property
    def _box(self) -> Array:
        """Least and largest coordinates (2, 2) of the array, across and up (um)."""
        x, r = self.discs[:, :2], self.discs[:, 2:]
        return np.stack([(x - r).min(axis=0), (x + r).max(axis=0)])

    @cached_property
    def _touching(self) -> tuple[Integers, Array]:
        """Pairs (k, 2) of neighbours within a tenth of a radius, and their gaps (k,)."""
        x, r = self.discs[:, :2], self.discs[:, 2]
        reach = CONTACT_ZONE * float(r.min())
        pairs = cKDTree(x).query_pairs(2.0 * float(r.max()) + reach, output_type="ndarray").reshape(-1, 2)
        gap = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1) - r[pairs].sum(axis=1)
        return pairs[gap <= reach], gap[gap <= reach]

    def contacts(self, number: int) -> tuple[tuple[float, float], ...]:
        x, r = self.discs[number, :2], self.discs[number, 2]
        pairs, _ = self._touching
        others = np.concatenate([pairs[pairs[:, 0] == number, 1], pairs[pairs[:, 1] == number, 0]])
        away = self.discs[others, :2] - x
        places = [tuple(p) for p in (r * away / np.linalg.norm(away, axis=1, keepdims=True)).tolist()]
        low, high = np.abs(x - self._box[0]) - r, np.abs(x - self._box[1]) - r
        for axis, unit in enumerate(np.eye(2)):
            places += [tuple((-r * unit).tolist())] if low[axis] <= CONTACT_ZONE * r else []
            places += [tuple((r * unit).tolist())] if high[axis] <= CONTACT_ZONE * r else []
        return tuple(places) or ((0.0, -float(r)),)

    def places_along(self) -> list[Array]:
        # Parallel fibers meet along lines: the section is fine there, layers need not be.
        return [np.zeros(0) for _ in self.fibers]

    def build(self, sizes: MeshSizes) -> None:
        if self.length is not None:
            super().build(sizes)
            return
        bodies = []
        for number, (fiber, (x, y, r)) in enumerate(zip(self.fibers, self.discs.tolist(), strict=True)):
            section = Disc(r, ("surfaces",) * 6)
            bodies.append(Body(fiber.name, section, Frame.upright(x, y), self.contacts(number), r))
        draw(bodies, self.facet_groups(), sizes)

    def outcome(self) -> Outcome:
        _, gap = self._touching
        low, high = self._box
        area, seen = float(np.pi * (self.discs[:, 2] ** 2).sum()), float(high[0] - low[0])
        ends = [] if self.length is None else [0.0], [] if self.length is None else [self.length]
        return Outcome(
            len(self.discs),
            int((gap <= CROSSING * self.discs[:, 2].min()).sum()),
            1.0 - area / (seen * float(high[1] - low[1])),
            area / seen,
            seen if self.length is None else seen * self.length,
            None if self.length is None else 1.0,
            float(gap.min()) if len(gap) else None,
            (*ends[0], *low.tolist()),
            (*ends[1], *high.tolist()),
        )


def _resting_places(placed: Array, radius: float, x: float, width: float) -> Array:
    """Centres (n, 2) where a disc rests without overlap with `placed` (n, 3), walls at 0 and `width`, or the floor.

    The disc rests on two others, on another and a wall, or on the floor, also at `x`. At least one place is free.
    """
    on_floor = [[x, radius], [radius, radius], [width - radius, radius]]
    found = [np.array(on_floor)]
    if len(placed):
        c, reach = placed[:, :2], placed[:, 2] + radius
        for side, wall in ((-1.0, radius), (1.0, width - radius)):
            up = reach**2 - (wall - c[:, 0]) ** 2
            # The wall supports it on one side, so the disc must be on the other.
            on = (up >= 0.0) & (side * (wall - c[:, 0]) >= 0.0)
            found.append(np.column_stack([np.full(on.sum(), wall), c[on, 1] + np.sqrt(up[on])]))
        level = reach**2 - (radius - c[:, 1]) ** 2
        for side in (-1.0, 1.0):
            on = level >= 0.0
            found.append(np.column_stack([c[on, 0] + side * np.sqrt(level[on]), np.full(on.sum(), radius)]))
        i, j = cKDTree(c).query_pairs(2.0 * float(reach.max()), output_type="ndarray").reshape(-1, 2).T
        away = c[j] - c[i]
        distance = np.linalg.norm(away, axis=1)
        along = (distance**2 + reach[i] ** 2 - reach[j] ** 2) / (2.0 * distance)
        square = reach[i] ** 2 - along**2
        unit = away / distance[:, None]
        across = np.column_stack([-unit[:, 1], unit[:, 0]]) * np.sign(unit[:, :1] + 1e-300)
        pair = c[i] + along[:, None] * unit + np.sqrt(np.maximum(square, 0.0))[:, None] * across
        between = (pair[:, 0] >= np.minimum(c[i, 0], c[j, 0])) & (pair[:, 0] <= np.maximum(c[i, 0], c[j, 0]))
        found.append(pair[(square >= 0.0) & between])
    places = np.concatenate(found)
    tiny = 1e-9 * radius
    free = (places[:, 0] >= radius - tiny) & (places[:, 0] <= width - radius + tiny) & (places[:, 1] >= radius - tiny)
    for start in range(0, len(placed), 200):
        off = places[:, None] - placed[start : start + 200, :2]
        free &= (np.linalg.norm(off, axis=2) >= placed[start : start + 200, 2] + radius - tiny).all(axis=1)
    return places[free]
