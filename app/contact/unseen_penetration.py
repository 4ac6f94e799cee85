"""Nodes and edges that lie inside another body where no contact point presses: what a run must warn of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.contact.interfaces import Interfaces
from piezomat.contact.penetrating_places import CORNER, CROSSING, MASTER, ROUND
from piezomat.scene.errors import shown

# Facets: what is less deep than this is not worth a warning. Round surfaces have their points behind their nodes. Sharp
# edges and vertices come first: what is left is rounding, as of coordinates of seven digits. Nor is what is less than
# DEEPER times as deep as the points of the pair.
DEEP = {ROUND: 0.05, CORNER: 1e-4, CROSSING: 1e-4, MASTER: 0.05}
DEEPER = 2.0
# Share of a facet's area below which a point of a segment is a sliver: where edges cross at a node some are as deep as
# the edges, with a force of 1e-4 of that of nodes.
SLIVER = 0.01


@dataclass(frozen=True, order=True)
class _Deepest:
    """Depth of the deepest node or crossing of edges of a pair or plane, and size of its facet, um."""

    depth: float
    size: float


def unseen_penetration(contact: Interfaces) -> dict[str, str]:
    """A warning by the name of each pair and plane with such places at the last evaluation. Collective."""
    points: dict[str, float] = {}
    places: dict[tuple[str, int], _Deepest] = {}  # by name, and what lies there
    for p in contact.surface_pairs:
        number, _ = p.pair_numbers(contact.pairs)
        rows, dim = p.projected_points, p.slave.kind.dim
        wide = p.points.area[rows] >= SLIVER * p.facet_size[rows] ** dim
        for pair in np.unique(number):
            name = contact.pairs.name(int(pair))
            depth = float(-p.projection.gap[(number == pair) & wide].min(initial=0.0))
            points[name] = max(points.get(name, 0.0), depth)
    for found in contact.penetrating_places():
        for pair, what in set(zip(found.pair.tolist(), found.what.tolist(), strict=True)):
            of = np.flatnonzero((found.pair == pair) & (found.what == what))
            i = of[found.depth[of].argmax()]
            key, deepest = (contact.pairs.name(pair), what), _Deepest(found.depth[i], found.facet_size[i])
            places[key] = max(places.get(key, deepest), deepest)
    for plane in contact.planes:
        points[plane.name] = float(-plane.projection.gap.min(initial=0.0))
        for what in (ROUND, CORNER):
            some = plane.sharp if what == CORNER else None
            places[plane.name, what] = _Deepest(*plane.deepest_node(contact.state.position, some))
    every = contact.comm.allgather((points, places))
    warnings: dict[str, str] = {}
    for name, what in sorted({key for _, some in every for key in some}):
        deepest = max(some[name, what] for _, some in every if (name, what) in some)
        pressed = max(some.get(name, 0.0) for some, _ in every)
        if deepest.depth > max(DEEP[what] * deepest.size, DEEPER * pressed):
            warnings[name] = _text(name, what, deepest)
    return warnings


def _text(name: str, what: int, deepest: _Deepest) -> str:
    lie, cure = "nodes lie", 'take smaller facets there, or contact.method = "node"'
    if what == CROSSING:
        lie = "edges that cross lie"
        cure = "no method has points between nodes: take facets smaller than this depth, or round an edge"
    if what == MASTER:
        lie, cure = "nodes of the surface without contact points lie", "take contact.passes = 2"
    share = deepest.depth / deepest.size
    where = f"up to {deepest.depth:.2g} um ({share:.2g} of a facet) inside what they meet"
    return f"contact {shown(name)}: {lie} {where}, where no contact point presses: {cure}"


def unseen_corners(contact: Interfaces | None) -> str | None:
    """A warning if edges or vertices of surfaces without points point to others, as with `passes = 1`."""
    if contact is None or not any(p.unseen_corners for p in contact.surface_pairs):
        return None
    return (
        "edges or vertices of a surface without contact points point to another one, and will not be seen: "
        "take contact.passes = 2, or name that surface first in its pair"
    )


def new_warnings(contact: Interfaces | None, known: set[str]) -> list[str]:
    """The warnings of pairs and planes that are not among the `known` ones, to which they are added. Collective."""
    found = unseen_penetration(contact) if contact is not None else {}
    new = [text for name, text in found.items() if name not in known]
    known |= set(found)
    return new
