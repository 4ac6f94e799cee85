"""Conductors: bodies of metal on the mesh, each of one potential; those that share nodes are one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from piezomat.discretization.unknowns import Unknowns
from piezomat.forms.constitutive import ConstitutiveLaw
from piezomat.meshes import parallel
from piezomat.meshes.body_mesh import BodyMesh


@dataclass(frozen=True)
class Conductor:
    """Bodies of conducting material that hang together.

    bodies: their names
    nodes (n,): owned nodes
    """

    bodies: tuple[str, ...]
    nodes: NDArray[np.int64]


def conductors(unknowns: Unknowns, bodies: BodyMesh, materials: Sequence[ConstitutiveLaw]) -> list[Conductor]:
    """The conductors of a mesh whose bodies are of these materials, in the order of their first bodies. Collective."""
    metal = [number for number, material in enumerate(materials) if material.conductor]
    if not metal:
        return []
    touched = np.array([unknowns.touched(bodies.cell_body == body)[: unknowns.owned] for body in metal])
    counts = touched.astype(float)
    common = parallel.total(unknowns.comm, counts @ counts.T)
    number, label = scipy.sparse.csgraph.connected_components(common > 0.0)
    found = []
    for conductor in range(number):
        members = np.flatnonzero(label == conductor)
        names = tuple(bodies.bodies[metal[member]] for member in members)
        found.append(Conductor(names, np.flatnonzero(touched[members].any(axis=0))))
    return found
