"""Time of contact search and pairing alone over the number of fibers, and its growth exponent.

    .venv/bin/python scripts/study_search.py 100 1000 10000

Plies of ten crossed fibers of 1 um, 80 facets each, lie on each other with a hundredth of a micrometre between them.
Every facet's centre looks for the facet of another fiber that it meets, as at the start of a load step.
"""

from __future__ import annotations

import sys
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from time import process_time

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent.parent))

from forms.contact.facets import facet_kind
from meshes.crowd import Meetings, Rule, VisibleFacets, share_facets
from meshes.pairing import closest_facets, may_touch, near_points, point_normals

Array = NDArray[np.float64]

RADIUS, SPACING, GAP, MARGIN = 0.5, 2.0, 0.01, 0.3
A_PLY, AROUND, ALONG = 10, 8, 10


def facets_of_plies(count: int) -> Array:
    """Nodes (facets, 4, 3) of the lateral surfaces of `count` fibers, in plies turned by 90 degrees."""
    length = SPACING * A_PLY
    angle = np.linspace(0.0, 2.0 * np.pi, AROUND + 1) + np.pi / AROUND
    along = np.linspace(0.0, length, ALONG + 1)
    s, a = np.meshgrid(along, angle, indexing="ij")
    height = RADIUS * np.cos(np.pi / AROUND)  # flat sides lie on each other
    tube = np.stack([s, RADIUS * np.cos(a), RADIUS * np.sin(a)], axis=-1)
    corners = [tube[:-1, :-1], tube[:-1, 1:], tube[1:, :-1], tube[1:, 1:]]
    one = np.stack([corner.reshape(-1, 3) for corner in corners], axis=1)
    ply, place = np.divmod(np.arange(count), A_PLY)
    moved = np.zeros((count, 3))
    moved[:, 1], moved[:, 2] = SPACING * (place + 0.5), (2.0 * height + GAP) * ply
    fibers = one + moved[:, None, None]
    turned = ply % 2 == 1
    fibers[turned] = fibers[turned][..., [1, 0, 2]]
    return fibers.reshape(-1, 4, 3)


def search(count: int) -> tuple[float, int]:
    """Processor time (s) to pair every facet's centre, and how many have found a partner."""
    kind, rule = facet_kind("quad4"), Rule(parts=count)
    nodes = facets_of_plies(count)
    fiber = np.repeat(np.arange(count), len(nodes) // count)
    clump = rule.clump(fiber, fiber)
    middle = np.full((len(nodes), 2), 0.5)
    inside = nodes.reshape(count, -1, 3).mean(axis=1)[fiber]
    raw = point_normals(kind, middle, nodes, np.ones(len(nodes)))
    sign = np.sign(np.einsum("md,md->m", raw, nodes.mean(axis=1) - inside))
    own = VisibleFacets(np.arange(nodes[..., 0].size).reshape(-1, 4), sign, np.arange(len(nodes)), clump, nodes[:, :0])
    began = process_time()
    visible = share_facets(MPI.COMM_SELF, nodes, clump, own, nodes, MARGIN, rule)
    facets, points, normals = nodes[visible.key], nodes.mean(axis=1), raw * sign[:, None]
    found = 0
    meetings = Meetings.near(points, clump, facets, visible.clump, MARGIN, rule)
    for rows, theirs in zip(meetings.points, meetings.facets, strict=True):
        near = rows[near_points(points[rows], facets[theirs], MARGIN)]
        facing = visible.orientation[theirs]
        near = near[may_touch(kind, points[near], normals[near], facets[theirs], facing, MARGIN)]
        given = points[near], normals[near], facets[theirs], facing, visible.key[theirs]
        met, _ = closest_facets(kind, *given, MARGIN)
        found += int((met >= 0).sum())
    return process_time() - began, found


def main() -> None:
    """Print a line a number of fibers, and the exponent of growth between the first and the last."""
    counts = [int(word) for word in sys.argv[1:]] or [100, 1000, 10000]
    times = []
    for count in counts:
        seconds, found = search(count)
        times.append(seconds)
        memory = getrusage(RUSAGE_SELF).ru_maxrss / 1024
        print(
            f"{count:6d} fibers  {seconds:8.2f} s  {found:7d} points met a facet  {memory:6.0f} MB at most", flush=True
        )
    if len(counts) > 1:
        exponent = np.log(times[-1] / times[0]) / np.log(counts[-1] / counts[0])
        print(f"growth exponent {exponent:.2f}")


if __name__ == "__main__":
    main()
