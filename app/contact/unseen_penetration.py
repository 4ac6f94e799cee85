"""Nodes and edges that lie inside another body where no contact point presses: what a run must warn of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.contact.interfaces import Interfaces
from piezomat.scene.errors import shown

# Facets: nodes that are less deep than this are not worth a warning, since round surfaces have their points behind; nor
# are edges that cross. Nor is what is less than this many times as deep as the points of the pair.
DEEP, CROSSED, DEEPER = 0.05, 0.01, 2.0


@dataclass(frozen=True, order=True)
class _Deepest:
    """Depth of the deepest node or crossing of edges of a pair or plane, and size of its facet, um."""

    depth: float
    size: float


def unseen_penetration(contact: Interfaces) -> dict[str, str]:
    """A warning by the name of each pair and plane with such places at the last evaluation. Collective."""
    points: dict[str, float] = {}
    places: dict[tuple[str, bool], _Deepest] = {}  # by name, and whether edges cross there
    for p in contact.surface_pairs:
        number, _ = p.pair_numbers(contact.pairs)
        for pair in np.unique(number):
            name, depth = contact.pairs.name(int(pair)), float(-p.projection.gap[number == pair].min())
            points[name] = max(points.get(name, 0.0), depth)
    for found in contact.penetrating_places():
        for pair, crossing in set(zip(found.pair.tolist(), found.crossing.tolist(), strict=True)):
            of = np.flatnonzero((found.pair == pair) & (found.crossing == crossing))
            i = of[found.depth[of].argmax()]
            key, deepest = (contact.pairs.name(pair), crossing), _Deepest(found.depth[i], found.facet_size[i])
            places[key] = max(places.get(key, deepest), deepest)
    for plane in contact.planes:
        points[plane.name] = float(-plane.projection.gap.min(initial=0.0))
        places[plane.name, False] = _Deepest(*plane.deepest_node(contact.state.position))
    every = contact.comm.allgather((points, places))
    warnings: dict[str, str] = {}
    for name, crossing in sorted({key for _, some in every for key in some}):
        deepest = max(some[name, crossing] for _, some in every if (name, crossing) in some)
        pressed = max(some.get(name, 0.0) for some, _ in every)
        if deepest.depth > max((CROSSED if crossing else DEEP) * deepest.size, DEEPER * pressed):
            warnings[name] = _text(name, crossing, deepest)
    return warnings


def _text(name: str, crossing: bool, deepest: _Deepest) -> str:
    what, cure = "nodes lie", 'take smaller facets there, or contact.method = "node"'
    if crossing:
        what, cure = "edges that cross lie", "no method has points where they cross between nodes: take smaller facets"
    share = deepest.depth / deepest.size
    where = f"up to {deepest.depth:.2g} um ({share:.2g} of a facet) inside what they meet"
    return f"contact {shown(name)}: {what} {where}, where no contact point presses: {cure}"


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
