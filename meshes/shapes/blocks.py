"""Blocks of regular cells: stacks of blocks that share no nodes, and a cantilever of bonded layers."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from piezomat.forms.arrays import Array
from piezomat.meshes.builders.sizes import MeshSizes, cells_in
from piezomat.meshes.builders.structured import BodyPatch, Lattice, PatchMesh, Side
from piezomat.meshes.shapes.base import Shape

Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]
SIDES: dict[int, dict[str, Side]] = {
    2: {"left": (0, 0), "right": (0, -1), "bottom": (1, 0), "top": (1, -1)},
    3: {"left": (0, 0), "right": (0, -1), "front": (1, 0), "back": (1, -1), "bottom": (2, 0), "top": (2, -1)},
}


class StackedBlocks(Shape):
    """2D or 3D: blocks on each other, from the origin to x = width (y = depth) and upwards.

    Bodies `lower` and `upper`, or of more blocks `block_1` and so on, from below. Groups: sides of the stack
    (`bottom`, `top`, `left`, `right`, in 3D `front`, `back`), sides of each block (`<body>_left`, ...), and
    `<body>_contact`, all its faces towards another block.
    """

    shape: Literal["stacked_blocks"] = "stacked_blocks"
    width: Positive = Field(1.0, description="extent in x (um)")
    height: list[Positive] = Field([0.5, 0.5], min_length=2, description="heights of the blocks from below (um)")
    depth: Positive | None = Field(None, description="extent in y (um); absent: 2D")
    divisions: list[list[Count]] | None = Field(
        None, description="cells of each block along x, (y,) and upwards; absent: cells of mesh.size"
    )
    distortion: float = Field(0.0, ge=0, le=0.2, description="inner nodes move by up to this times the cell size")
    gap: float = Field(0.0, description="distance between neighbours (um)")
    tilt: float = Field(0.0, description="turns the whole stack about the origin, x towards up (degrees)")

    @field_validator("divisions")
    @classmethod
    def _fit(cls, rows: list[list[int]] | None, others: ValidationInfo) -> list[list[int]] | None:
        if rows is not None and {"height", "depth"} <= others.data.keys():
            blocks, dim = len(others.data["height"]), 2 if others.data["depth"] is None else 3
            if len(rows) != blocks or any(len(row) != dim for row in rows):
                raise ValueError(f"{blocks} rows of {dim} numbers are needed, one row a block")
        return rows

    @property
    def dimension(self) -> int:
        return 2 if self.depth is None else 3

    def bodies(self) -> tuple[str, ...]:
        if len(self.height) == 2:
            return ("lower", "upper")
        return tuple(f"block_{i + 1}" for i in range(len(self.height)))

    def facet_groups(self) -> tuple[str, ...]:
        sides = SIDES[self.dimension]
        each = [f"{body}_{side}" for body in self.bodies() for side in sides]
        return (*sides, *(f"{body}_contact" for body in self.bodies()), *each)

    @property
    def area(self) -> float | None:
        return None if self.tilt else self.width * (self.depth or 1.0)

    def size(self) -> float:
        return min([*self.height, self.width] + ([] if self.depth is None else [self.depth]))

    def build(self, sizes: MeshSizes) -> None:
        dim, last = self.dimension, len(self.height) - 1
        mesh = PatchMesh(dim)
        base = 0.0
        for i, (body, height) in enumerate(zip(self.bodies(), self.height, strict=True)):
            extent = [self.width, height] if self.depth is None else [self.width, self.depth, height]
            far = sizes.of(body)[1]
            number = [cells_in(e, far) for e in extent] if self.divisions is None else self.divisions[i]
            axes = [np.linspace(0.0, e, n + 1) for e, n in zip(extent, number, strict=True)]
            axes[-1] += base
            lattice = Lattice.box(axes, sizes.order, sizes.tensor)
            lattice.distort(self.distortion, seed=i)
            lattice.move(lambda points: _tilted(points, self.tilt))
            sides = {}
            for name, side in SIDES[dim].items():
                meets = (name == "bottom" and i > 0) or (name == "top" and i < last)
                sides[side] = [f"{body}_{name}", f"{body}_contact" if meets else name]
            mesh.add(BodyPatch(body, lattice, sides))
            base += height + self.gap
        mesh.finish(self.facet_groups())


def _tilted(points: Array, angle: float) -> Array:
    """Points turned about the origin by an angle (degrees), x towards up."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    x, up = points[..., 0], points[..., -1]
    turned = points.copy()
    turned[..., 0], turned[..., -1] = c * x - s * up, s * x + c * up
    return turned


class Cantilever(Shape):
    """2D or 3D: a beam along x from the origin, of layers that share nodes, stacked upwards.

    Bodies `layer_1` and so on from below. Groups `root` (x = 0), `tip`, `bottom`, `top`, in 3D `front` and
    `back`, and `interface_1` (between layers 1 and 2) and so on.
    """

    shape: Literal["cantilever"] = "cantilever"
    length: Positive = Field(100.0, description="extent in x (um)")
    layers: list[Positive] = Field([0.5, 0.5], min_length=1, description="thicknesses from below (um)")
    width: Positive | None = Field(None, description="extent in y (um); absent: 2D")
    divisions: list[Count] | None = Field(
        None, description="cells along, up each layer (and across); absent: cells of mesh.size"
    )

    @field_validator("divisions")
    @classmethod
    def _fit(cls, numbers: list[int] | None, others: ValidationInfo) -> list[int] | None:
        if numbers is not None and "width" in others.data:
            dim = 2 if others.data["width"] is None else 3
            if len(numbers) != dim:
                raise ValueError(f"{dim} numbers are needed")
        return numbers

    @property
    def dimension(self) -> int:
        return 2 if self.width is None else 3

    def bodies(self) -> tuple[str, ...]:
        return tuple(f"layer_{i + 1}" for i in range(len(self.layers)))

    def facet_groups(self) -> tuple[str, ...]:
        sides = ("root", "tip", "bottom", "top") + (() if self.width is None else ("front", "back"))
        return (*sides, *(f"interface_{i}" for i in range(1, len(self.layers))))

    @property
    def area(self) -> float:
        return self.length * (self.width or 1.0)

    def size(self) -> float:
        return min([self.length, *self.layers] + ([] if self.width is None else [self.width]))

    def build(self, sizes: MeshSizes) -> None:
        given, far = self.divisions, min(sizes.of(body)[1] for body in self.bodies())
        extents = [self.length] if self.width is None else [self.length, self.width]
        counts = [given[0], *given[2:]] if given else [cells_in(extent, far) for extent in extents]
        plane = [np.linspace(0.0, extent, n + 1) for extent, n in zip(extents, counts, strict=True)]
        names = {"left": "root", "right": "tip"}
        patches, base = [], 0.0
        for i, (body, thickness) in enumerate(zip(self.bodies(), self.layers, strict=True)):
            top = base + thickness
            up = np.linspace(base, top, 1 + (given[1] if given else cells_in(thickness, far)))
            sides = {side: [names.get(name, name)] for name, side in SIDES[self.dimension].items()}
            if i > 0:
                sides[SIDES[self.dimension]["bottom"]] = [f"interface_{i}"]
            if i < len(self.layers) - 1:
                del sides[SIDES[self.dimension]["top"]]
            patches.append(BodyPatch(body, Lattice.box([*plane, up], sizes.order, sizes.tensor), sides))
            base = top
        mesh = PatchMesh(self.dimension)
        mesh.add(*patches)
        mesh.finish(self.facet_groups())
