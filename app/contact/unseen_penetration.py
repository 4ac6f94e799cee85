"""Nodes that lie inside another body where no contact point presses: what a run must warn of."""

from __future__ import annotations

import numpy as np

from piezomat.contact.interfaces import Interfaces
from piezomat.scene.errors import shown

# Facets: nodes that are less deep than this are not worth a warning; nor are those less than this many times as deep as
# the points of their pair.
DEEP, DEEPER = 0.05, 2.0


def unseen_penetration(contact: Interfaces) -> dict[int, str]:
    """A warning by the number of each pair with such nodes at the last evaluation. Collective."""
    points: dict[int, float] = {}
    for p in contact.surface_pairs:
        number, _ = p.pair_numbers(contact.pairs)
        for pair in np.unique(number):
            deepest = float(-p.projection.gap[number == pair].min())
            points[int(pair)] = max(points.get(int(pair), 0.0), deepest)
    nodes: dict[int, tuple[float, float]] = {}
    for found in contact.penetrating_nodes():
        for pair in np.unique(found.pair):
            of = np.flatnonzero(found.pair == pair)
            deepest = of[found.depth[of].argmax()]
            this = float(found.depth[deepest]), float(found.facet_size[deepest])
            nodes[int(pair)] = max(nodes.get(int(pair), (0.0, 1.0)), this)
    every = contact.comm.allgather((points, nodes))
    warnings = {}
    for pair in sorted({pair for _, some in every for pair in some}):
        depth, size = max(some.get(pair, (0.0, 1.0)) for _, some in every)
        pressed = max(some.get(pair, 0.0) for some, _ in every)
        if depth > DEEP * size and depth > DEEPER * pressed:
            where = f"up to {depth:.2g} um ({depth / size:.2g} of a facet) inside the other body"
            warnings[pair] = (
                f"contact pair {shown(contact.pairs.name(pair))}: nodes lie {where}, where no contact point presses: "
                'take smaller facets there, or contact.method = "node"'
            )
    return warnings


def new_warnings(contact: Interfaces | None, known: set[int]) -> list[str]:
    """The warnings of pairs that are not among the `known` ones, to which they are added. Collective."""
    found = unseen_penetration(contact) if contact is not None else {}
    new = [text for pair, text in found.items() if pair not in known]
    known |= set(found)
    return new
