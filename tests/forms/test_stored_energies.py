"""Energy: what goes in is stored, dissipated or reported as stabilization."""

from __future__ import annotations

import pytest
from mpi4py import MPI

from piezomat.scene import Scene
from piezomat.simulation import run

STORED = ("elastic", "electric", "contact", "adhesion", "dissipated", "stabilization")


def test_balance_over_a_cycle_of_pressing_and_pulling() -> None:
    """Two half discs pressed, then pulled until all bonds are broken, in small steps without a snap."""
    scene = Scene(
        geometry={"shape": "facing_halves"},
        mesh={"size": 0.15, "contact_size": 0.04},
        bodies={"lower": "pvdf", "upper": "pvdf"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0], "potential": 0},
            {"on": "top", "displacement": [0, -0.02], "follows": "press"},
        ],
        contact={"adhesion": {"law": "bilinear", "strength": 20.0, "energy": 0.3}},
        load={"steps": [30, 80], "factors": {"press": [1.0, -1.6]}},
    )
    history = run(scene, MPI.COMM_SELF).history
    most = max(row["external_work"] for row in history)
    for row in history:
        assert sum(row[name] for name in STORED) == pytest.approx(row["external_work"], abs=1e-3 * most)
        assert row["stabilization"] < 1e-4 * most
    assert history[-1]["bonded_area@lower-upper"] == 0.0
    assert history[-1]["dissipated"] > 0.05 * most


def test_a_body_held_by_contact_alone_costs_next_to_nothing() -> None:
    """The middle one of three stacked blocks: its springs take less than 0.01 % of the energy.

    A column of discs would buckle, as nothing but friction could hold them.
    """
    scene = Scene(
        geometry={"shape": "stacked_blocks", "height": [0.4, 0.5, 0.4], "divisions": [[5, 2], [4, 2], [7, 2]]},
        bodies={f"block_{i}": "pvdf" for i in (1, 2, 3)},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0], "potential": 0},
            {"on": "top", "displacement": [0, -0.04], "follows": "press"},
        ],
        contact={},
        load={"steps": [6], "factors": {"press": [1.0]}},
    )
    last = run(scene, MPI.COMM_SELF).history[-1]
    below, above = last["contact_force_y@block_1-block_2"], last["contact_force_y@block_2-block_3"]
    assert 0.0 < last["stabilization"] < 1e-4 * last["elastic"]
    assert below == pytest.approx(above, rel=1e-4) and below < -0.1
