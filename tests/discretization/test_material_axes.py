"""Axes of materials in the cells: along centre lines, on each rank, in the forms and in the fields."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.discretization.material_axes import polings
from piezomat.discretization.model import Model
from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array
from piezomat.forms.material_library import BUILT_IN
from piezomat.meshes.body_mesh import create
from piezomat.scene import Scene
from tests.centre_lines import RADIUS, helix, helix_frames, write_table

pytestmark = pytest.mark.mpi

HELIX = 2.0, 4.0  # radius and pitch, um


def model(comm: MPI.Comm, geometry: dict[str, Any], bodies: dict[str, str], **material: Any) -> Model:
    """A model whose material `fiber` is that of these keys."""
    scene = Scene(
        geometry=geometry,
        mesh={"size": 0.5, "cells": "tensor"},
        materials={"fiber": {"like": "pvdf", **material}},
        bodies=bodies,
        boundaries=[{"on": "ends" if geometry["shape"] == "fibers" else "bottom", "displacement": [0, 0, 0]}],
    )
    return Model(scene, create(comm, scene.geometry, scene.sizes))


def middles(built: Model) -> Array:
    """Middles (cells, 3) of this rank's cells."""
    return built.mesh.geometry.x[fenicsx.geometry_dofmap(built.mesh)].mean(axis=1)


def on_helix(comm: MPI.Comm, folder: Path, **material: Any) -> Model:
    table = write_table(folder / "helix.csv", helix(*HELIX, 1.0), comm)
    return model(comm, {"shape": "fibers", "file": str(table)}, {"a": "fiber"}, **material)


def angles(x: Array) -> Array:
    """Angles at which the helix is nearest to points (n, 3) within it."""
    radius, rise = HELIX[0], HELIX[1] / (2.0 * np.pi)
    tried = np.linspace(0.0, 2.0 * np.pi, 20_001)
    line = np.column_stack([radius * np.cos(tried), radius * np.sin(tried), RADIUS + rise * tried])
    return tried[[((line - point) ** 2).sum(axis=1).argmin() for point in x]] if len(x) else np.zeros(0)


def test_across_a_helix(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    """Axis 1 is the tangent, axis 3 keeps minus the integral of the torsion to Frenet's normal."""
    built = on_helix(comm, shared_tmp_path, poling="across")
    x, axes = middles(built), built.axes[0]
    # The natural spline is straight at its ends, and its cells there are left out.
    angle = angles(x)
    inside = (angle > 0.3) & (angle < 2.0 * np.pi - 0.3)
    assert comm.allreduce(int(inside.sum())) > 100
    tangent, normal, binormal = helix_frames(*HELIX, angle)
    np.testing.assert_allclose(axes[inside, :, 0], tangent[inside], atol=2e-4)  # of `angles`
    np.testing.assert_allclose(np.linalg.det(axes), 1.0, atol=1e-13)
    np.testing.assert_allclose(np.swapaxes(axes, 1, 2) @ axes, np.tile(np.eye(3), (len(x), 1, 1)), atol=1e-13)
    rise = HELIX[1] / (2.0 * np.pi)
    _, (normal_at_0,), (binormal_at_0,) = helix_frames(*HELIX, np.zeros(1))
    turned = np.arctan2(binormal_at_0[2], normal_at_0[2]) - rise / np.hypot(HELIX[0], rise) * angle
    expected = np.cos(turned)[:, None] * normal + np.sin(turned)[:, None] * binormal
    np.testing.assert_allclose(axes[inside, :, 2], expected[inside], atol=2e-3)  # of the spline's first segments


@pytest.mark.parametrize("poling", [None, [0.3, -0.2, 1.0]])
def test_a_vector_is_made_normal_to_a_helix(poling: list[float] | None, comm: MPI.Comm, shared_tmp_path: Path) -> None:
    given = {} if poling is None else {"poling": poling}
    axes = on_helix(comm, shared_tmp_path, axis1="along", **given).axes[0]
    tangent, direction = axes[:, :, 0], np.array(poling or [0.0, 0.0, 1.0])
    expected = direction - (tangent @ direction)[:, None] * tangent
    np.testing.assert_allclose(axes[:, :, 2] * np.linalg.norm(expected, axis=1)[:, None], expected, atol=1e-13)
    np.testing.assert_allclose(np.linalg.det(axes), 1.0, atol=1e-13)


def test_numbers_in_the_cells_are_those_of_the_rotated_material(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    """And sizes that penalties and scales are made of are those of the material itself."""
    built = on_helix(comm, shared_tmp_path, poling="across")
    pvdf = BUILT_IN["pvdf"]
    assert built.stiffness == pvdf.mean_stiffness
    assert built.potential_scale == pytest.approx(np.sqrt(pvdf.mean_stiffness / pvdf.mean_permittivity), rel=1e-15)
    (region,) = built.regions
    numbers = region.numbers.x.array.reshape(-1, 45)[fenicsx.dofmap(region.numbers.function_space)[:, 0]]
    for cell in range(0, len(numbers), 7):
        rotation = built.axes[0][cell]
        expected = pvdf.rotated(rotation[:, 2], rotation[:, 0]).numbers(3, "strain", built.potential_scale)
        np.testing.assert_allclose(numbers[cell], expected, atol=1e-13 * np.abs(expected).max())


def test_axes_of_straight_fibers_are_those_of_vectors(comm: MPI.Comm) -> None:
    """Of the fiber alone: the block beside it has axes of its own."""
    geometry = {"shape": "fiber_on_block", "length": 1.0}
    bodies = {"fiber": "fiber", "block": "pzt5h"}
    built = model(comm, geometry, bodies, poling="across")
    assert list(built.axes) == [1]
    assert np.array_equal(built.axes[1], np.tile(np.eye(3), (len(built.axes[1]), 1, 1)))
    found = polings(built.scene, built.bodies, built.axes)
    np.testing.assert_array_equal(found, np.tile([0.0, 0.0, 1.0], (len(found), 1)))
    constant = model(comm, geometry, bodies)
    assert constant.axes == {}
    for ours, theirs in zip(built.regions, constant.regions, strict=True):
        np.testing.assert_allclose(ours.numbers.x.array, theirs.numbers.x.array, rtol=1e-14)


def test_poling_is_zero_where_no_material_has_axes(comm: MPI.Comm) -> None:
    geometry = {"shape": "fiber_on_block", "length": 1.0}
    built = model(comm, geometry, {"fiber": "fiber", "block": "elastic"}, poling=[0, 3, 4])
    found = polings(built.scene, built.bodies, built.axes)
    expected = np.where(built.bodies.cell_body[:, None] == 1, [0.0, 0.6, 0.8], 0.0)
    np.testing.assert_allclose(found, expected, atol=1e-15)
    plain = model(comm, geometry, {"fiber": "elastic", "block": "elastic"})
    assert polings(plain.scene, plain.bodies, plain.axes) is None
