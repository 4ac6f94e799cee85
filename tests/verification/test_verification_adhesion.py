"""Adhesion through the whole program against closed forms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.scene import Scene
from piezomat.simulation import run
from tests.scenes import half_of_facing_halves, press, rollers
from tests.verification import references as ref

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


# --- Two fibers: the Maugis-Dugdale cylinder of Baney and Hui -------------------------------------

RADIUS, POISSON = 0.5, 0.3
MODULUS = ref.contact_modulus((YOUNG, POISSON), (YOUNG, POISSON))
RELATIVE = ref.relative_radius(RADIUS, RADIUS)
LENGTH = 0.04 * RADIUS  # unit of lengths: small against the fibers, which the theory takes for half spaces
WORK = np.pi * MODULUS * (0.5 * LENGTH) ** 3 / RELATIVE**2  # of adhesion: that which makes LENGTH the unit
FORCE = (np.pi * MODULUS * WORK**2 * RELATIVE) ** (1.0 / 3.0)  # unit of loads


def hertz_approach(half_width: float) -> float:
    """How far two flat faces at a distance RADIUS from a Hertzian line contact come together, nearly."""
    load = np.pi * MODULUS * half_width**2 / (4.0 * RELATIVE)
    depth = 2.0 * np.log(2.0 * RADIUS / half_width) - POISSON / (1.0 - POISSON)
    return 2.0 * load * (1.0 - POISSON**2) / (np.pi * YOUNG) * depth


@pytest.mark.slow
@pytest.mark.parametrize(("parameter", "facet"), [(0.5, 0.06), (1.0, 0.04)])
def test_two_fibers_pull_off_as_baney_and_hui_say(tmp_path: Path, parameter: float, facet: float) -> None:
    """The strongest pull of two parallel fibers whose bonds carry a constant stress up to a cut-off.

    Pressed first, further than bonds will reach, then pulled with the flat faces' displacement prescribed. Facets (in
    LENGTH) are at most a 25th of the cohesive zone, which is 1.8 and 1.0 wide at pull-off. At 1.5 it is 0.6 wide, at
    2.0 0.4, and bonds snap one facet after the other: five and 25 times the work, errors of 0.5 and 0.4 %.
    """
    half_of_facing_halves(tmp_path / "m.msh", size=facet * LENGTH, radius=RADIUS, near=2.7 * LENGTH, growth=0.25)
    scene = press(
        {"file": tmp_path / "m.msh"},
        materials={"fiber": {"young": YOUNG, "poisson": POISSON}},
        bodies={"lower": "fiber", "upper": "fiber"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": [0, -hertz_approach(2.4 * LENGTH)], "follows": "press"},
            *rollers({"axis": 0}, 2),
        ],
        contact={
            "pairs": [["lower_contact", "upper_contact"]],
            "normal_penalty_factor": 20,
            "adhesion": {
                "law": "cutoff",
                "strength": ref.maugis_strength(parameter, WORK, RELATIVE, MODULUS),
                "energy": WORK,
            },
        },
        load={"steps": [5, 10, 40], "factors": {"press": [1.0, 0.1, -0.4]}},
    )
    history = run(scene, MPI.COMM_SELF).history
    pull = 2.0 * np.array([row["force_y@top"] for row in history]) / FORCE
    assert pull.max() == pytest.approx(ref.maugis_pull_off(parameter), rel=0.03)
    # Afterwards nothing holds them any more.
    assert abs(pull[-1]) < 1e-6 and history[-1]["bonded_area@lower_contact-upper_contact"] == 0.0
