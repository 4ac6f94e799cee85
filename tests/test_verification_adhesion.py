"""Adhesion through the whole program against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from app.scene import Scene
from app.simulation import run
from tests import references as ref

YOUNG, STRENGTH, ENERGY, PENALTY = 1000.0, 10.0, 0.2, 1e4


def pulled(energy: float, steps: int, way: float) -> list[dict[str, float]]:
    """Two blocks of height 1 um each, free to contract sideways by nu = 0: touched, then pulled `way` um apart."""
    scene = Scene(
        geometry={"shape": "stacked_blocks", "height": [1.0, 1.0], "divisions": [[2, 2], [3, 2]]},
        mesh={"cells": "tensor"},
        materials={"soft": {"young": YOUNG, "poisson": 0.0}},
        bodies={"lower": "soft", "upper": "soft"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": [0, way], "follows": "pull"},
        ],
        contact={
            "normal_penalty": PENALTY,
            "adhesion": {"law": "bilinear", "strength": STRENGTH, "energy": energy},
        },
        load={"steps": [1, steps], "factors": {"pull": [-0.01, 1.0]}},
    )
    return run(scene, MPI.COMM_SELF).history


def test_the_bilinear_law_in_series_with_two_layers() -> None:
    """Peak strength * (c + 1/k), release at 2 energy / strength, and all of the energy is dissipated."""
    release = 2.0 * ENERGY / STRENGTH
    history = pulled(ENERGY, 110, 1.1 * release)
    way = np.array([1.1 * release * row["factor:pull"] for row in history])
    force = np.array([row["force_y@top"] for row in history])
    series = ref.SeriesBilinear(PENALTY, STRENGTH, ENERGY, 2.0 / YOUNG)
    assert series.stable
    peak = force.argmax()
    assert force[peak] == pytest.approx(STRENGTH, rel=0.01)
    assert way[peak] == pytest.approx(series.peak, rel=0.02)
    # Between peak and release the force falls along a straight line, which ends at the release.
    falling = (way > 1.1 * way[peak]) & (force > 0.05 * STRENGTH)
    slope, offset = np.polyfit(way[falling], force[falling], 1)
    assert -offset / slope == pytest.approx(release, rel=0.01)
    assert force[-1] == pytest.approx(0.0, abs=1e-6 * STRENGTH)
    assert history[-1]["dissipated"] == pytest.approx(ENERGY, rel=1e-6)
    assert history[-1]["bonded_area@lower-upper"] == 0.0
