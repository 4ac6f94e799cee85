"""Cross plies, random mats (the same for the same seed), and fibers listed in a table."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from piezomat.forms.arrays import Array
from piezomat.meshes.builders.centre_lines import Face, Fiber
from piezomat.meshes.gmsh_io.model import MeshError
from piezomat.meshes.names import breaking_character
from piezomat.meshes.shapes.deposition import Bed, Faces, lay_all
from piezomat.meshes.shapes.fiber_shape import FiberShape

Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]
Seed = Annotated[int, Field(ge=0)]

SHORTEST = 4.0  # a fiber that the box cuts shorter than this many radii is left out
COLUMNS = ("fiber", "x", "y", "z", "radius")


def _not_too_bent(bend_radius: float | None, others: ValidationInfo) -> float | None:
    if bend_radius is not None and "radius" in others.data and bend_radius < 2.0 * others.data["radius"]:
        raise ValueError("at least twice the radius of the fibers")
    return bend_radius


class CrossPly(FiberShape):
    """3D: plies of parallel straight fibers, each ply at its angle, laid on each other from z = 0 up.

    The box goes from (0, 0) to (width, depth); every fiber crosses it and ends flush with its faces (see `Mat`).
    Bodies `ply_1_fiber_1` and so on.
    """

    shape: Literal["cross_ply"] = "cross_ply"
    radius: Positive = Field(0.5, description="radius of all (um)")
    angles: list[float] = Field([0.0, 90.0], min_length=1, description="of the plies from below, from x to y (degrees)")
    spacing: Positive = Field(2.0, description="distance between the axes in a ply (um)")
    width: Positive = Field(10.0, description="extent of the box in x (um)")
    depth: Positive = Field(10.0, description="extent of the box in y (um)")
    gap: float = Field(0.0, description="distance between fibers that rest on each other (um)")
    bend_radius: Positive | None = Field(None, description="fibers bend over those below, about this much at most (um)")

    @field_validator("spacing")
    @classmethod
    def _apart(cls, spacing: float, others: ValidationInfo) -> float:
        if "radius" in others.data and spacing < 2.0 * others.data["radius"]:
            raise ValueError("at least two radii, or fibers of a ply overlap")
        return spacing

    _bending = field_validator("bend_radius")(_not_too_bent)

    @cached_property
    def fibers(self) -> tuple[Fiber, ...]:
        plans = []
        middle, half = np.array([self.width, self.depth]) / 2.0, np.hypot(self.width, self.depth) / 2.0
        for ply, angle in enumerate(self.angles, start=1):
            along = _direction(np.radians(angle))
            across = np.array([-along[1], along[0]])
            rows = int(half / self.spacing) + 1
            number = 0
            for row in np.arange(-rows, rows) + 0.5:
                line = _straight(middle + row * self.spacing * across, along, 2.0 * half)
                plan = _cut(line, self.width, self.depth)
                if plan is not None and _length(plan) >= SHORTEST * self.radius:
                    number += 1
                    faces = _faces_that_cut(plan, self.width, self.depth)
                    plans.append((f"ply_{ply}_fiber_{number}", plan, self.radius, faces))
        if not plans:
            raise MeshError(f"no fiber of {SHORTEST:g} radii or more fits into the box")
        return tuple(lay_all(plans, self.bend_radius, self.gap))

    @property
    def area(self) -> float:
        return self.width * self.depth

    def end_groups(self) -> dict[str, tuple[int, float]]:
        return _box_faces(self.width, self.depth)


class Mat(FiberShape):
    """3D: fibers laid on each other at random, from z = 0 up, in a box from (0, 0) to (width, depth).

    Fibers come to rest where they first touch; with `bend_radius` they bend over those below. Without `length` they
    cross the box and end flush with its faces. Their ends are square where they graze a face, bend closely there or are
    too short for valid cells (`Fiber.flush`). Bodies `fiber_1` and so on, from below.
    """

    shape: Literal["mat"] = "mat"
    radius: Positive = Field(0.5, description="mean radius (um)")
    radius_spread: float = Field(0.0, ge=0, le=0.5, description="standard deviation of the radius over its mean")
    width: Positive = Field(10.0, description="extent of the box in x (um)")
    depth: Positive = Field(10.0, description="extent of the box in y (um)")

    @field_validator("width", "depth")
    @classmethod
    def _wide(cls, extent: float, others: ValidationInfo) -> float:
        if "radius" in others.data and extent < 2.0 * SHORTEST * others.data["radius"]:
            raise ValueError(f"at least {2 * SHORTEST:g} radii")
        return extent

    count: Count | None = Field(None, description="number of fibers; default 20 without the next two")
    areal_density: Positive | None = Field(None, description="volume of the fibers over the area of the box (um)")
    thickness: Positive | None = Field(None, description="height that the mat reaches (um)")
    alignment: float = Field(0.0, ge=0, le=1, description="0: any direction; 1: all along x; angles are uniform")
    length: Positive | None = Field(None, description="of fibers that end inside the box (um); absent: they cross it")
    wave_length: Positive | None = Field(None, description="of sine waves across the fiber, seen from above (um)")
    wave_amplitude: float = Field(0.0, ge=0, description="of those waves (um)")
    bend_radius: Positive | None = Field(None, description="fibers bend over those below, about this much at most (um)")
    gap: float = Field(0.0, description="distance between fibers that rest on each other (um)")
    seed: Seed = Field(0, description="the same seed lays the same mat")

    @field_validator("thickness")
    @classmethod
    def _one_measure(cls, thickness: float | None, others: ValidationInfo) -> float | None:
        given = [others.data.get("count"), others.data.get("areal_density"), thickness]
        if sum(value is not None for value in given) > 1:
            raise ValueError("count, areal_density and thickness exclude each other")
        return thickness

    @field_validator("length")
    @classmethod
    def _inside(cls, length: float | None, others: ValidationInfo) -> float | None:
        known = others.data
        if length is not None and {"width", "depth", "radius"} <= known.keys():
            longest = min(known["width"], known["depth"])
            if not SHORTEST * known["radius"] <= length <= longest:
                raise ValueError(f"between {SHORTEST:g} radii and {longest:g}, the lesser side of the box")
        return length

    @field_validator("wave_amplitude")
    @classmethod
    def _not_too_wavy(cls, amplitude: float, others: ValidationInfo) -> float:
        wave_length, radius = others.data.get("wave_length"), others.data.get("radius")
        if amplitude > 0.0 and "wave_length" in others.data and wave_length is None:
            raise ValueError("0 without wave_length")
        if wave_length and radius:
            most = (wave_length / (2.0 * np.pi)) ** 2 / (2.0 * radius)
            if amplitude > most:
                raise ValueError(f"at most {most:.4g}: waves bend a fiber to no less than twice its radius")
        return amplitude

    _bending = field_validator("bend_radius")(_not_too_bent)

    @cached_property
    def fibers(self) -> tuple[Fiber, ...]:
        bed, volume = Bed(self.bend_radius, self.gap), 0.0
        count = self.count or (20 if self.areal_density is None and self.thickness is None else None)
        for number, (plan, radius) in enumerate(self._drawn(), start=1):
            faces = _faces_that_cut(plan, self.width, self.depth)
            volume += bed.lay(f"fiber_{number}", plan, radius, faces).volume
            enough = number == count
            enough |= self.areal_density is not None and volume >= self.areal_density * self.area
            enough |= self.thickness is not None and bed.top >= self.thickness
            if enough:
                return tuple(bed.fibers)
        raise AssertionError("fibers are drawn without end")

    def _drawn(self) -> Iterator[tuple[Array, float]]:
        """Endless random sequence of fibers seen from above, with their radii."""
        random = np.random.default_rng(self.seed)
        spread = np.sqrt(np.log1p(self.radius_spread**2))
        while True:
            radius = float(self.radius * np.exp(spread * random.standard_normal() - 0.5 * spread**2))
            angle = 0.5 * np.pi * (1.0 - self.alignment) * random.uniform(-1.0, 1.0)
            middle = random.uniform(0.0, 1.0, 2) * (self.width, self.depth)
            phase = random.uniform(0.0, 2.0 * np.pi)
            reach = np.hypot(self.width, self.depth) if self.length is None else self.length
            line = self._waving(_straight(middle, _direction(angle), 2.0 * reach), phase)
            if self.length is not None:
                line = self._shortened(line)
            plan = _cut(line, self.width, self.depth)
            if plan is None or _length(plan) < SHORTEST * radius:
                continue
            if self.length is None or _length(plan) > 0.999 * self.length:
                yield plan, radius

    def _waving(self, line: Array, phase: float) -> Array:
        """A straight line as a sine wave about it, as points half a radius apart."""
        if self.wave_length is None:
            return line
        long = _length(line)
        s = np.linspace(-0.5, 0.5, int(np.ceil(2.0 * long / self.radius)) + 1) * long
        along = (line[1] - line[0]) / long
        wave = self.wave_amplitude * np.sin(2.0 * np.pi * s / self.wave_length + phase)
        return line.mean(axis=0) + s[:, None] * along + wave[:, None] * np.array([-along[1], along[0]])

    def _shortened(self, line: Array) -> Array:
        """Middle part of a line, of the given `length`."""
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        ends = 0.5 * s[-1] + 0.5 * self.length * np.array([-1.0, 1.0])
        inside = s[(s > ends[0]) & (s < ends[1])]
        s_new = np.concatenate([ends[:1], inside, ends[1:]])
        return np.stack([np.interp(s_new, s, line[:, k]) for k in (0, 1)], axis=1)

    @property
    def area(self) -> float:
        return self.width * self.depth

    def end_groups(self) -> dict[str, tuple[int, float]]:
        return _box_faces(self.width, self.depth)


class Fibers(FiberShape):
    """3D: fibers from a table with the columns fiber, x, y, z and radius (um).

    Each row is a point of a centre line, a smooth curve through the rows of one `fiber`, which names the body.
    """

    shape: Literal["fibers"] = "fibers"
    file: Path = Field(description="path of the table (CSV); relative to the scene file")

    @cached_property
    def fibers(self) -> tuple[Fiber, ...]:
        try:
            with self.file.open(newline="", encoding="utf-8-sig") as file:  # Excel writes a byte-order mark
                rows = list(csv.DictReader(file, skipinitialspace=True))
        except (OSError, ValueError, csv.Error) as error:
            raise MeshError(f"{self.file}: {getattr(error, 'strerror', None) or error}", "geometry.file") from None
        points: dict[str, list[list[float]]] = {}
        for line, row in enumerate(rows, start=2):
            try:
                numbers = [float(row[name]) for name in COLUMNS[1:]]
                if not np.isfinite(numbers).all() or numbers[3] <= 0.0 or not row["fiber"]:
                    raise ValueError
            except (KeyError, TypeError, ValueError):
                raise self._wrong(f"line {line} is not a name, three coordinates and a radius > 0") from None
            if broken := breaking_character(row["fiber"]):
                raise self._wrong(f"the name in line {line} holds {broken}, which breaks or turns lines")
            points.setdefault(row["fiber"], []).append(numbers)
        if not points:
            raise self._wrong("it lists no fibers")
        return tuple(self._fiber(name, np.array(rows)) for name, rows in points.items())

    def _fiber(self, name: str, rows: Array) -> Fiber:
        if len(rows) < 2 or (np.linalg.norm(np.diff(rows[:, :3], axis=0), axis=1) <= 0.0).any():
            raise self._wrong(f"fiber {name!r} needs at least two points, and no point twice in a row")
        if np.ptp(rows[:, 3]) > 0.0:
            raise self._wrong(f"fiber {name!r} has more than one radius")
        return Fiber(name, rows[:, :3], float(rows[0, 3]))

    def _wrong(self, what: str) -> MeshError:
        return MeshError(f"{self.file}: {what} (columns: {', '.join(COLUMNS)})", "geometry.file")


def _direction(angle: float) -> Array:
    return np.array([np.cos(angle), np.sin(angle)])


def _straight(middle: Array, along: Array, length: float) -> Array:
    return np.stack([middle - 0.5 * length * along, middle + 0.5 * length * along])


def _length(plan: Array) -> float:
    return float(np.linalg.norm(np.diff(plan, axis=0), axis=1).sum())


def _cut(line: Array, width: float, depth: float) -> Array | None:
    """The longest stretch of a line of points (n, 2) inside the box; None where there is none."""
    sides = np.array([width, depth])
    stretches: list[list[Array]] = [[]]
    for a, b in pairwise(line):
        with np.errstate(divide="ignore", invalid="ignore"):
            enter, leave = np.sort(np.stack([-a / (b - a), (sides - a) / (b - a)]), axis=0)
        still = b == a
        # A line along the rim of the box is not inside.
        enter[still] = np.where((a > 1e-9 * sides) & (a < (1.0 - 1e-9) * sides), -np.inf, np.inf)[still]
        leave[still] = np.inf
        first, last = max(0.0, enter.max()), min(1.0, leave.min())
        if first >= last:
            continue
        start, end = a + first * (b - a), a + last * (b - a)
        if first > 0.0 or not stretches[-1]:
            stretches.append([start])
        stretches[-1].append(end)
    whole = [np.array(stretch) for stretch in stretches if len(stretch) > 1]
    return max(whole, key=_length) if whole else None


def _faces_that_cut(plan: Array, width: float, depth: float) -> Faces:
    """Faces of the box that contain the ends of a line (n, 2); at an edge of the box the face that the line crosses."""
    found: list[Face | None] = []
    for end, inner in ((plan[0], plan[1]), (plan[-1], plan[-2])):
        outward = end - inner
        faces = [Face(axis, where, 1 if where else -1) for axis, where in _box_faces(width, depth).values()]
        here = [f for f in faces if abs(end[f.axis] - f.where) <= 1e-9 * max(width, depth)]
        found.append(max(here, key=lambda f: f.outside * outward[f.axis], default=None))
    return found[0], found[1]


def _box_faces(width: float, depth: float) -> dict[str, tuple[int, float]]:
    return {"left": (0, 0.0), "right": (0, width), "front": (1, 0.0), "back": (1, depth)}
