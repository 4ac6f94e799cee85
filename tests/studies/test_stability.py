"""scripts/stability: cells of a map, and the force on half discs, with contact elements and without."""

from __future__ import annotations

import math

import pytest
from mpi4py import MPI

from piezomat.simulation import run
from scripts.studies import tables
from scripts.studies.stability import run_cell
from scripts.studies.stability_maps import FORCES, MODULUS, POISSON, RADIUS, RELATIVE, YOUNG
from scripts.studies.stability_methods import METHODS
from scripts.studies.stability_reference import force
from scripts.studies.two_fibers import ROOT
from tests.scenes import press
from tests.verification.references import hertz_line

FACET = 2.0 * math.pi * RADIUS / 384


@pytest.mark.parametrize("kinematics", ["small", "finite"])
@pytest.mark.parametrize("order", [1, 2])
def test_two_half_discs_press_as_one_on_a_rigid_plane(order: int, kinematics: str) -> None:
    """Contact of two meshes and nodal displacements bounded by the plane between them: 0.5 % apart at most."""
    pressed = press(
        {"shape": "facing_halves", "radius": RADIUS},
        mesh={"size": 0.04, "contact_size": order * FACET, "order": order},
        model={"kinematics": kinematics},
        bodies={"lower": "elastic", "upper": "elastic"},
        boundaries=[{"on": "bottom", "displacement": [0, 0]}, {"on": "top", "displacement": [0, -0.02]}],
        contact={"method": "segment", "normal_penalty_factor": 300.0},
    )
    found = -run(pressed, MPI.COMM_SELF).history[-1]["force_y@top"]
    assert found == pytest.approx(force(0.02, order * FACET, order, kinematics), rel=5e-3)
    assert found == pytest.approx(FORCES[kinematics, 0.02], rel=1.5e-2)


@pytest.mark.parametrize("approach", [0.005, 0.02])
def test_reference_forces_are_near_hertz(approach: float) -> None:
    """Half spaces to the depth of the flat faces (Johnson, section 5.6) are stiffer than half discs, by 5 to 9 %."""
    load = FORCES["small", approach]
    depth = 2.0 * math.log(2.0 * RADIUS / hertz_line(load, RELATIVE, MODULUS).size) - POISSON / (1.0 - POISSON)
    assert 0.90 < 2.0 * load * (1.0 - POISSON**2) / (math.pi * YOUNG) * depth / approach < 0.96


@pytest.mark.parametrize("method", ["paper", "point"])
def test_a_cell_is_what_the_map_shows(method: str) -> None:
    """The sign of the electric term as the paper prints it (column `paper`) leads to another error than ours."""
    table = tables.rows(ROOT / "scripts" / "studies" / "maps" / "coupling.csv")
    cell = {"method": method, "x": "5", "y": "10.0"}
    (expected,) = (row for row in table if cell.items() <= row.items())
    column = [m.name for m in METHODS].index(method)
    found = run_cell(("coupling", column, 5, 10.0))
    assert found["outcome"] == expected["outcome"]
    assert float(found["error"]) == pytest.approx(float(expected["error"]), rel=2e-2)
