"""Short circuits: electrodes at different potentials that meet, where the charge is that of the penalty alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from petsc4py import PETSc

from piezomat.contact.interfaces import Interfaces
from piezomat.contact.rigid_plane import RigidPlane
from piezomat.discretization.constraints import load_factor
from piezomat.discretization.model import Model
from piezomat.forms.arrays import Booleans, Integers
from piezomat.forms.contact.laws.medium import Medium
from piezomat.scene.errors import SceneError, shown

# Potentials that differ by less than this share of the largest voltage are equal.
EQUAL = 1e-9

# Numbers of boundaries; of planes those after all boundaries; of rows [[electrodes]] those after all planes.
Electrodes = tuple[int, int]


def check_short_circuit(model: Model, contact: Interfaces, factors: dict[str, float]) -> None:
    """Raise SceneError if electrodes at different potentials meet in the undeformed bodies. Collective.

    The contact must have been detected; it is evaluated at the potentials that these load factors prescribe.
    """
    if not _possible(model, contact):
        return
    state = model.new_vector()
    constraints = model.constraints
    potentials = ~constraints.fixed_displacements()
    state.array[constraints.fixed[potentials]] = constraints.values(factors)[potentials]
    constraints.expand(state)
    contact.evaluate(state, tangent=False)
    found = _first(model, contact)
    state.destroy()
    if found is None:
        return
    one, other = (_described(model, number, factors) for number in found)
    section, index = _row(model, max(found))
    key = f"{section}[{index}]"
    raise SceneError(
        f"{key}.potential",
        f"{other} in contact with {one}, a short circuit",
        "one potential where electrodes meet, or contact.electric_penalty = 0, with which no charge passes",
    )


def short_circuit(model: Model, contact: Interfaces, factors: dict[str, float]) -> str | None:
    """Which electrodes at different potentials met at the last evaluation, in words; None for none. Collective."""
    found = _first(model, contact) if _possible(model, contact) else None
    if found is None:
        return None
    one, other = (_described(model, number, factors) for number in found)
    return f"{one} and {other} have come into contact, a short circuit, whose charge nothing limits"


def _possible(model: Model, contact: Interfaces) -> bool:
    """Whether there are two electrodes, and a contact that passes charges."""
    some = any(p.law.electric is not None for p in contact.point_sets)
    return model.electric and some and len(model.scene.potentials) > 1


def _described(model: Model, number: int, factors: dict[str, float]) -> str:
    """An electrode with its potential."""
    scene, (section, index) = model.scene, _row(model, number)
    if section != "planes":
        row = scene.boundaries[index] if section == "boundaries" else scene.electrodes[index]
        name = row.on if section == "boundaries" else row.name
        return f"{shown(name)} at {load_factor(row, factors) * row.potential:g} V"
    plane = scene.planes[index]
    share = factors.get(plane.potential_follows, 0.0) if plane.potential_follows is not None else 1.0
    return f"{shown(plane.name)} at {share * plane.potential:g} V"


def _row(model: Model, number: int) -> tuple[str, int]:
    """The section and the row of the scene that a number of an electrode stands for."""
    boundaries, planes = len(model.scene.boundaries), len(model.scene.planes)
    if number < boundaries:
        return "boundaries", number
    return (
        ("planes", number - boundaries)
        if number < boundaries + planes
        else ("electrodes", number - boundaries - planes)
    )


def _first(model: Model, contact: Interfaces) -> Electrodes | None:
    """The electrodes of the pair with the least numbers between which a charge passes. Collective."""
    vector = _electrodes(model)
    electrode = contact.nodes.gather(vector)[:, 0].astype(int) - 1
    vector.destroy()
    # A potential jump between two prescribed potentials is at least this, V.
    least = EQUAL * max(model.prescription.largest_voltage(), 1e-300)
    found = sorted(set(_meeting(model, contact, electrode, least)))
    every = [pair for some in model.comm.allgather(found[:1]) for pair in some]
    return min(every, default=None)


def _electrodes(model: Model) -> PETSc.Vec:
    """Number of the electrode that prescribes the potential of a node, plus 1, in a vector like the state."""
    vector = model.new_vector()
    values = np.zeros((model.unknowns.owned, model.unknowns.block))
    for number, condition in enumerate(model.constraints.conditions):
        fixed = condition.fixed.get(model.dim)
        if fixed is not None:
            values[fixed // model.unknowns.block, 0] = number + 1
    for e in model.constraints.electrodes:
        if e.electrode.potential is not None:
            values[e.nodes, 0] = len(model.scene.boundaries) + len(model.scene.planes) + e.reference + 1
    for e in model.constraints.conductors:
        if e.row is not None:
            values[e.nodes, 0] = e.row + 1
    model.unknowns.set_by_node(vector, values)
    return vector


def _meeting(model: Model, contact: Interfaces, electrode: Integers, least: float) -> Iterator[Electrodes]:
    """Numbers of electrodes, (lower, higher), of which facets meet with a jump of the potential and a charge."""
    boundaries, planes = len(model.scene.boundaries), len(model.scene.planes)
    of_plane = {plane.name: boundaries + number for number, plane in enumerate(model.scene.planes)}
    for e in model.constraints.electrodes:
        # A plane of an open electrode prescribes nothing.
        number = -1 if e.electrode.potential is None else boundaries + planes + e.reference
        of_plane |= dict.fromkeys(e.planes, number)
    for p in contact.point_sets:
        if p.jump is None or p.response is None:
            continue
        met = p.response.charge != 0.0
        if isinstance(p.law.electric, Medium):  # which makes a capacitor of an open gap
            met &= p.gap <= p.law.equilibrium_gap
        live = np.flatnonzero((np.abs(p.jump) > least) & met)
        ours = electrode[p.slave_nodes[p.points.facet[p.projected_points[live]]]]
        if isinstance(p, RigidPlane):
            theirs = np.full_like(ours, of_plane[p.name])
        else:
            theirs = electrode[p.facets.master_nodes[p.master_facet[live]]]
        metal = _all_given(ours) & _all_given(theirs)
        for pair in np.unique(np.stack([ours[metal, 0], theirs[metal, 0]], axis=1), axis=0):
            yield int(pair.min()), int(pair.max())


def _all_given(electrode: Integers) -> Booleans:
    """Whether all nodes (r, n) of a facet are on an electrode."""
    return (electrode >= 0).all(axis=1)
