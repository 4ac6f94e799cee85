"""Small scenes that several tests of the whole program share, and the meshes that no built-in shape gives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gmsh
import numpy as np

from piezomat.scene import Scene
from piezomat.simulation import Run


def press(geometry: dict[str, Any], **sections: Any) -> Scene:
    """A scene of these sections, without pictures; one step unless `load` says otherwise."""
    return Scene(**{"geometry": geometry, "output": {"fields": "none", "picture": False}, **sections})


def pressed(dimension: int, **changes: Any) -> Scene:
    """Two half fibers, the upper one without an electrode, pressed together in two steps; without a medium."""
    sideways = [0.0] * (dimension - 1)
    keys = {
        "geometry": {"shape": "facing_halves" if dimension == 2 else "crossed_fibers"},
        "mesh": {"size": 0.3, "contact_size": 0.1},
        "bodies": {"lower": "pvdf", "upper": "pvdf"},
        "boundaries": [
            {"on": "bottom", "displacement": [*sideways, 0], "potential": 0},
            {"on": "top", "displacement": [*sideways, -0.04], "follows": "press"},
        ],
        "load": {"steps": [2], "factors": {"press": [1.0]}},
        "solver": {"tolerance": 1e-11},
    }
    return Scene(**{**keys, **changes, "contact": {"medium": "none", **changes.get("contact", {})}})


def blocks(**changes: Any) -> Scene:
    """Two blocks of 1 x 0.5 um on each other, the upper one guided sideways."""
    keys: dict[str, Any] = {
        "geometry": {"shape": "stacked_blocks", "height": [0.5, 0.5], "divisions": [[3, 3], [4, 4]]},
        "materials": {"soft": {"young": 1000.0, "poisson": 0.3}},
        "bodies": {"lower": "soft", "upper": "soft"},
        "boundaries": [
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": [0, "free"], "traction": [0, -1.0]},
        ],
        "contact": {},
    }
    return Scene(**{**keys, **changes})


def facing_halves(penalty: float, steps: int = 5, **contact: Any) -> Scene:
    """The half discs of the issue on stiff contact: 15,000 unknowns, pressed by 0.05 um."""
    return Scene(
        geometry={"shape": "facing_halves"},
        mesh={"size": 0.038, "contact_size": 0.008, "size_factors": {"upper": 0.9}},
        bodies={"lower": "pvdf", "upper": "pvdf"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0], "potential": 0},
            {"on": "top", "displacement": [0, -0.05], "follows": "press"},
        ],
        contact={"normal_penalty": penalty, "electric_penalty": 0.1, **contact},
        load={"steps": [steps], "factors": {"press": [1.0]}},
    )


def strongly_coupled(voltage: float, size: float = 0.02, **contact: Any) -> Scene:
    """Half discs of PZT-5H between electrodes that a traction presses together: nothing but contact holds the upper.

    Without a medium, unless `contact` names one.
    """
    return Scene(
        geometry={"shape": "facing_halves"},
        mesh={"size": 0.12, "contact_size": size, "size_factors": {"upper": 0.9}},
        bodies={"lower": "pzt5h", "upper": "pzt5h"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0], "potential": 0},
            {
                "on": "top",
                "displacement": [0, "free"],
                "traction": [0, -40],
                "potential": voltage,
                "follows": "press",
            },
        ],
        contact={"medium": "none", **contact},
        load={"steps": [4], "factors": {"press": [1]}},
        output={"fields": "none", "picture": False},
    )


def along(value: float, dimension: int) -> list[Any]:
    """A displacement that prescribes the last component alone."""
    return [*["free"] * (dimension - 1), value]


def rollers(fixed: dict[str, int], dimension: int) -> list[dict[str, Any]]:
    """Rows that hold one component (number) of the displacement on each of some groups."""
    return [{"on": on, "displacement": [0 if i == k else "free" for i in range(dimension)]} for on, k in fixed.items()]


class Points:
    """Pressure, weight and position of all contact points that met a facet, at the end of a serial run."""

    def __init__(self, finished: Run) -> None:
        pressure, weight, place = [], [], []
        for p in finished.contact.surface_pairs:
            shape = p.slave.kind.shape(p.projection.xi)
            place.append(np.einsum("mk,mkd->md", shape, p.projection.nodes))
            pressure.append(np.maximum(-p.response.traction, 0.0))
            weight.append(p.share * p.points.weight[p.projected_points])
        self.pressure, self.weight = np.concatenate(pressure), np.concatenate(weight)
        self.place = np.concatenate(place)

    @property
    def force(self) -> float:
        """Integral of the pressure, uN (2D: uN/um)."""
        return float(self.weight @ self.pressure)

    def spread(self, axes: Sequence[int]) -> float:
        """Mean square distance from the origin, weighted with the pressure, um2."""
        square = (self.place[:, list(axes)] ** 2).sum(axis=1)
        return float(self.weight @ (self.pressure * square)) / self.force


def quarter_of_crossed_fibers(path: Path, *, size: float, radius: float, near: float, growth: float) -> None:
    """A quarter (x > 0, y > 0) of two crossed half cylinders that touch at the origin, tetrahedra of order 2.

    Cells of `size` within `near` of the origin, then growing with the distance. Groups: bodies lower (along x)
    and upper (along y); bottom, top, x_cut, y_cut, lower_contact, upper_contact, lower_ends, upper_ends.
    """

    def build() -> None:
        occ = gmsh.model.occ
        facets: dict[str, list[int]] = {}
        for body, s, axis in (("lower", -1.0, (radius, 0.0)), ("upper", 1.0, (0.0, radius))):
            whole = occ.addCylinder(0.0, 0.0, s * radius, *axis, 0.0, radius)
            box = occ.addBox(0.0, 0.0, min(0.0, s * radius), radius, radius, radius)
            volume = occ.intersect([(3, whole)], [(3, box)])[0][0][1]
            occ.synchronize()
            gmsh.model.addPhysicalGroup(3, [volume], name=body)
            for _, face in gmsh.model.getBoundary([(3, volume)], oriented=False):
                box_of_face = np.reshape(gmsh.model.getBoundingBox(2, face), (2, 3))
                flat = np.flatnonzero(np.ptp(box_of_face, axis=0) < 1e-5 * radius)
                name = f"{body}_contact"
                if len(flat):
                    at_origin = abs(box_of_face[0, flat[0]]) < 1e-5 * radius
                    cuts = ("x_cut", "y_cut") if at_origin else (f"{body}_ends",) * 2
                    name = (*cuts, "bottom" if s < 0 else "top")[flat[0]]
                facets.setdefault(name, []).append(face)
        for name, faces in facets.items():
            gmsh.model.addPhysicalGroup(2, faces, name=name)
        _mesh(3, f"Min({0.4 * radius}, {size}+{growth}*Max(0,Sqrt(x^2+y^2+z^2)-{near}))", order=2)

    _write(path, build)


def half_of_facing_halves(path: Path, *, size: float, radius: float, near: float, growth: float) -> None:
    """The half x > 0 of two facing half discs that touch at the origin, triangles of order 1.

    Facets of `size` within `near` of the origin, cells growing with the distance from them. Groups: bodies lower
    and upper; bottom, top, axis, lower_contact, upper_contact.
    """

    def build() -> None:
        occ = gmsh.model.occ
        axes = []
        for body, s in (("lower", -1.0), ("upper", 1.0)):
            center, apex, end = (occ.addPoint(*p, 0.0) for p in ((0.0, s * radius), (0.0, 0.0), (radius, s * radius)))
            curve, flat = occ.addCircleArc(apex, center, end), occ.addLine(end, center)
            axes.append(occ.addLine(center, apex))
            face = occ.addPlaneSurface([occ.addCurveLoop([curve, flat, axes[-1]])])
            occ.synchronize()
            gmsh.model.addPhysicalGroup(2, [face], name=body)
            gmsh.model.addPhysicalGroup(1, [curve], name=f"{body}_contact")
            gmsh.model.addPhysicalGroup(1, [flat], name="bottom" if s < 0 else "top")
        gmsh.model.addPhysicalGroup(1, axes, name="axis")
        _mesh(2, f"Min({0.25 * radius}, {size}+{growth}*(Max(0,Fabs(x)-{near})+Fabs(y)))", order=1)

    _write(path, build)


def bar_on_edge(
    path: Path, dimension: int, divisions: tuple[int, int], *, gap: float = 1e-9, tilt: float = 45.0
) -> None:
    """In 2D a unit square `tool` that stands on its corner at the origin, over a block `base` of 2 x 1; quadrilaterals.

    In 3D two square bars of length 2 that cross edge on edge at the origin, bricks. divisions: cells along a side of
    the square, and along one unit of the block's sides or along each bar. Groups: tool, base; top, bottom; and in 2D
    `left` and `right`, the tool's sides at the corner, and `face` of the block. tilt: of `right` over the block,
    degrees, in 2D.
    """
    n, other = divisions
    r = np.sqrt(0.5)

    def square(corners: list[tuple[float, float, float]], counts: tuple[int, int]) -> tuple[int, list[int]]:
        geo = gmsh.model.geo
        points = [geo.addPoint(*corner) for corner in corners]
        lines = [geo.addLine(points[i], points[(i + 1) % 4]) for i in range(4)]
        for i, line in enumerate(lines):
            geo.mesh.setTransfiniteCurve(line, counts[i % 2] + 1)
        face = geo.addPlaneSurface([geo.addCurveLoop(lines)])
        geo.mesh.setTransfiniteSurface(face)
        geo.mesh.setRecombine(2, face)
        return face, lines

    def group(dim: int, members: list[int], name: str) -> None:
        gmsh.model.geo.synchronize()
        gmsh.model.addPhysicalGroup(dim, members, name=name)

    def build() -> None:
        if dimension == 2:
            x, y = np.cos(np.radians(tilt)), np.sin(np.radians(tilt))
            up = [(0.0, gap, 0.0), (x, y + gap, 0.0), (x - y, x + y + gap, 0.0), (-y, x + gap, 0.0)]
            face, lines = square(up, (n, n))
            group(2, [face], "tool")
            for name, members in (("right", lines[:1]), ("left", lines[3:]), ("top", lines[1:3])):
                group(1, members, name)
            face, lines = square([(-1, -1, 0), (1, -1, 0), (1, 0, 0), (-1, 0, 0)], (2 * other, other))
            group(2, [face], "base")
            group(1, lines[:1], "bottom")
            group(1, lines[2:3], "face")
        else:
            for name, side, axis, start in (
                ("base", -1.0, (2.0, 0.0, 0.0), (-1.0, 0.0)),
                ("tool", 1.0, (0.0, 2.0, 0.0), (0.0, -1.0)),
            ):
                across = np.array([0.0, 1.0]) if name == "base" else np.array([1.0, 0.0])
                low = gap if name == "tool" else 0.0
                places = [(0.0, 0.0), (r, r), (0.0, 2.0 * r), (-r, r)]
                corners = [(*(np.array(start) + across * x), low + side * z) for x, z in places]
                face, _ = square(corners, (n, n))
                swept = gmsh.model.geo.extrude([(2, face)], *axis, numElements=[other], recombine=True)
                group(3, [swept[1][1]], name)
                group(2, [swept[3][1], swept[4][1]], "bottom" if name == "base" else "top")
        gmsh.model.mesh.generate(dimension)

    _write(path, build)


def _mesh(dimension: int, size: str, order: int) -> None:
    field = gmsh.model.mesh.field
    number = field.add("MathEval")
    field.setString(number, "F", size)
    field.setAsBackgroundMesh(number)
    for option in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
        gmsh.option.setNumber(f"Mesh.MeshSize{option}", 0)
    gmsh.model.mesh.generate(dimension)
    gmsh.model.mesh.setOrder(order)
    if order > 1:
        gmsh.model.mesh.optimize("HighOrder")


def _write(path: Path, build: Callable[[], None]) -> None:
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        build()
        gmsh.write(str(path))
    finally:
        gmsh.finalize()
