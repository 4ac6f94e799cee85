"""What moves as one and by how much a force decides: rigid boundaries, and planes by force.

The translation of a rigid boundary is that of a reference node, to which the displacements of its nodes are tied. The
travel of a plane by force, along the force on it, is the first displacement component of a reference node.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezomat.discretization.unknowns import Unknowns
from piezomat.forms.arrays import Array, Booleans
from piezomat.meshes.body_mesh import BodyMesh
from piezomat.scene.errors import SceneError, shown
from piezomat.scene.scene import Scene
from piezomat.scene.sections import Boundary, Plane


@dataclass(frozen=True)
class RigidBoundary:
    """A row [[boundaries]] that is rigid, on the mesh.

    boundary: the row of the scene
    reference: number of the reference node that has its translation
    tied {component: (n,)}: local numbers of the owned unknowns of its nodes that are one, of the free components
    """

    boundary: Boundary
    reference: int
    tied: dict[int, NDArray[np.int64]]


@dataclass(frozen=True)
class PushedPlane:
    """A row [[planes]] that a force moves.

    plane: the row of the scene
    reference: number of the reference node that has its travel
    direction (d,): unit vector of the force and of the travel
    force: uN (2D: per um of depth), at a load factor of 1
    """

    plane: Plane
    reference: int
    direction: Array
    force: float


def rigid_boundaries(
    scene: Scene, unknowns: Unknowns, bodies: BodyMesh, is_fixed: Booleans, reference: int
) -> list[RigidBoundary]:
    """The rigid boundaries of a scene, with reference nodes from this number on. Collective.

    is_fixed (owned, block): unknowns that boundaries prescribe. SceneError: a node that must move with a rigid group,
    and that another row of [[boundaries]] holds or moves with its own group.
    """
    d = unknowns.dim
    owner = np.full((unknowns.owned, d), -1)
    found: list[RigidBoundary] = []
    for index, boundary in enumerate(scene.boundaries):
        if not boundary.rigid:
            continue
        nodes = unknowns.nodes_of(bodies.facets[boundary.on])
        given = boundary.displacement or [None] * d
        tied = {}
        for component in (i for i, value in enumerate(given) if value is None):
            held, other = is_fixed[nodes, component], owner[nodes, component]
            count, clash = (unknowns.comm.allreduce(int(some.sum())) for some in (held, other >= 0))
            if count or clash:
                what = "prescribed by another row" if count else "of another rigid group"
                place = f"{shown(boundary.on)}, of which {count or clash} nodes have a displacement {'xyz'[component]}"
                allowed = f"displacement[{component}] = a number, or nodes that nothing else holds in this direction"
                raise SceneError(f"boundaries[{index}].rigid", f"{place} {what}", allowed)
            owner[nodes, component] = index
            tied[component] = nodes * unknowns.block + component
        found.append(RigidBoundary(boundary, reference + len(found), tied))
    return found


def pushed_planes(scene: Scene, reference: int) -> list[PushedPlane]:
    """The planes by force of a scene, with reference nodes from this number on."""
    planes: Iterable[Plane] = (plane for plane in scene.planes if plane.is_pushed)
    return [PushedPlane(plane, number, *scene.push(plane)) for number, plane in enumerate(planes, start=reference)]
