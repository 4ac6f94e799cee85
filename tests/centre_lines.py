"""Centre lines with closed forms, and tables of fibers about them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mpi4py import MPI

from piezomat.forms.arrays import Array

RADIUS = 0.5  # of the fibers, um


def ring(radius: float, first: float, last: float, count: int = 400) -> Array:
    """Points (count, 3) of an arc about the z axis, from one angle to another (radians)."""
    angle = np.linspace(first, last, count)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, RADIUS)])


def helix(radius: float, pitch: float, turns: float, count: int = 800) -> Array:
    """Points (count, 3) of a helix about the z axis, up and to the left from the x axis."""
    angle = np.linspace(0.0, 2.0 * np.pi * turns, count)
    rise = pitch * angle / (2.0 * np.pi)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), RADIUS + rise])


def helix_frames(radius: float, pitch: float, angle: Array) -> tuple[Array, Array, Array]:
    """Tangent, normal and binormal (n, 3) of Frenet's frame of a helix at angles (n,)."""
    rise = pitch / (2.0 * np.pi)
    zero, one = np.zeros(len(angle)), np.ones(len(angle))
    tangent = np.column_stack([-radius * np.sin(angle), radius * np.cos(angle), rise * one]) / np.hypot(radius, rise)
    normal = np.column_stack([-np.cos(angle), -np.sin(angle), zero])
    return tangent, normal, np.cross(tangent, normal)


def about_z(degrees: float) -> Array:
    """Rotation (3, 3) about the z axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def write_table(path: Path, points: Array, comm: MPI.Comm = MPI.COMM_SELF) -> Path:
    """A table of one fiber `a` through points (n, 3), written on rank 0. Collective."""
    if comm.rank == 0:
        rows = [",".join(["a", *(repr(float(c)) for c in point), repr(RADIUS)]) for point in points]
        path.write_text("\n".join(["fiber,x,y,z,radius", *rows]), encoding="utf-8")
    comm.Barrier()
    return path
