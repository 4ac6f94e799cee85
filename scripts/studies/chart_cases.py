"""The cases of scripts/chart: scenes, meshes and references.

Every body is half a fiber of R = 0.5 um. All programs get the same penalties, ten times stiffness (permittivity) over
the size of a facet, so that they converge to bodies that do not penetrate and share one potential where they touch;
contact is integrated in one pass. Elements of order 2 are twice as large: about as many unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from piezomat.forms.material_library import BUILT_IN
from piezomat.scene import Scene
from scripts.studies.two_fibers import scene_of_shape
from tests.verification import references as ref

FACTOR, RANGE, AUGMENT = 10.0, 0.002, 1e-3
NORMAL, ELECTRIC = FACTOR * BUILT_IN["pvdf"].mean_stiffness, FACTOR * BUILT_IN["pvdf"].mean_permittivity


@dataclass(frozen=True)
class Curve:
    """A way to discretize, a curve of the chart; augmented: multipliers on top of the penalty."""

    method: str
    order: int
    augmented: bool

    @property
    def name(self) -> str:
        """As in the table and in the legend."""
        return f"{self.method}, order {self.order}{', augmented' if self.augmented else ''}"


CURVES = [Curve(m, o, a) for m in ("node", "point", "segment") for o in (1, 2) for a in (False, True)]


@dataclass(frozen=True)
class Case:
    """A picture: fine sizes of the meshes of order 1 (um), the far size as a multiple, and that of the reference.

    `second` is what is compared beside the force: the mean potential of the upper flat side, or the peak pressure.
    """

    name: str
    title: str
    shape: str
    sizes: tuple[float, ...]
    far: float
    finest: float
    second: str = "potential"
    material: str = "pvdf"
    approach: float = 0.05
    steps: int = 5
    best: str = "segment"  # method of the reference, which is of order 2 and augmented
    choice: Curve = Curve("point", 2, False)  # that the study recommends, drawn thick

    def reference(self) -> Scene:
        """The scene of the reference: the load in one step, as the solution does not depend on the path."""
        return replace(self, steps=1).scene(Curve(self.best, 2, True), self.finest, AUGMENT / 10)

    def scene(self, curve: Curve, size: float, augment: float = AUGMENT) -> Scene:
        """The scene of a point of a curve; size: of the elements of order 1 with as many unknowns."""
        size *= curve.order
        contact: dict[str, Any] = {"method": curve.method, "passes": 1, "normal_penalty": NORMAL / size}
        if self.material == "pvdf":
            contact |= {"electric_penalty": ELECTRIC / size, "electric_range": RANGE}
        if curve.augmented:
            contact["augment"] = augment
        return scene_of_shape(
            self.shape,
            size,
            self.far * size,
            contact,
            order=curve.order,
            material=self.material,
            approach=self.approach,
            steps=self.steps,
        )


HALVES = Case(
    "facing_halves",
    "Two half discs pressed together (2D, coupled)",
    "facing_halves",
    (0.024, 0.012, 0.006, 0.003),
    4.75,
    0.0015,
    choice=Curve("point", 1, False),
)
CROSSED = Case(
    "crossed_fibers",
    "Two crossed half cylinders pressed together (3D, coupled)",
    "crossed_fibers",
    (0.142, 0.1, 0.071, 0.05),
    4.06,
    0.025,
    best="point",
)
HERTZ = Case(
    "hertz",
    "Hertz: two elastic half discs (2D), pressure against the closed form",
    "facing_halves",
    (0.012, 0.006, 0.003, 0.0015),
    12.0,
    0.0008,
    second="pressure",
    material="elastic",
    approach=0.005,
    steps=2,
    choice=Curve("segment", 2, True),
)
CASES = {case.name: case for case in (HALVES, CROSSED, HERTZ)}


def peak_pressure(force: float) -> float:
    """Hertz's peak pressure of the half discs (MPa) under a force (uN/um)."""
    modulus = ref.contact_modulus((2500.0, 0.3), (2500.0, 0.3))
    return ref.hertz_line(force, ref.relative_radius(0.5, 0.5), modulus).peak
