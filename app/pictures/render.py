"""Three-dimensional bodies as an image whose scale is known, and a plane section of them."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.pictures.data import Bodies
from piezomat.pictures.fields import Field
from piezomat.pictures.surroundings import COLOURS, PlaneMark

VIEW = (1.0, -1.7, 0.9)  # from where the bodies are seen: axis z up, x to the right
PIXELS = (1500, 1200)
WITHOUT = "#d9d9d9"  # bodies that do not have the field
_LIGHT = {"ambient": 0.45, "diffuse": 0.6, "specular": 0.0}


@dataclass(frozen=True)
class Image:
    """A parallel projection: pixels (rows, columns, 3), extent (left, right, bottom, top) in um, and the
    directions in space of the image's right and top."""

    pixels: NDArray[np.uint8]
    extent: tuple[float, float, float, float]
    right: Array
    up: Array


def render(
    bodies: Bodies,
    factor: float,
    field: Field,
    outline: str,
    planes: Sequence[PlaneMark] = (),
    electrodes: Mapping[str, str] | None = None,
) -> Image:
    """The bodies displaced by `factor` times their displacement, coloured by a field.

    The edges they have without load are drawn in the colour `outline`, rigid planes as translucent sheets, and the rims
    of ground and electrodes, which `electrodes` has by name, as thick lines.
    """
    import pyvista
    from vtkmodules.vtkCommonCore import vtkLogger

    points = bodies.points + factor * bodies.displacement
    surface = _surface(bodies, points, field.values)
    before = _surface(bodies, bodies.points, field.values)
    sheets = [_sheet(plane, points) for plane in planes]
    right, up, towards = _view()
    every = np.vstack([surface.points, before.points, *sheets])
    flat = every @ np.column_stack([right, up, towards])
    low, high = flat.min(axis=0), flat.max(axis=0)
    centre = np.column_stack([right, up, towards]) @ ((low + high) / 2)
    half = 0.5 * 1.06 * (high - low)

    # Without a screen VTK writes a warning to standard error and draws all the same.
    verbosity = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        scale = min(PIXELS[0] / half[0], PIXELS[1] / half[1])
        size = (max(int(half[0] * scale), 16), max(int(half[1] * scale), 16))
        plotter = pyvista.Plotter(off_screen=True, window_size=size)
        try:
            plotter.set_background("white")
            plotter.enable_anti_aliasing("ssaa")
            shown = surface.compute_normals(
                cell_normals=False, split_vertices=True, feature_angle=35.0, auto_orient_normals=False
            )
            has = field.shown[shown.cell_data["body"]]
            for part, style in (
                (has, {"scalars": "scalars", "cmap": field.colours, "clim": field.limits}),
                (~has, {"color": WITHOUT, "scalars": None}),
            ):
                if part.any():
                    plotter.add_mesh(
                        shown if part.all() else shown.extract_cells(part).extract_geometry(),
                        smooth_shading=True, show_scalar_bar=False, **style, **_LIGHT,
                    )  # fmt: skip
            for plane, corners in zip(planes, sheets, strict=True):
                sheet = pyvista.PolyData(corners, np.array([4, 0, 1, 2, 3]))
                plotter.add_mesh(sheet, color=COLOURS[plane.kind], opacity=0.12, lighting=False)
                rim = pyvista.PolyData(corners, lines=np.array([5, 0, 1, 2, 3, 0]))
                plotter.add_mesh(rim, color=COLOURS[plane.kind], line_width=4, lighting=False)
            for name, kind in (electrodes or {}).items():
                rim = _rim(bodies, points, bodies.on_place(name))
                if rim is not None:
                    plotter.add_mesh(
                        rim.translate(4e-3 * bodies.size * towards), color=COLOURS[kind], line_width=9, lighting=False
                    )
            # a little nearer to the eye than the surfaces they lie on; in parallel projection nothing moves
            for mesh, colour, nearer in ((before, outline, 1e-3), (surface, "#303030", 2e-3)):
                edges = mesh.extract_feature_edges(35.0, non_manifold_edges=False, manifold_edges=False)
                if edges.n_points:
                    edges.points += nearer * bodies.size * towards
                    plotter.add_mesh(edges, color=colour, line_width=4, lighting=False)
            camera = plotter.camera
            camera.parallel_projection = True
            camera.focal_point = centre
            camera.position = centre + 10 * float(np.ptp(flat, axis=0).max()) * towards
            camera.up = up
            camera.parallel_scale = half[1]
            plotter.reset_camera_clipping_range()
            pixels = plotter.screenshot(return_img=True)
        finally:
            plotter.close()
    finally:
        vtkLogger.SetStderrVerbosity(verbosity)
    width = half[1] * pixels.shape[1] / pixels.shape[0]
    return Image(np.asarray(pixels), (-width, width, -half[1], half[1]), right, up)


def section(bodies: Bodies, scalars: Array, origin: Array, across: Array) -> list[tuple[Array, Integers, Array]]:
    """Cut of the deformed bodies by the plane through `origin` normal to `across`.

    Of each body that it meets: points (n, 3), triangles (t, 3), scalars (n,).
    """
    # a hair aside: a plane through the nodes of a symmetric mesh would cut the cells on both of its sides
    origin = origin + 1.2345e-4 * bodies.size * across
    cut = bodies.vtk(bodies.points + bodies.displacement, scalars).slice(normal=across, origin=origin)
    if cut.n_cells == 0:
        return []
    cut = cut.triangulate()
    triangles = cut.faces.reshape(-1, 4)[:, 1:].astype(np.int64)
    points, values, body = np.asarray(cut.points, float), np.asarray(cut["scalars"]), cut["body"]
    return [(points, triangles[body == number], values) for number in np.unique(body)]


def _surface(bodies: Bodies, points: Array, scalars: Array) -> Any:
    """Surface of the bodies in triangles, sides of order-2 cells followed."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pyvista's notice of a default to come
        surface = bodies.vtk(points, scalars).extract_surface(nonlinear_subdivision=2)
    return surface.triangulate()


def _sheet(plane: PlaneMark, points: Array) -> Array:
    """Corners (4, 3) of the part of a plane that is beside the bodies."""
    axes = np.linalg.svd(plane.normal[None])[2][1:]
    low, high = ((points @ axes.T).min(axis=0), (points @ axes.T).max(axis=0))
    margin = 0.03 * float((high - low).max())
    low, high = low - margin, high + margin
    offset = (plane.point @ plane.normal) * plane.normal
    return np.array(
        [
            offset + a * axes[0] + b * axes[1]
            for a, b in ((low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1]))
        ]
    )


def _rim(bodies: Bodies, points: Array, on: Booleans) -> Any:
    """Edges around the faces of the surface whose nodes are all `on` a place; None where there is no such face."""
    import pyvista

    surface = _surface(bodies, points, on.astype(float))
    faces = surface.faces.reshape(-1, 4)[:, 1:]
    chosen = faces[surface.point_data["scalars"][faces].min(axis=1) > 0.999]
    if not len(chosen):
        return None
    part = pyvista.PolyData(surface.points, np.column_stack([np.full(len(chosen), 3), chosen]).ravel())
    return part.extract_feature_edges(60.0, non_manifold_edges=False, manifold_edges=False)


def _view() -> tuple[Array, Array, Array]:
    """Directions in space of the image's right, of its top, and towards the viewer."""
    towards = np.array(VIEW) / np.linalg.norm(VIEW)
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    return right, np.cross(towards, right), towards
