"""Electrodes on the mesh: the nodes whose potentials are one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from piezomat.discretization.conductors import Conductor
from piezomat.discretization.unknowns import Unknowns
from piezomat.forms.arrays import Booleans, Integers
from piezomat.meshes.body_mesh import BodyMesh
from piezomat.scene.errors import SceneError, named, shown
from piezomat.scene.scene import Scene
from piezomat.scene.sections import Electrode


@dataclass(frozen=True)
class ElectrodeNodes:
    """A row [[electrodes]] of the scene on the mesh, or a conductor that belongs to none.

    electrode: the row of the scene
    reference: number of the reference node that has its potential
    nodes (n,): owned nodes of its facet groups and bodies
    planes: names of the rigid planes that belong to it
    row: of the boundary that gives a conductor its potential; None without one
    """

    electrode: Electrode
    reference: int
    nodes: NDArray[np.int64]
    planes: tuple[str, ...]
    row: int | None = None


def electrode_nodes(
    scene: Scene,
    unknowns: Unknowns,
    bodies: BodyMesh,
    dielectric_node: Booleans,
    metal: Sequence[Conductor],
    given: Integers,
) -> list[ElectrodeNodes]:
    """The electrodes of a scene, with the conductors that they touch. Collective.

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
        for conductor in metal:
            if comm.allreduce(bool(here[conductor.nodes].any()), op=MPI.LOR):
                here[conductor.nodes] = True
        if not comm.allreduce(bool(here.any()), op=MPI.LOR) and not members.planes:
            place = f"{named(electrode.on)}, where no body has a permittivity"
            allowed = "facet groups or bodies whose material has one or is a conductor, or planes"
            raise SceneError(key, place, allowed)
        other, row = (comm.allreduce(int(rows[here].max(initial=-1)), op=MPI.MAX) for rows in (owner, given))
        if other >= 0:
            count = comm.allreduce(int((owner[here] == other).sum()))
            name = shown(scene.electrodes[other].name)
            same = f"{shown(electrode.name)}, which has {count} node{'s' * (count > 1)} in common with {name}"
            raise SceneError(
                key, same, "electrodes apart from each other; two that touch, or touch one conductor, are one"
            )
        if row >= 0:
            count = comm.allreduce(int((given[here] == row).sum()))
            have = "nodes have" if count > 1 else "node has"
            where = f"boundaries[{row}] on {shown(scene.boundaries[row].on)}"
            same = f"{shown(electrode.name)}, of which {count} {have} the potential of {where}"
            raise SceneError(key, same, "either an electrode or a boundary with a potential")
        owner[here] = number
        found.append(ElectrodeNodes(electrode, number, np.flatnonzero(here), members.planes))
    return found


def other_conductors(
    scene: Scene,
    unknowns: Unknowns,
    metal: Sequence[Conductor],
    rows: Sequence[set[int]],
    electrodes: Sequence[ElectrodeNodes],
) -> list[ElectrodeNodes]:
    """The conductors that no electrode touches, as electrodes named after their first body. Collective.

    rows: of the boundaries that prescribe the potential of each conductor; without one it is open, with no net charge.
    Their reference nodes come after those of the electrodes. SceneError: boundaries that prescribe different ones.
    """
    owned: Booleans = np.zeros(unknowns.owned, bool)
    for electrode in electrodes:
        owned[electrode.nodes] = True
    found: list[ElectrodeNodes] = []
    for conductor, given in zip(metal, rows, strict=True):
        if unknowns.comm.allreduce(bool(owned[conductor.nodes].any()), op=MPI.LOR):
            continue
        potential, follows = None, None
        for number in sorted(given):
            row = scene.boundaries[number]
            if potential is not None and (row.potential, row.potential and row.follows) != (potential, follows):
                place = f"another potential than boundaries[{min(given)}] of the conductor {named(conductor.bodies)}"
                raise SceneError(f"boundaries[{number}].potential", place, "one potential of a conductor")
            potential, follows = row.potential, row.follows if row.potential else None
        row = Electrode(name=conductor.bodies[0], on=list(conductor.bodies), potential=potential, follows=follows)
        found.append(ElectrodeNodes(row, len(electrodes) + len(found), conductor.nodes, (), min(given, default=None)))
    return found
