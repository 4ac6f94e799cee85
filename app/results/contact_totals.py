"""What contact points add up to: forces, areas and largest values of a pair of bodies, and of a rigid plane."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from piezomat.contact.facets_across import facets_across
from piezomat.contact.interfaces import Interfaces
from piezomat.contact.rigid_plane import RigidPlane
from piezomat.forms.arrays import Array
from piezomat.meshes import parallel


@dataclass(frozen=True)
class PairTotals:
    """Contact of a pair of bodies.

    force (d,): on the first body, uN.
    area, bonded_area: where the gap is closed, and where adhesion has not broken, um2.
    max_pressure (MPa), max_penetration (um, of points, nodes and edges), max_potential_jump (V, of points that
    touch or are bonded), max_field (V/um, in open gaps): 0 for none. facets_across: least number across a place that
    carries some of the load, 0 for none; not of sums.
    """

    force: Array
    area: float
    bonded_area: float
    max_pressure: float
    max_penetration: float
    max_potential_jump: float
    max_field: float = 0.0
    facets_across: float = 0.0

    @classmethod
    def none(cls, dim: int) -> PairTotals:
        """Totals of no points."""
        return cls(np.zeros(dim), 0.0, 0.0, 0.0, 0.0, 0.0)

    def __add__(self, other: PairTotals) -> PairTotals:
        """Totals of the points of both."""
        return PairTotals(
            self.force + other.force,
            self.area + other.area,
            self.bonded_area + other.bonded_area,
            float(np.maximum(self.max_pressure, other.max_pressure)),
            float(np.maximum(self.max_penetration, other.max_penetration)),
            float(np.maximum(self.max_potential_jump, other.max_potential_jump)),
            float(np.maximum(self.max_field, other.max_field)),
        )


@dataclass(frozen=True)
class PlaneTotals:
    """Contact with a rigid plane.

    travel: along the normal, um. force (d,): that the plane exerts on the bodies, uN. area: um2. max_pressure: MPa.
    max_penetration: um. charge: of an electrode, pC. potential: of an electrode its own, V; of an insulator the mean
    over the surfaces that touch it, nan where none does. max_field, facets_across: see `PairTotals`.
    """

    travel: float
    force: Array
    area: float
    max_pressure: float
    max_penetration: float
    charge: float
    potential: float
    max_field: float = 0.0
    facets_across: float = 0.0


def totals_of_pairs(contact: Interfaces) -> dict[int, PairTotals]:
    """Totals of each pair in contact or with charges across a gap at the last evaluation, by its number. Collective."""
    mine: dict[int, PairTotals] = {}
    none = PairTotals.none(contact.dim)
    for p in contact.surface_pairs:
        r, gap, rows = p.response, p.projection.gap, p.projected_points
        number, first = p.pair_numbers(contact.pairs)
        area = p.points.area[rows]
        closed = p.gap <= p.law[rows].equilibrium_gap
        # History is that of the converged step, so bonds that broke in it no longer count.
        bonded = p.law[rows].bonded(p.history[rows])
        together = closed | (p.law[rows].status(p.gap, p.history[rows]) == 2)
        jump = np.abs(p.jump) * together if p.jump is not None else np.zeros(len(gap))
        force = np.where(first, 1.0, -1.0)[:, None] * p.force
        sums = np.column_stack([force, p.share * area * closed, p.share * area * bonded])
        largest = np.column_stack([-r.traction * p.points.weight[rows] / area, -gap, jump])
        for pair in np.unique(number[closed | bonded | (r.traction != 0.0)]):
            of = number == pair
            *total, touching, sticking = sums[of].sum(axis=0)
            points = PairTotals(np.array(total), touching, sticking, *largest[of].max(axis=0))
            mine[int(pair)] = mine.get(int(pair), none) + points
        number, force, field = p.across_gaps(contact.pairs)
        for pair in np.unique(number[force.any(axis=1) | (field > 0.0)]):
            of = number == pair
            across = replace(none, force=force[of].sum(axis=0), max_field=float(field[of].max()))
            mine[int(pair)] = mine.get(int(pair), none) + across
    for places in contact.penetrating_places():
        for pair in np.unique(places.pair):
            deepest = float(places.depth[places.pair == pair].max())
            mine[int(pair)] = mine.get(int(pair), none) + replace(none, max_penetration=deepest)
    everywhere: dict[int, PairTotals] = {}
    for part in contact.comm.allgather(mine):
        for pair, totals in part.items():
            everywhere[pair] = everywhere.get(pair, none) + totals
    across = facets_across(contact)
    numbers = sorted(everywhere)
    places = contact.pairs.in_results(np.array(numbers, np.int64)).tolist()
    return {
        number: replace(everywhere[number], facets_across=across[place].facets if place in across else 0.0)
        for number, place in zip(numbers, places, strict=True)
    }


def totals_of_planes(contact: Interfaces) -> list[PlaneTotals]:
    """Totals of each plane at the last evaluation. Collective."""
    across = facets_across(contact) if contact.planes else {}
    found = [_totals_of_plane(contact, plane) for plane in contact.planes]
    return [
        replace(totals, facets_across=across[number].facets if number in across else 0.0)
        for number, totals in enumerate(found, start=contact.pairs.first_plane)
    ]


def _totals_of_plane(contact: Interfaces, plane: RigidPlane) -> PlaneTotals:
    d, area = contact.dim, plane.points.area[plane.near_points]
    closed = plane.gap <= 0.0
    potential = 0.0 if plane.surface_potential is None else float((area * plane.surface_potential) @ closed)
    sums = parallel.total(contact.comm, np.array([*plane.force, plane.charge, area @ closed, potential]))
    pressure = -plane.response.traction * plane.points.weight[plane.near_points] / area
    deepest = max(-plane.projection.gap.min(initial=0.0), plane.deepest_node(contact.state.position)[0])
    fields = [plane.field().max(initial=0.0), *(p.field for p in contact.plates if any(plane is of for of in p.planes))]
    largest = np.array([pressure.max(initial=0.0), deepest, max(fields)])
    largest = parallel.largest(contact.comm, largest)
    charge, touching, integral = sums[d:]
    mean = integral / touching if touching > 0.0 else float("nan")
    return PlaneTotals(
        travel=float(plane.offset @ plane.normal),
        force=sums[:d],
        area=touching,
        max_pressure=largest[0],
        max_penetration=largest[1],
        charge=charge,
        potential=mean if plane.potential is None else plane.potential,
        max_field=largest[2],
    )
