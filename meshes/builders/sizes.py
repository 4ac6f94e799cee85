"""Cell sizes: fine where bodies meet, growing linearly with the distance to a far size."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import gmsh
import numpy as np

from piezomat.forms.arrays import Array

Point = tuple[float, float, float]
# Positions (n, d) of parameters (n,) in [0, 1]; cell sizes (...,) at positions (..., d).
Curve = Callable[[Array], Array]
Size = Callable[[Array], Array]

# Distances from the place of contact, in radii, up to which cells have the contact size and from which they have the
# far size. The stress under a point of contact in 3D spreads further than that under a line.
LINE = (0.4, 1.1)
POINT = (0.56, 1.55)
# The zone is narrower for patches, because their rows continue fine cells beyond it.
PATCH = (0.25, 0.9)


@dataclass(frozen=True)
class MeshSizes:
    """Cell sizes (um), order and kind of cells of a mesh; `factors` multiply the sizes of a body."""

    size: float
    contact_size: float
    order: Literal[1, 2] = 1
    cells: Literal["simplex", "tensor"] = "simplex"
    factors: Mapping[str, float] = field(default_factory=dict)

    @property
    def tensor(self) -> bool:
        """Whether cells are quadrilaterals or bricks."""
        return self.cells == "tensor"

    def in_units_of(self, unit: float) -> MeshSizes:
        """The same in another unit of length, um."""
        return replace(self, size=self.size / unit, contact_size=self.contact_size / unit)

    def of(self, body: str) -> tuple[float, float]:
        """Contact size and far size of a body (um)."""
        factor = self.factors.get(body, 1.0)
        return factor * min(self.contact_size, self.size), factor * self.size


@dataclass(frozen=True)
class Grading:
    """Cell sizes (um) of a body: `fine` up to the distance near[0] from places of contact, `far` from near[1] on."""

    fine: float
    far: float
    near: tuple[float, float]

    @classmethod
    def of(cls, sizes: MeshSizes, body: str, radius: float, zone: tuple[float, float]) -> Grading:
        """Grading of a body about contact of fibers with this radius."""
        return cls(*sizes.of(body), (zone[0] * radius, zone[1] * radius))

    def at(self, distance: Array) -> Array:
        """Cell size at distances from the nearest place of contact."""
        return np.interp(distance, self.near, (self.fine, self.far))

    def about(self, points: Sequence[tuple[float, float]]) -> Size:
        """Cell size in a plane as a function of positions (..., 2)."""
        places = np.asarray(points, float)

        def size(x: Array) -> Array:
            return self.at(np.linalg.norm(x[..., None, :] - places, axis=-1).min(axis=-1))

        return size

    def field(self, entity: tuple[int, int], points: Sequence[Point], axis: Point | None) -> int:
        """Number of a gmsh field of this size in an entity (dim, tag), about points or lines through them."""
        fields = gmsh.model.mesh.field
        graded = []
        for point in points:
            distance, size = fields.add("MathEval"), fields.add("Threshold")
            fields.setString(distance, "F", _distance(point, axis))
            fields.setNumber(size, "InField", distance)
            options = {
                "SizeMin": self.fine,
                "SizeMax": self.far,
                "DistMin": self.near[0],
                "DistMax": self.near[1],
            }
            for option, value in options.items():
                fields.setNumber(size, option, value)
            graded.append(size)
        nearest, only = fields.add("Min"), fields.add("Restrict")
        fields.setNumbers(nearest, "FieldsList", graded)
        fields.setNumber(only, "InField", nearest)
        fields.setNumbers(only, "VolumesList" if entity[0] == 3 else "SurfacesList", [entity[1]])
        return only


def _distance(point: Point, axis: Point | None) -> str:
    """Distance to a point, or to the line through it along a unit vector, in gmsh's syntax."""
    offset = [f"({c}-({p!r}))" for c, p in zip("xyz", point, strict=True)]
    square = "+".join(f"{o}^2" for o in offset)
    if axis is not None:
        along = "+".join(f"{o}*({a!r})" for o, a in zip(offset, axis, strict=True))
        square = f"Fabs({square}-({along})^2)"
    return f"Sqrt({square})"


def use_fields(fields_of_bodies: Sequence[int]) -> None:
    """Make the least of these fields the only cell size of the current gmsh model."""
    fields = gmsh.model.mesh.field
    background = fields.add("Min")
    fields.setNumbers(background, "FieldsList", list(fields_of_bodies))
    fields.setAsBackgroundMesh(background)
    for option in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
        gmsh.option.setNumber(f"Mesh.MeshSize{option}", 0)


def cells_in(length: float, size: float) -> int:
    """Number of equal cells no longer than `size`."""
    return max(1, int(np.ceil(length / size - 1e-9)))


class Line:
    """Curve that is divided in proportion to a cell size."""

    def __init__(self, curve: Curve, size: Size) -> None:
        self.curve = curve
        self.t = np.linspace(0.0, 1.0, 801)
        x = curve(self.t)
        step = np.linalg.norm(np.diff(x, axis=0), axis=1) / size(0.5 * (x[1:] + x[:-1]))
        self.number = np.concatenate([[0.0], np.cumsum(step)])

    @property
    def cells(self) -> int:
        """Number of cells that the size gives."""
        return max(1, int(np.ceil(self.number[-1] - 1e-6)))

    def divide(self, cells: int, order: int) -> Array:
        """Positions (cells * order + 1, d) of nodes; nodes between corners lie halfway in the parameter."""
        ends = np.interp(np.linspace(0.0, self.number[-1], cells + 1), self.number, self.t)
        ends[0], ends[-1] = 0.0, 1.0
        return self.curve(np.interp(np.arange(cells * order + 1) / order, np.arange(cells + 1), ends))


def straight(a: Array, b: Array) -> Curve:
    """The straight line from a to b."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    return lambda t: (1 - t)[:, None] * a + t[:, None] * b


def arc(radius: float, first: float, last: float) -> Curve:
    """The arc about (0, 0) from one angle to another (degrees)."""
    angle = np.radians([first, last])

    def curve(t: Array) -> Array:
        a = (1 - t) * angle[0] + t * angle[1]
        return radius * np.stack([np.cos(a), np.sin(a)], axis=1)

    return curve
