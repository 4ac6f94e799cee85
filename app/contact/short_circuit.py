"""Short circuits: electrodes at different potentials that meet, where the charge is that of the contact alone.

They may meet by way of other metal: open electrodes, and conductors that float.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

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

# Numbers of boundaries; of planes those after all boundaries; of what has one potential each those after all planes.
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
    found = _first(model, contact, factors)
    state.destroy()
    if found is None:
        return
    one, other = (_described(model, number, factors) for number in found.electrodes)
    section, index = _row(model, max(found.electrodes))
    key = f"{section}[{index}]"
    by = "" if found.directly else " by way of other metal"
    raise SceneError(
        f"{key}.potential",
        f"{other} in contact with {one}{by}, a short circuit",
        "one potential where electrodes meet, or contact.electric_penalty = 0, with which no charge passes",
    )


def short_circuit(model: Model, contact: Interfaces, factors: dict[str, float]) -> str | None:
    """Which electrodes at different potentials met at the last evaluation, in words; None for none. Collective."""
    found = _first(model, contact, factors) if _possible(model, contact) else None
    if found is None:
        return None
    one, other = (_described(model, number, factors) for number in found.electrodes)
    by = "" if found.directly else " by way of other metal"
    return f"{one} and {other} have come into contact{by}, a short circuit, whose charge nothing limits"


def _possible(model: Model, contact: Interfaces) -> bool:
    """Whether there are two electrodes, and a contact that passes charges."""
    some = any(p.law.has_charges for p in contact.point_sets)
    return model.electric and some and len(model.scene.potentials) > 1


def _described(model: Model, number: int, factors: dict[str, float]) -> str:
    """An electrode with its potential."""
    section, index = _row(model, number)
    row = getattr(model.scene, section)[index]
    name = row.on if section == "boundaries" else row.name
    return f"{shown(name)} at {_potential(model, number, factors):g} V"


def _potential(model: Model, number: int, factors: dict[str, float]) -> float | None:
    """The potential that is prescribed there, V; None where none is."""
    section, index = _row(model, number)
    rows = getattr(model.scene, section)
    if index >= len(rows) or rows[index].potential is None:
        return None
    row = rows[index]
    if section != "planes":
        return load_factor(row, factors) * row.potential
    return row.potential * (factors.get(row.potential_follows, 0.0) if row.potential_follows is not None else 1.0)


def _row(model: Model, number: int) -> tuple[str, int]:
    """The section and the row of the scene that a number stands for; of a floating conductor there is no such row."""
    boundaries, planes = len(model.scene.boundaries), len(model.scene.planes)
    if number < boundaries:
        return "boundaries", number
    return (
        ("planes", number - boundaries)
        if number < boundaries + planes
        else ("electrodes", number - boundaries - planes)
    )


@dataclass(frozen=True)
class _Short:
    """Two electrodes (lower number, higher) at different potentials; whether they themselves meet."""

    electrodes: Electrodes
    directly: bool


def _first(model: Model, contact: Interfaces, factors: dict[str, float]) -> _Short | None:
    """The pair with the least numbers of electrodes at different potentials that metal in contact joins. Collective."""
    vector = _electrodes(model)
    electrode = contact.nodes.gather(vector)[:, 0].astype(int) - 1
    vector.destroy()
    meeting = set().union(*model.comm.allgather(set(_meeting(model, contact, electrode))))
    least = EQUAL * model.prescription.largest_voltage()
    found = []
    for metal in _joined(meeting):
        values = {number: _potential(model, number, factors) for number in sorted(metal)}
        given = [(number, value) for number, value in values.items() if value is not None]
        found += [(a, b) for (a, va), (b, vb) in combinations(given, 2) if abs(va - vb) > least]
    if not found:
        return None
    return _Short(min(found), min(found) in meeting)


def _joined(meeting: set[Electrodes]) -> list[set[int]]:
    """Sets of numbers that meetings join."""
    sets: list[set[int]] = []
    for pair in meeting:
        touching = [metal for metal in sets if metal & set(pair)]
        sets = [metal for metal in sets if metal not in touching] + [set(pair).union(*touching)]
    return sets


def _electrodes(model: Model) -> PETSc.Vec:
    """Number of the electrode or conductor that a node belongs to, plus 1, in a vector like the state."""
    vector = model.new_vector()
    values = np.zeros((model.unknowns.owned, model.unknowns.block))
    for number, condition in enumerate(model.constraints.conditions):
        fixed = condition.fixed.get(model.dim)
        if fixed is not None:
            values[fixed // model.unknowns.block, 0] = number + 1
    for e in model.constraints.equipotentials:
        own = len(model.scene.boundaries) + len(model.scene.planes) + e.reference
        values[e.nodes, 0] = 1 + (own if e.row is None else e.row)
    model.unknowns.set_by_node(vector, values)
    return vector


def _meeting(model: Model, contact: Interfaces, electrode: Integers) -> Iterator[Electrodes]:
    """Numbers of electrodes and conductors, (lower, higher), of which facets meet, or a charge passes between them."""
    boundaries, planes = len(model.scene.boundaries), len(model.scene.planes)
    of_plane = {plane.name: boundaries + number for number, plane in enumerate(model.scene.planes)}
    for e in model.constraints.electrodes:
        of_plane |= dict.fromkeys(e.planes, boundaries + planes + e.reference)
    for p in contact.point_sets:
        if p.response is None or p.jump is None:
            continue
        met = (p.gap <= p.law.equilibrium_gap) & (p.response.hessian[:, 1, 1] != 0.0)
        if not any(isinstance(law, Medium) for law in p.law.summands()):  # which makes a capacitor of an open gap
            met |= p.response.charge != 0.0
        live = np.flatnonzero(met)
        ours = electrode[p.slave_nodes[p.points.facet[p.projected_points[live]]]]
        if isinstance(p, RigidPlane):
            theirs = np.full_like(ours, of_plane[p.name])
        else:
            theirs = electrode[p.facets.master_nodes[p.master_facet[live]]]
        metal = _all_given(ours) & _all_given(theirs) & (ours[:, 0] != theirs[:, 0])
        for pair in np.unique(np.stack([ours[metal, 0], theirs[metal, 0]], axis=1), axis=0):
            yield int(pair.min()), int(pair.max())


def _all_given(electrode: Integers) -> Booleans:
    """Whether all nodes (r, n) of a facet are of metal."""
    return (electrode >= 0).all(axis=1)
