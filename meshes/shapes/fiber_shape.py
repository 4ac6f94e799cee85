"""Common part of shapes of many swept fibers: names, groups, meshing, and statistics of the result."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from piezomat.forms.arrays import Array
from piezomat.meshes.builders.centre_lines import Fiber, crossings, near_places
from piezomat.meshes.builders.sizes import PATCH, POINT, Grading, Line, MeshSizes
from piezomat.meshes.builders.sweep import Section, add, sweep
from piezomat.meshes.gmsh_io import model as gmsh_model
from piezomat.meshes.shapes.base import Shape

CONTACT_ZONE = 0.1  # gap, in radii of the thinnest fiber, up to which cells are fine as at a place of contact
CROSSING = 0.02  # gap, in the same radii, up to which fibers count as touching


class FiberShape(Shape):
    """Fibers of circular section in 3D. Groups: `surfaces` (lateral), `ends`, and ends on the faces of a box."""

    @property
    def dimension(self) -> int:
        return 3

    @cached_property
    def fibers(self) -> tuple[Fiber, ...]:
        """The fibers, from below."""
        raise NotImplementedError

    def end_groups(self) -> dict[str, tuple[int, float]]:
        """Groups of ends that lie in planes: axis and coordinate (um) of each."""
        return {}

    def bodies(self) -> tuple[str, ...]:
        return tuple(fiber.name for fiber in self.fibers)

    def centre_lines(self) -> dict[str, Fiber]:
        return {fiber.name: fiber for fiber in self.fibers} if self.dimension == 3 else {}

    def facet_groups(self) -> tuple[str, ...]:
        ends = [end for fiber in self.fibers for end in fiber.points[[0, -1]]]
        found = [name for name in self.end_groups() if any(name in self._groups_of_end(end) for end in ends)]
        return ("surfaces", "ends", *found)

    def size(self) -> float:
        return 2.0 * min(fiber.radius for fiber in self.fibers)

    def contacts(self, number: int) -> tuple[tuple[float, float], ...]:
        """Points of a fiber's section (across, up), um from its centre, where it may touch others: top and bottom."""
        radius = self.fibers[number].radius
        return ((0.0, radius), (0.0, -radius))

    def places_along(self) -> list[Array]:
        """Parameters (n,) on each centre line where the fiber is near another."""
        near = near_places(self.fibers, CONTACT_ZONE * min(fiber.radius for fiber in self.fibers))
        fiber, along = near.fibers.ravel(), near.along.ravel()
        order = np.argsort(fiber, kind="stable")
        return np.split(along[order], np.searchsorted(fiber[order], np.arange(1, len(self.fibers))))

    def outcome(self) -> Outcome:
        return Outcome.of(self.fibers, self.area)

    def build(self, sizes: MeshSizes) -> None:
        volumes: dict[str, list[int]] = {}
        facets: dict[str, list[int]] = {}
        sections: dict[tuple[Any, ...], Section] = {}
        nodes = 0
        for number, (fiber, places) in enumerate(zip(self.fibers, self.places_along(), strict=True)):
            contacts = self.contacts(number)
            key = (fiber.radius, sizes.of(fiber.name), contacts)
            if key not in sections:
                size = Grading.of(sizes, fiber.name, fiber.radius, PATCH).about(contacts)
                sections[key] = Section.disc(fiber.radius, size, sizes.order)
            swept = sweep(sections[key], fiber, _layers(sizes, fiber, places), sizes.tensor)
            volume, lateral, ends = add(swept, sizes.order, sizes.tensor, nodes + 1)
            nodes += len(swept.x)
            volumes[fiber.name] = [volume]
            facets.setdefault("surfaces", []).append(lateral)
            for entity, end in zip(ends, fiber.points[[0, -1]], strict=True):
                for group in self._groups_of_end(end):
                    facets.setdefault(group, []).append(entity)
        gmsh_model.add_groups(3, volumes)
        gmsh_model.add_groups(2, {name: facets[name] for name in self.facet_groups()})

    def _groups_of_end(self, end: Array) -> list[str]:
        close = 1e-6 * self.size()
        return ["ends", *(name for name, (k, where) in self.end_groups().items() if abs(end[k] - where) < close)]


def _layers(sizes: MeshSizes, fiber: Fiber, places: Array) -> Array:
    """Parameters (n,) of the layers of nodes along a fiber, close together at `places` of contact."""
    grading = Grading.of(sizes, fiber.name, fiber.radius, POINT)

    def size(x: Array) -> Array:
        if not len(places):
            return np.full(len(x), grading.far)
        return grading.at(cKDTree(places[:, None]).query(x)[0])

    line = Line(lambda t: fiber.length * t[:, None], size)
    return line.divide(line.cells, sizes.order)[:, 0]


@dataclass(frozen=True)
class Outcome:
    """Statistics of a shape of many fibers, printed as one line. Lengths in um.

    areal_density: volume over area seen from above, in 2D area over width. area: that seen from above, um2 (2D: the
    width). orientation: mean of cos(2 angle to x) over
    the length of the fibers: 1 all along x, 0 isotropic, -1 all along y; None in 2D. smallest_gap: None if no two
    fibers are near each other. low, high: corners of the box around the fibers.
    """

    fibers: int
    crossings: int
    porosity: float
    areal_density: float
    area: float
    orientation: float | None
    smallest_gap: float | None
    low: tuple[float, ...]
    high: tuple[float, ...]

    @classmethod
    def of(cls, fibers: tuple[Fiber, ...], area: float | None) -> Outcome:
        """Statistics of fibers in 3D, in a box of this `area` seen from above (None: that of the box around them)."""
        thinnest = min(fiber.radius for fiber in fibers)
        found = crossings(fibers, CONTACT_ZONE * thinnest)
        extents = np.array([_extent(fiber) for fiber in fibers])
        low, high = extents[:, 0].min(axis=0), extents[:, 1].max(axis=0)
        seen = area if area is not None else float(np.prod((high - low)[:2]))
        volume = sum(fiber.volume for fiber in fibers)
        steps = np.concatenate([np.diff(fiber.samples()[1], axis=0) for fiber in fibers])
        length, flat = np.linalg.norm(steps, axis=1), np.maximum((steps[:, :2] ** 2).sum(axis=1), 1e-300)
        turned = (steps[:, 0] ** 2 - steps[:, 1] ** 2) / flat
        return cls(
            len(fibers),
            int((found.gap <= CROSSING * thinnest).sum()),
            1.0 - volume / (seen * float(high[2] - low[2])),
            volume / seen,
            seen,
            float(length @ turned / length.sum()),
            float(found.gap.min()) if len(found.gap) else None,
            tuple(low.tolist()),
            tuple(high.tolist()),
        )

    def __str__(self) -> str:
        gap = "none near another" if self.smallest_gap is None else f"smallest gap {self.smallest_gap:.3g} um"
        if self.smallest_gap is not None and abs(self.smallest_gap) < 1e-9:
            gap = "smallest gap 0 um"
        turned = "" if self.orientation is None else f", orientation {self.orientation:.3f} along x"
        box = " x ".join(f"{a:.4g} .. {b:.4g}" for a, b in zip(self.low, self.high, strict=True))
        return (
            f"{self.fibers} fibers, {self.crossings} crossings, porosity {self.porosity:.3f}, "
            f"areal density {self.areal_density:.4g} um{turned}, {gap}, box {box} um"
        )


def _extent(fiber: Fiber) -> Array:
    """Least and largest coordinates (2, 3) of a fiber, or a little beyond.

    A disc normal to a direction of cosine c to an axis extends sqrt(1 - c^2) radii along that axis.
    """
    x = fiber.samples()[1]
    steps = np.diff(x, axis=0)
    cosine = np.abs(steps) / np.linalg.norm(steps, axis=1, keepdims=True)
    reach = fiber.radius * np.sqrt(np.maximum(1.0 - cosine**2, 0.0)).max(axis=0)
    extent = np.stack([x.min(axis=0) - reach, x.max(axis=0) + reach])
    for end, face in enumerate(fiber.faces):
        if face is not None:
            center, *axes = fiber.cap(end)
            across = np.linalg.norm(axes, axis=0)
            extent = np.stack([np.minimum(extent[0], center - across), np.maximum(extent[1], center + across)])
            extent[:, face.axis] = np.clip(extent[:, face.axis], *sorted((face.where, -face.outside * np.inf)))
    return extent
