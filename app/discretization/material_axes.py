"""Axes of the materials in the cells: those that follow the centre lines of bodies, and the poling of every cell."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.meshes.body_mesh import BodyMesh
from piezomat.meshes.builders.centre_lines import Fiber
from piezomat.meshes.builders.frames import frames_near
from piezomat.scene.data import in_space
from piezomat.scene.scene import Scene


def axes_along_lines(scene: Scene, bodies: BodyMesh) -> dict[int, Array]:
    """Rotations (n, 3, 3) to this rank's cells of each body whose axes follow its centre line, by the body's number.

    The columns are the material axes at the place on the line that is nearest to the middle of the cell. Each rank
    computes those of its own cells, from the geometry alone.
    """
    follow = [i for i, body in enumerate(bodies.bodies) if scene.follows_line(scene.material_name(body))]
    if not follow:
        return {}
    x = bodies.mesh.geometry.x[fenicsx.geometry_dofmap(bodies.mesh)].mean(axis=1)
    order = np.argsort(bodies.cell_body, kind="stable")
    first, last = (np.searchsorted(bodies.cell_body[order], follow, side=side) for side in ("left", "right"))
    found = {}
    for body, start, end in zip(follow, first, last, strict=True):
        name = bodies.bodies[body]
        poling = scene.poling(scene.material_name(name))
        direction = None if poling == "across" else np.array(in_space(poling))
        found[body] = _axes(scene.centre_lines[name], x[order[start:end]], direction)
    return found


def polings(scene: Scene, bodies: BodyMesh, axes: Mapping[int, Array]) -> Array | None:
    """Unit vector (cells, 3) of material axis 3, before any load, in this rank's cells; None if no material has one.

    axes: of bodies whose axes follow their centre lines. Zero where the direction of the axes does not matter.
    """
    constant = np.zeros((len(bodies.bodies), 3))
    for number, body in enumerate(bodies.bodies):
        poling = scene.poling(scene.material_name(body))
        if isinstance(poling, list):
            constant[number] = np.array(in_space(poling)) / np.linalg.norm(poling)
    found = constant[bodies.cell_body]
    for number, rotations in axes.items():
        found[bodies.cell_body == number] = rotations[:, :, 2]
    return found if axes or constant.any() else None


def _axes(line: Fiber, x: Array, poling: Array | None) -> Array:
    """Rotations (n, 3, 3) at points x (n, 3): axis 1 along the line, axis 3 across it, near `poling` if it is given."""
    tangent, across = frames_near(line, x)
    if poling is not None:
        across = poling - (tangent @ poling)[:, None] * tangent
        across /= np.linalg.norm(across, axis=1, keepdims=True)
    return np.stack([tangent, np.cross(across, tangent), across], axis=-1)
