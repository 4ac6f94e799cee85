"""Time of the contact search alone over the number of fibers, and its growth exponent.

    .venv/bin/python scripts/studies/contact_search.py 100 1000 10000
    mpirun -n 4 .venv/bin/python -m mpi4py scripts/studies/contact_search.py 10000    fibers shared among ranks

Plies of ten crossed fibers of 1 um, 80 facets each, lie on each other with a hundredth of a micrometre between them.
Every facet's centre looks for the facet of another fiber that it meets, as at the start of a load step. Memory is the
most that a rank held so far, fibers and all, above what Python and its modules take.
"""

from __future__ import annotations

import sys
from resource import RUSAGE_SELF, getrusage
from time import process_time

import numpy as np
from mpi4py import MPI

from piezomat.forms.arrays import Array
from piezomat.forms.contact.facets import Facets, facet_kind
from piezomat.forms.contact.gap import point_normals
from piezomat.meshes.contact.facet_bounds import near_points
from piezomat.meshes.contact.global_search import CandidatePairs, GhostFacets, PairingRule, share_facets
from piezomat.meshes.contact.local_search import closest_facets

RADIUS, SPACING, GAP, MARGIN = 0.5, 2.0, 0.01, 0.3
A_PLY, AROUND, ALONG = 10, 8, 10


def facets_of_plies(first: int, last: int) -> Array:
    """Nodes (facets, 4, 3) of the lateral surfaces of fibers first to last - 1, in plies turned by 90 degrees."""
    count = last - first
    length = SPACING * A_PLY
    angle = np.linspace(0.0, 2.0 * np.pi, AROUND + 1) + np.pi / AROUND
    along = np.linspace(0.0, length, ALONG + 1)
    s, a = np.meshgrid(along, angle, indexing="ij")
    height = RADIUS * np.cos(np.pi / AROUND)  # flat sides lie on each other
    tube = np.stack([s, RADIUS * np.cos(a), RADIUS * np.sin(a)], axis=-1)
    corners = [tube[:-1, :-1], tube[:-1, 1:], tube[1:, :-1], tube[1:, 1:]]
    one = np.stack([corner.reshape(-1, 3) for corner in corners], axis=1)
    ply, place = np.divmod(np.arange(first, last), A_PLY)
    moved = np.zeros((count, 3))
    moved[:, 1], moved[:, 2] = SPACING * (place + 0.5), (2.0 * height + GAP) * ply
    fibers = one + moved[:, None, None]
    turned = ply % 2 == 1
    fibers[turned] = fibers[turned][..., [1, 0, 2]]
    return fibers.reshape(-1, 4, 3)


def search(count: int, comm: MPI.Comm) -> tuple[float, int, int]:
    """Processor time (s) to pair the centres of this rank's facets, how many found a partner, facets it must see."""
    kind, rule, each = facet_kind("quad4"), PairingRule(parts=count), AROUND * ALONG
    first, last = (count * rank // comm.size for rank in (comm.rank, comm.rank + 1))
    nodes = facets_of_plies(first, last)
    fiber = np.repeat(np.arange(first, last), each)
    component = rule.component(fiber, fiber)
    middle = np.full((len(nodes), 2), 0.5)
    inside = nodes.reshape(last - first, -1, 3).mean(axis=1)[fiber - first]
    raw = point_normals(kind, middle, nodes, np.ones(len(nodes)))
    sign = np.sign(np.einsum("md,md->m", raw, nodes.mean(axis=1) - inside))
    key = first * each + np.arange(len(nodes))
    own = GhostFacets(4 * key[:, None] + np.arange(4), sign, key, component, component, nodes[:, :0])
    began = process_time()
    visible = share_facets(comm, nodes, component, own, nodes, MARGIN, rule)
    low, high = int(visible.key.min()) // each, int(visible.key.max()) // each + 1
    facets = facets_of_plies(low, high)[visible.key - low * each]
    points, normals = nodes.mean(axis=1), raw * sign[:, None]
    found = 0
    candidates = CandidatePairs.near(points, component, facets, visible.component, MARGIN, rule)
    for rows, theirs in zip(candidates.points, candidates.facets, strict=True):
        near = rows[near_points(points[rows], facets[theirs], MARGIN)]
        masters = Facets(kind, facets[theirs], visible.orientation[theirs], visible.key[theirs])
        met, *_ = closest_facets(points[near], normals[near], masters, MARGIN)
        found += int((met >= 0).sum())
    return process_time() - began, found, len(visible)


def main() -> None:
    """Print a line a number of fibers, and the exponent of growth between the first and the last."""
    comm = MPI.COMM_WORLD
    counts = [int(word) for word in sys.argv[1:]] or [100, 1000, 10000]
    times, idle = [], getrusage(RUSAGE_SELF).ru_maxrss
    for count in counts:
        seconds, found, visible = search(count, comm)
        memory = (getrusage(RUSAGE_SELF).ru_maxrss - idle) / 1024
        seconds, visible, memory = (comm.allreduce(most, op=MPI.MAX) for most in (seconds, visible, memory))
        times.append(seconds)
        found = comm.allreduce(found)
        if comm.rank == 0:
            print(
                f"{count:6d} fibers  {seconds:8.2f} s  {found:7d} points met a facet; a rank at most: "
                f"{visible:7d} facets seen, {memory:6.0f} MB",
                flush=True,
            )
    if len(counts) > 1 and comm.rank == 0:
        exponent = np.log(times[-1] / times[0]) / np.log(counts[-1] / counts[0])
        print(f"growth exponent {exponent:.2f}")


if __name__ == "__main__":
    main()
