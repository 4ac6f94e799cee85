"""Electrodes on the mesh: the nodes whose potentials are one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from piezomat.discretization.unknowns import Unknowns
from piezomat.forms.arrays import Booleans, Integers
from piezomat.meshes.body_mesh import BodyMesh
from piezomat.scene.errors import SceneError, named, shown
from piezomat.scene.scene import Scene
from piezomat.scene.sections import Electrode


@dataclass(frozen=True)
class ElectrodeNodes:
    """A row [[electrodes]] of the scene on the mesh.

    electrode: the row of the scene
    reference: number of the reference node that has its potential
    nodes (n,): owned nodes of its facet groups and bodies
    planes: names of the rigid planes that belong to it
    """

    electrode: Electrode
    reference: int
    nodes: NDArray[np.int64]
    planes: tuple[str, ...]


def electrode_nodes(
    scene: Scene, unknowns: Unknowns, bodies: BodyMesh, dielectric_node: Booleans, given: Integers
) -> list[ElectrodeNodes]:
    """The electrodes of a scene. Collective.

    given (owned,): row of the boundary that prescribes the potential of a node, -1 for none

    SceneError: an electrode where no body has a permittivity; nodes that two electrodes, or an electrode and a boundary
    with a potential, have in common.
    """
    comm = unknowns.comm
    owner = np.full(unknowns.owned, -1)
    found = []
    for number, electrode in enumerate(scene.electrodes):
        key = f"electrodes[{number}].on"
        members = scene.members(electrode)
        here: Booleans = np.zeros(unknowns.owned, bool)
        for group in members.facet_groups:
            here[unknowns.nodes_of(bodies.facets[group])] = True
        numbers = [bodies.bodies.index(name) for name in members.bodies]
        here |= unknowns.touched(np.isin(bodies.cell_body, numbers))[: unknowns.owned]
        here &= dielectric_node[: unknowns.owned]
        if not comm.allreduce(bool(here.any()), op=MPI.LOR) and not members.planes:
            place = f"{named(electrode.on)}, where no body has a permittivity"
            raise SceneError(key, place, "facet groups or bodies whose material has one, or planes")
        other, row = (comm.allreduce(int(rows[here].max(initial=-1)), op=MPI.MAX) for rows in (owner, given))
        if other >= 0:
            count = comm.allreduce(int((owner[here] == other).sum()))
            name = shown(scene.electrodes[other].name)
            same = f"{shown(electrode.name)}, which has {count} node{'s' * (count > 1)} in common with {name}"
            raise SceneError(key, same, "electrodes apart from each other; two that touch are one")
        if row >= 0:
            count = comm.allreduce(int((given[here] == row).sum()))
            have = "nodes have" if count > 1 else "node has"
            where = f"boundaries[{row}] on {shown(scene.boundaries[row].on)}"
            same = f"{shown(electrode.name)}, of which {count} {have} the potential of {where}"
            raise SceneError(key, same, "either an electrode or a boundary with a potential")
        owner[here] = number
        found.append(ElectrodeNodes(electrode, number, np.flatnonzero(here), members.planes))
    return found
