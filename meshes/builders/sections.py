"""Sections of bodies in a plane (s, t): as an outline for a free mesh, or cut into four-sided patches.

Lines of a patch are divided by the cell size along them, so that patches are graded like free meshes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezomat.forms.arrays import Array
from piezomat.meshes.builders.sizes import Curve, Line, Size, arc, straight
from piezomat.meshes.builders.structured import Side

# Corner of the inner patch of a half disc, in radii from its flat side and from its axis.
INNER = 0.4


@dataclass(frozen=True)
class Edge:
    """Edge of an outline, from `start` to the start of the next one: straight, or an arc about (0, 0)."""

    start: tuple[float, float]
    group: str
    round: bool = False


@dataclass(frozen=True)
class Patch:
    """Points (rows, columns, 2) of a patch and the facet groups of the sides that lie on the outline."""

    points: Array
    sides: dict[Side, str]


@dataclass(frozen=True)
class HalfDisc:
    """The half of a disc about (0, 0) above, or below, its flat side."""

    radius: float
    up: bool
    flat: str
    curved: str

    def in_units_of(self, unit: float) -> HalfDisc:
        """The same in another unit of length, um."""
        return replace(self, radius=self.radius / unit)

    def outline(self) -> list[Edge]:
        """Edges, with a corner at the apex."""
        first = 0 if self.up else 180
        arcs = [Edge(_on_circle(self.radius, first + angle), self.curved, True) for angle in (0, 90)]
        return [*arcs, Edge(_on_circle(self.radius, first + 180), self.flat)]

    def patches(self, size: Size, order: int) -> list[Patch]:
        """An inner patch on the flat side and three between it and the arc."""
        return _butterfly([_Half(self.radius, self.up, (self.curved,) * 3, self.flat)], size, order)


@dataclass(frozen=True)
class Disc:
    """A disc about (0, 0); `groups` of its arcs from 0 to 45, 135, 180, 225, 315 and 360 degrees."""

    radius: float
    groups: tuple[str, str, str, str, str, str]

    def in_units_of(self, unit: float) -> Disc:
        """The same in another unit of length, um."""
        return replace(self, radius=self.radius / unit)

    def outline(self) -> list[Edge]:
        """Edges, with a corner wherever it may touch another body."""
        right, top, left, left_below, bottom, right_below = self.groups
        eighths = (right, top, top, left, left_below, bottom, bottom, right_below)
        return [Edge(_on_circle(self.radius, 45 * i), group, True) for i, group in enumerate(eighths)]

    def patches(self, size: Size, order: int) -> list[Patch]:
        """Patches of two half discs."""
        right, top, left, left_below, bottom, right_below = self.groups
        above = _Half(self.radius, True, (left, top, right))
        below = _Half(self.radius, False, (right_below, bottom, left_below))
        return _butterfly([above, below], size, order)


@dataclass(frozen=True)
class Rectangle:
    """A rectangle below (0, 0), the middle of its upper side."""

    width: float
    height: float
    bottom: str
    right: str
    top: str
    left: str

    def in_units_of(self, unit: float) -> Rectangle:
        """The same in another unit of length, um."""
        return replace(self, width=self.width / unit, height=self.height / unit)

    def outline(self) -> list[Edge]:
        """Edges, with a corner in the middle of the upper side."""
        w, h = 0.5 * self.width, self.height
        starts = [(-w, -h), (w, -h), (w, 0.0), (0.0, 0.0), (-w, 0.0)]
        groups = [self.bottom, self.right, self.top, self.top, self.left]
        return [Edge(start, group) for start, group in zip(starts, groups, strict=True)]

    def patches(self, size: Size, order: int) -> list[Patch]:
        """One on each side of the middle, so that a node lies at (0, 0)."""
        w, h = 0.5 * self.width, self.height
        lines = [[straight((s, t), (0.0, t)) for t in (-h, 0.0)] for s in (-w, w)]
        across = _cells([line for pair in lines for line in pair], size)
        up = _cells([straight((s, -h), (s, 0.0)) for s in (-w, 0.0, w)], size)
        left, right = (_ruled(*pair, across, up, size, order) for pair in lines)
        level: dict[Side, str] = {(1, 0): self.bottom, (1, -1): self.top}
        return [
            Patch(left, {(0, 0): self.left, **level}),
            Patch(right[::-1], {(0, -1): self.right, **level}),
        ]


class _Half:
    """Half a disc cut into an inner patch on the flat side and three outer ones, clockwise.

    corners (4, 2) of the inner patch, clockwise from the flat side; arcs and groups of the outer ones; `flat`
    is the group of the flat side, absent where the other half of the disc follows.
    """

    def __init__(self, radius: float, up: bool, groups: tuple[str, str, str], flat: str | None = None) -> None:
        a = INNER * radius
        self.corners = (1.0 if up else -1.0) * np.array([[-a, 0.0], [-a, a], [a, a], [a, 0.0]])
        angles = [angle if up else angle + 180 for angle in (180, 135, 45, 0)]
        self.ends = np.array([_on_circle(radius, angle) for angle in angles])
        self.arcs = [arc(radius, angles[i], angles[i + 1]) for i in range(3)]
        self.apex = np.array(_on_circle(radius, 90 if up else 270))
        self.groups, self.flat = groups, flat

    def inner(self) -> tuple[Curve, Curve]:
        """The lines along the flat side and opposite to it that bound the inner patch."""
        return straight(self.corners[0], self.corners[3]), straight(self.corners[1], self.corners[2])

    def across(self) -> list[Curve]:
        """Lines along the flat side."""
        return [*self.inner(), self.arcs[1]]

    def up(self) -> list[Curve]:
        """Lines away from the flat side, up to the height of the inner patch."""
        c = self.corners
        middle = straight(0.5 * (c[0] + c[3]), 0.5 * (c[1] + c[2]))
        return [straight(c[0], c[1]), middle, straight(c[3], c[2]), self.arcs[0], self.arcs[2]]

    def out(self) -> list[Curve]:
        """Lines from the inner patch to the arc."""
        rays = [straight(corner, end) for corner, end in zip(self.corners, self.ends, strict=True)]
        return [straight(0.5 * (self.corners[1] + self.corners[2]), self.apex), *rays]


def _butterfly(halves: Sequence[_Half], size: Size, order: int) -> list[Patch]:
    """The patches of one or two halves, with numbers of cells that match."""
    across = _cells([line for half in halves for line in half.across()], size)
    across += across % 2  # an even number puts a node at the apex, where it may touch
    up = _cells([line for half in halves for line in half.up()], size)
    out = _cells([line for half in halves for line in half.out()], size)
    patches = []
    for half in halves:
        inner = _ruled(*half.inner(), across, up, size, order)
        patches.append(Patch(inner, {} if half.flat is None else {(1, 0): half.flat}))
        for i, along in enumerate((up, across, up)):
            side = straight(half.corners[i], half.corners[i + 1])
            sides: dict[Side, str] = {(1, -1): half.groups[i]}
            if half.flat is not None and i != 1:
                sides[0, 0 if i == 0 else -1] = half.flat
            patches.append(Patch(_ruled(side, half.arcs[i], along, out, size, order), sides))
    return patches


def _cells(lines: Sequence[Curve], size: Size) -> int:
    """Largest number of cells of any of the lines."""
    return max(Line(line, size).cells for line in lines)


def _ruled(first: Curve, last: Curve, along: int, across: int, size: Size, order: int) -> Array:
    """Points (along * order + 1, across * order + 1, 2) of the patch of straight lines between two curves."""
    a, b = Line(first, size).divide(along, order), Line(last, size).divide(along, order)
    return np.stack([Line(straight(p, q), size).divide(across, order) for p, q in zip(a, b, strict=True)])


def _on_circle(radius: float, angle: float) -> tuple[float, float]:
    """Point of a circle about (0, 0) at an angle (degrees), exactly on the axes where it should be."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return radius * round(float(c), 15), radius * round(float(s), 15)
