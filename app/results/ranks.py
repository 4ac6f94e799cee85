"""Load of each rank: unknowns, contact points that it evaluates, memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mpi4py import MPI

from piezomat.contact.interfaces import Interfaces
from piezomat.discretization.model import Model
from piezomat.usage import peak_memory_mb


def load_per_rank(model: Model, contact: Interfaces | None) -> dict[str, list[int]]:
    """`dofs`, `contact_points` and `memory_mb`, each with a number for each rank. Collective.

    contact_points: those near another body or a plane at the last search. memory_mb: the peak.
    """
    here = {
        "dofs": model.unknowns.owned * model.unknowns.block,
        "contact_points": 0 if contact is None else sum(len(p.near_points) for p in contact.point_sets),
        "memory_mb": round(peak_memory_mb(MPI.COMM_SELF)),
    }
    everywhere = model.comm.allgather(here)
    return {name: [rank[name] for rank in everywhere] for name in here}


def described(loads: Mapping[str, Sequence[int]]) -> str:
    """The loads in words, and by how much the largest exceeds the mean."""
    words = []
    for name, unit in (("dofs", "unknowns"), ("contact_points", "contact points"), ("memory_mb", "MB")):
        values = loads[name]
        excess = max(values) * len(values) / max(sum(values), 1) - 1.0
        words.append(f"{' '.join(map(str, values))} {unit} (at most {100.0 * excess:.0f} % over the mean)")
    return "a rank: " + ", ".join(words)
