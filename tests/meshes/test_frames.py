"""Frames along centre lines: tangents, orthonormality, parallel transport against closed forms and a slow reference."""

from __future__ import annotations

import numpy as np
import pytest

from piezomat.forms.arrays import Array
from piezomat.meshes.builders.centre_lines import Face, Fiber
from piezomat.meshes.builders.frames import frames, frames_near, tangents
from piezomat.meshes.shapes import CrossedFibers, FacingHalves, FiberArray, FiberOnBlock, ParallelFibers, StackedBlocks
from tests.centre_lines import RADIUS, helix, helix_frames, ring


def beside(x: Array, tangent: Array, rng: np.random.Generator) -> Array:
    """Points in the planes across a line, at most 0.8 radii from it."""
    off = rng.normal(size=x.shape)
    off -= (off * tangent).sum(axis=1, keepdims=True) * tangent
    return x + 0.8 * RADIUS * off * (rng.uniform(size=(len(x), 1)) / np.linalg.norm(off, axis=1, keepdims=True))


def one_by_one(fiber: Fiber, along: Array) -> Array:
    """The second vectors of the frames, each by reflecting the one before twice (Wang et al. 2008)."""
    x, tangent = fiber.curve(along), fiber.curve(along, 1)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    up = np.array([0.0, 0.0, 1.0]) if abs(tangent[0, 2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    t = [up - (up @ tangent[0]) * tangent[0]]
    t[0] /= np.linalg.norm(t[0])
    for i in range(len(x) - 1):
        step = x[i + 1] - x[i]
        mirrored = t[i] - 2.0 * (step @ t[i]) / (step @ step) * step
        normal = tangent[i + 1] - tangent[i] + 2.0 * (step @ tangent[i]) / (step @ step) * step
        t.append(mirrored - 2.0 * (normal @ mirrored) / (normal @ normal) * normal)
    return np.array(t)


def test_frames_are_those_reflected_one_by_one(rng: np.random.Generator) -> None:
    """On curves that also run straight up, where the vector that the angles are counted from changes."""
    for _ in range(5):
        fiber = Fiber("a", np.cumsum(rng.normal(size=(8, 3)) + [0.0, 0.0, 1.5], axis=0), 0.2)
        along = np.sort(rng.uniform(0.0, fiber.length, 300))
        steep = np.abs(fiber.curve(along, 1)[:, 2]) > 0.9 * np.linalg.norm(fiber.curve(along, 1), axis=1)
        assert 0 < steep.sum() < len(along)
        x, s, t = frames(fiber, along)
        np.testing.assert_allclose(t, one_by_one(fiber, along), atol=1e-11)
        np.testing.assert_array_equal(x, fiber.curve(along))
        slope = fiber.curve(along, 1)
        np.testing.assert_allclose(np.cross(s, t) * np.linalg.norm(slope, axis=1)[:, None], slope, atol=1e-13)


@pytest.mark.parametrize(("radius", "pitch"), [(2.0, 5.0), (1.0, 3.0), (3.0, -6.0)])
def test_a_helix_turns_the_frames_by_minus_its_torsion(radius: float, pitch: float, rng: np.random.Generator) -> None:
    """At points beside it, far from its ends, where the spline has no curvature: the angle to Frenet's frame."""
    turns, points = 2.0, helix(radius, pitch, 2.0)
    fiber = Fiber("a", points, RADIUS)
    angle = 2.0 * np.pi * np.linspace(0.25 * turns, 0.75 * turns, 200)
    rise = pitch / (2.0 * np.pi)
    x = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), RADIUS + rise * angle])
    tangent, normal, binormal = helix_frames(radius, pitch, angle)
    found, across = frames_near(fiber, beside(x, tangent, rng))
    np.testing.assert_allclose(found, tangent, atol=1e-7)
    np.testing.assert_allclose((across**2).sum(axis=1), 1.0, atol=1e-14)
    np.testing.assert_allclose((across * found).sum(axis=1), 0.0, atol=1e-14)
    turned = np.unwrap(np.arctan2((across * binormal).sum(axis=1), (across * normal).sum(axis=1)))
    length = np.hypot(radius, rise) * angle
    torsion = rise / (radius**2 + rise**2)
    assert abs(torsion * np.ptp(length)) > 0.5
    np.testing.assert_allclose(turned - turned[0], -torsion * (length - length[0]), atol=1e-6)


def test_a_closed_ring_brings_its_frame_back(rng: np.random.Generator) -> None:
    """Also beside the place where its two ends meet, where the nearest point of the line is at either end."""
    points = ring(2.0, 1.0, 1.0 + 2.0 * np.pi, 3000)
    fiber = Fiber("a", np.concatenate([points[:-1], points[:1]]), RADIUS)
    angle = 1.0 + np.concatenate([rng.uniform(0.1, 6.2, 100), np.linspace(-0.014, 0.014, 40)])
    x = 2.0 * np.column_stack([np.cos(angle), np.sin(angle), np.full(len(angle), 0.5 * RADIUS)])
    tangent = np.column_stack([-np.sin(angle), np.cos(angle), np.zeros(len(angle))])
    found, across = frames_near(fiber, beside(x, tangent, rng))
    np.testing.assert_allclose(across, np.tile([0.0, 0.0, 1.0], (len(angle), 1)), atol=1e-14)
    np.testing.assert_allclose(found, tangent, atol=2e-3)  # up to 0.014 off at the wrong end


def test_a_straight_fiber_has_one_frame_also_beyond_its_ends() -> None:
    along = np.array([np.cos(0.5), np.sin(0.5), 0.0])
    fiber = Fiber("a", np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0] + 4.0 * along]), RADIUS, (Face(0, 0.0, -1), None))
    x = np.array([-0.2, 0.0, 1e-17, 1e-9, 1.1, 3.9, 4.2])[:, None] * along + [0.1, 0.0, 1.2]
    found, across = frames_near(fiber, x)
    np.testing.assert_allclose(found, np.tile(along, (len(x), 1)), atol=1e-15)
    np.testing.assert_array_equal(across, np.tile([0.0, 0.0, 1.0], (len(x), 1)))
    np.testing.assert_allclose(tangents(fiber), np.tile(along, (len(tangents(fiber)), 1)), atol=1e-15)


def test_fibers_in_three_dimensions_have_centre_lines() -> None:
    lines = CrossedFibers(angle=30.0, gap=0.1, length=3.0).centre_lines()
    np.testing.assert_allclose(lines["lower"].points, [[-1.5, 0, -0.5], [1.5, 0, -0.5]], atol=1e-15)
    half = 1.5 * np.array([np.cos(np.pi / 6), 0.5, 0.0])
    np.testing.assert_allclose(lines["upper"].points, [[0, 0, 0.6] - half, [0, 0, 0.6] + half], atol=1e-15)
    side = ParallelFibers(arrangement="side_by_side", length=2.0, radius=0.3).centre_lines()
    np.testing.assert_allclose(side["fiber_2"].points, [[-1, 0.3, 0], [1, 0.3, 0]], atol=1e-15)
    assert list(FiberOnBlock(length=1.0).centre_lines()) == ["fiber"]
    assert list(FiberArray(columns=2, rows=1, length=1.0).centre_lines()) == ["fiber_1", "fiber_2"]
    for shape in (FacingHalves(), FiberArray(), ParallelFibers(), FiberOnBlock(), StackedBlocks(depth=1.0)):
        assert shape.centre_lines() == {}
