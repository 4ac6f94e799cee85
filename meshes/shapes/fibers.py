"""Fibers: pairs that face or cross each other, rows and stacks, and a fiber on a block."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from piezomat.meshes.builders.centre_lines import Fiber
from piezomat.meshes.builders.extrude import Body, Frame, draw
from piezomat.meshes.builders.sections import Disc, HalfDisc, Rectangle
from piezomat.meshes.builders.sizes import MeshSizes
from piezomat.meshes.shapes.base import Shape

Positive = Annotated[float, Field(gt=0)]


class FacingHalves(Shape):
    """2D: two half discs with their arcs facing each other, touching at the origin when the gap is 0.

    Bodies `lower`, `upper`; flat faces `bottom` and `top`; arcs `lower_contact`, `upper_contact`.
    """

    shape: Literal["facing_halves"] = "facing_halves"
    radius: Positive = Field(0.5, description="radius of both (um)")
    gap: float = Field(0.0, description="distance by which the upper one is raised (um)")

    @property
    def dimension(self) -> int:
        return 2

    def bodies(self) -> tuple[str, ...]:
        return ("lower", "upper")

    def facet_groups(self) -> tuple[str, ...]:
        return ("bottom", "top", "lower_contact", "upper_contact")

    def size(self) -> float:
        return self.radius

    def build(self, sizes: MeshSizes) -> None:
        r = self.radius
        lower = HalfDisc(r, True, "bottom", "lower_contact")
        upper = HalfDisc(r, False, "top", "upper_contact")
        bodies = [
            Body("lower", lower, Frame.upright(0.0, -r), [(0.0, r)], r),
            Body("upper", upper, Frame.upright(0.0, r + self.gap), [(0.0, -r)], r),
        ]
        draw(bodies, self.facet_groups(), sizes)


class CrossedFibers(Shape):
    """3D: two crossed half (or whole) cylinders, touching at the origin when the gap is 0.

    Bodies `lower` (along x) and `upper` (turned by `angle` about z). Groups `bottom` and `top` are the flat
    faces, or of whole fibers the halves of the lateral surface away from the contact; `<body>_contact`,
    `<body>_ends`.
    """

    shape: Literal["crossed_fibers"] = "crossed_fibers"
    radius: Positive = Field(0.5, description="radius of both (um)")
    length: Positive = Field(2.0, description="length of both (um)")
    angle: float = Field(90.0, gt=0, lt=180, description="angle between the axes (degrees)")
    gap: float = Field(0.0, description="distance by which the upper one is raised (um)")
    whole: bool = Field(False, description="whole cylinders instead of halves")

    @property
    def dimension(self) -> int:
        return 3

    def bodies(self) -> tuple[str, ...]:
        return ("lower", "upper")

    def facet_groups(self) -> tuple[str, ...]:
        return ("bottom", "top", "lower_contact", "upper_contact", "lower_ends", "upper_ends")

    def size(self) -> float:
        return min(self.length, 2 * self.radius if self.whole else self.radius)

    def centre_lines(self) -> dict[str, Fiber]:
        return {body.name: body.centre_line for body in self._placed()}

    def build(self, sizes: MeshSizes) -> None:
        draw(self._placed(), self.facet_groups(), sizes)

    def _placed(self) -> list[Body]:
        r = self.radius
        bodies = []
        for name, up, far, middle, angle in (
            ("lower", True, "bottom", -r, 0.0),
            ("upper", False, "top", r + self.gap, self.angle),
        ):
            near = f"{name}_contact"
            above, below = (near, far) if up else (far, near)
            section = Disc(r, (above,) * 3 + (below,) * 3) if self.whole else HalfDisc(r, up, far, near)
            frame = Frame.upright(0.0, middle, angle)
            ends = (f"{name}_ends",) * 2
            bodies.append(Body(name, section, frame, [(0.0, r if up else -r)], r, self.length, True, ends))
        return bodies


class ParallelFibers(Shape):
    """2D discs or 3D cylinders (along x), stacked upwards or side by side; the first two touch at the origin.

    Bodies `fiber_1` and so on, from below or from the left (3D: front). Stacked, groups `bottom` and `top`
    are the outer halves of the first and last fiber. Side by side they are the lower and upper quarters of
    all of them, and `left` and `right` (3D: `front` and `back`) the outer quarters of the first and last.
    `<body>_contact` is what faces a neighbour; 3D: `<body>_ends`.
    """

    shape: Literal["parallel_fibers"] = "parallel_fibers"
    count: int = Field(2, ge=2, description="number of fibers")
    radius: Positive = Field(0.5, description="radius of all (um)")
    length: Positive | None = Field(None, description="length along x (um); absent: 2D")
    arrangement: Literal["stacked", "side_by_side"] = "stacked"
    gap: float = Field(0.0, description="distance between neighbours (um)")

    @property
    def dimension(self) -> int:
        return 2 if self.length is None else 3

    def bodies(self) -> tuple[str, ...]:
        return tuple(f"fiber_{i + 1}" for i in range(self.count))

    def facet_groups(self) -> tuple[str, ...]:
        outer = () if self.arrangement == "stacked" else self._flanks()
        each = [f"{body}_contact" for body in self.bodies()]
        if self.length is not None:
            each += [f"{body}_ends" for body in self.bodies()]
        return ("bottom", "top", *outer, *each)

    def _flanks(self) -> tuple[str, str]:
        return ("left", "right") if self.length is None else ("front", "back")

    def size(self) -> float:
        return 2 * self.radius if self.length is None else min(2 * self.radius, self.length)

    def centre_lines(self) -> dict[str, Fiber]:
        return {} if self.length is None else {body.name: body.centre_line for body in self._placed()}

    def build(self, sizes: MeshSizes) -> None:
        draw(self._placed(), self.facet_groups(), sizes)

    def _placed(self) -> list[Body]:
        r, stacked = self.radius, self.arrangement == "stacked"
        flanks = self._flanks()
        bodies = []
        for i, name in enumerate(self.bodies()):
            first, last, near = i == 0, i == self.count - 1, f"{name}_contact"
            middle = -r + i * (2 * r + self.gap)
            touches = [-r] * (not first) + [r] * (not last)
            if stacked:
                above, below = "top" if last else near, "bottom" if first else near
                section = Disc(r, (above,) * 3 + (below,) * 3)
                where, contacts = (0.0, middle), [(0.0, t) for t in touches]
            else:
                left, right = flanks[0] if first else near, flanks[1] if last else near
                section = Disc(r, (right, "top", left, left, "bottom", right))
                where, contacts = (middle, 0.0), [(s, 0.0) for s in touches]
            frame = Frame.upright(*where, None if self.length is None else 0.0)
            bodies.append(Body(name, section, frame, contacts, r, self.length, ends=(f"{name}_ends",) * 2))
        return bodies


class FiberOnBlock(Shape):
    """A half disc (3D: half cylinder along x), flat face up, resting on a block; they touch at the origin.

    Bodies `block`, `fiber`. Groups: the block's `bottom`, `left`, `right` (3D: those are its ends in x;
    `front` and `back` its sides) and its upper face `block_contact`; the fiber's flat face `top`,
    `fiber_contact`, and in 3D `fiber_ends`.
    """

    shape: Literal["fiber_on_block"] = "fiber_on_block"
    radius: Positive = Field(0.5, description="radius of the fiber (um)")
    length: Positive | None = Field(None, description="length of both along x (um); absent: 2D")
    width: Positive = Field(2.0, description="extent of the block across the fiber (um)")
    height: Positive = Field(1.0, description="extent of the block downwards (um)")
    gap: float = Field(0.0, description="distance by which the fiber is raised (um)")

    @property
    def dimension(self) -> int:
        return 2 if self.length is None else 3

    def bodies(self) -> tuple[str, ...]:
        return ("block", "fiber")

    def facet_groups(self) -> tuple[str, ...]:
        flat = ("bottom", "top", "left", "right")
        if self.length is None:
            return (*flat, "block_contact", "fiber_contact")
        return (*flat, "front", "back", "block_contact", "fiber_contact", "fiber_ends")

    def size(self) -> float:
        extents = [self.radius, self.width, self.height]
        return min(extents if self.length is None else [*extents, self.length])

    def centre_lines(self) -> dict[str, Fiber]:
        return {} if self.length is None else {"fiber": self._placed()[1].centre_line}

    def build(self, sizes: MeshSizes) -> None:
        draw(self._placed(), self.facet_groups(), sizes)

    def _placed(self) -> list[Body]:
        r, length = self.radius, self.length
        angle, sides = (None, ("left", "right")) if length is None else (0.0, ("front", "back"))
        block = Rectangle(self.width, self.height, "bottom", sides[1], "block_contact", sides[0])
        fiber = HalfDisc(r, False, "top", "fiber_contact")
        below, above = Frame.upright(0.0, 0.0, angle), Frame.upright(0.0, r + self.gap, angle)
        return [
            Body("block", block, below, [(0.0, 0.0)], r, length, ends=("left", "right")),
            Body("fiber", fiber, above, [(0.0, -r)], r, length, ends=("fiber_ends",) * 2),
        ]
