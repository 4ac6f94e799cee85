"""Layers in contact, the contact patch test and the bimorph, through the whole program."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.results.fields import FieldOutput
from piezomat.scene import Scene
from piezomat.simulation import run
from tests.scenes import along, press, rollers
from tests.verification.references import (
    NODE_PATCH_ERRORS,
    PVDF,
    PVDF_TZOU,
    bimorph_deflection,
    contact_patch_stress,
)

# --- Two layers in contact ------------------------------------------------------------------------

SHORTENING, VOLTAGE = 0.001, 1.0
# REFERENCES.md, for penalties r C33/H and r eps/H: gap, potential jump, T33, D3.
STACK = {
    1000: (-5.108858e-7, 1.471664e-4, -1.719327, -1.563647e-5),
    100: (-5.085834e-6, 1.481141e-3, -1.711579, -1.573716e-5),
    10: (-4.866367e-5, 1.564143e-2, -1.637720, -1.661906e-5),
}
BONDED = (-1.7201923, -1.5625127e-5)


def layers(geometry: dict[str, Any], bodies: tuple[str, str], fixed: dict[str, int], **sections: Any) -> Scene:
    """Two layers of PVDF, 1 um each, poled upwards, fixed laterally, shortened and under a voltage."""
    dim = 1 + len(set(fixed.values()))
    rows = [
        {"on": "bottom", "displacement": along(0, dim), "potential": 0},
        {"on": "top", "displacement": along(-SHORTENING, dim), "potential": VOLTAGE},
        *rollers(fixed, dim),
    ]
    return press(geometry, bodies=dict.fromkeys(bodies, "pvdf"), boundaries=rows, **sections)


def stack(cells: str, order: int, divisions: list[list[int]], r: float, **contact: Any) -> Scene:
    """The layers as two bodies that touch, with penalties r times those of a layer."""
    geometry = {"shape": "stacked_blocks", "width": 1, "height": [1, 1], "divisions": divisions}
    fixed = {"left": 0, "right": 0}
    if len(divisions[0]) == 3:
        geometry["depth"] = 1
        fixed |= {"front": 1, "back": 1}
    penalties = {"normal_penalty": r * PVDF.stiffness[2, 2], "electric_penalty": r * PVDF.permittivity}
    penalties["electric_range"] = 1e-8  # less than any penetration: the whole penalty acts
    return layers(
        geometry, ("lower", "upper"), fixed, mesh={"cells": cells, "order": order}, contact=penalties | contact
    )


def state(row: dict[str, Any], dim: int, pair: str) -> tuple[float, ...]:
    """Gap, jump, T33 and D3 of a history row of the stack, one um2 (um) wide."""
    stress = row[f"force_{'xyz'[dim - 1]}@top"]
    return -row[f"max_penetration@{pair}"], row[f"max_potential_jump@{pair}"], stress, -row["charge@top"]


def check_stack(
    comm: MPI.Comm,
    r: int,
    cells: str,
    order: int,
    divisions: list[list[int]],
    pair: str = "lower-upper",
    **contact: Any,
) -> None:
    """Fail unless the stack with penalties r is in the state of the reference. Collective."""
    scene = stack(cells, order, divisions, r, **contact)
    row = run(scene, comm).history[-1]
    np.testing.assert_allclose(state(row, scene.dimension, pair), STACK[r], rtol=1e-5)


# Each pair of cells, order and dimension with each method, number of passes and penalty: not all of their product.
@pytest.mark.mpi
@pytest.mark.parametrize(
    ("cells", "order", "divisions", "method", "passes", "r"),
    [
        ("tensor", 1, [[3, 2], [3, 1]], "node", 1, 10),
        ("tensor", 1, [[3, 2], [3, 1]], "point", 2, 1000),
        ("tensor", 2, [[2, 1], [2, 2]], "node", 2, 100),
        ("tensor", 2, [[2, 1], [2, 2]], "point", 1, 10),
        ("simplex", 1, [[3, 1], [3, 3]], "point", 1, 100),
        ("simplex", 1, [[3, 1], [3, 3]], "node", 2, 1000),
        ("simplex", 2, [[2, 2], [2, 1]], "node", 1, 1000),
        ("simplex", 2, [[2, 2], [2, 1]], "point", 2, 100),
        ("tensor", 1, [[2, 3, 2], [2, 3, 1]], "node", 2, 100),
        ("tensor", 1, [[2, 3, 2], [2, 3, 1]], "point", 1, 1000),
        ("tensor", 2, [[1, 2, 1], [1, 2, 2]], "node", 1, 1000),
        ("tensor", 2, [[1, 2, 1], [1, 2, 2]], "point", 2, 10),
        ("simplex", 1, [[2, 2, 1], [2, 2, 2]], "node", 1, 100),
        ("simplex", 1, [[2, 2, 1], [2, 2, 2]], "point", 2, 10),
        ("simplex", 2, [[1, 2, 1], [1, 2, 1]], "node", 2, 10),
        ("simplex", 2, [[1, 2, 1], [1, 2, 1]], "point", 1, 100),
    ],
)
def test_a_stack_of_two_layers_is_exact_where_nodes_meet(
    comm: MPI.Comm, cells: str, order: int, divisions: list[list[int]], method: str, passes: int, r: int
) -> None:
    check_stack(comm, r, cells, order, divisions, method=method, passes=passes)


@pytest.mark.parametrize("method", ["node", "point"])
@pytest.mark.parametrize(
    ("cells", "order", "divisions", "r"),
    [
        ("tensor", 1, [[4, 1], [2, 2]], 10),
        ("simplex", 2, [[4, 1], [2, 1]], 1000),
        ("tensor", 2, [[2, 2, 1], [1, 1, 1]], 100),
        ("simplex", 1, [[2, 2, 1], [1, 1, 1]], 1000),
    ],
)
def test_a_stack_is_exact_in_one_pass_where_each_slave_facet_lies_on_one_master_facet(
    comm: MPI.Comm, cells: str, order: int, divisions: list[list[int]], r: int, method: str
) -> None:
    pair = ["lower_contact", "upper_contact"]
    check_stack(comm, r, cells, order, divisions, "-".join(pair), method=method, passes=1, pairs=[pair])


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("cells", "order", "divisions", "passes", "r"),
    [
        ("tensor", 1, [[3, 1], [2, 2]], 1, 10),
        ("tensor", 1, [[3, 1], [2, 2]], 2, 1000),
        ("simplex", 2, [[3, 1], [2, 1]], 1, 100),
        ("simplex", 2, [[3, 1], [2, 1]], 2, 10),
        ("tensor", 2, [[3, 2, 1], [2, 1, 1]], 1, 1000),
        ("tensor", 2, [[3, 2, 1], [2, 1, 1]], 2, 100),
        ("simplex", 1, [[3, 2, 1], [2, 3, 1]], 1, 100),
        ("simplex", 1, [[3, 2, 1], [2, 3, 1]], 2, 10),
    ],
)
def test_a_stack_of_segments_is_exact_whatever_the_meshes(
    comm: MPI.Comm, cells: str, order: int, divisions: list[list[int]], passes: int, r: int
) -> None:
    check_stack(comm, r, cells, order, divisions, method="segment", passes=passes)


@pytest.mark.parametrize("order", [1, 2])
def test_bonded_layers_are_the_limit_of_infinite_penalties(comm: MPI.Comm, order: int) -> None:
    fixed = {"root": 0, "tip": 0}
    geometry = {"shape": "cantilever", "length": 1, "layers": [1, 1], "divisions": [2, 2]}
    scene = layers(geometry, ("layer_1", "layer_2"), fixed, mesh={"order": order})
    row = run(scene, comm).history[-1]
    np.testing.assert_allclose([row["force_y@top"], -row["charge@top"]], BONDED, rtol=1e-7)
    # The error of a penalty falls with it: ten times stiffer, ten times nearer.
    near, far = (np.subtract(STACK[r][2:], BONDED) for r in (1000, 100))
    np.testing.assert_allclose(near, far / 10, rtol=0.02)


# --- Contact patch test ---------------------------------------------------------------------------

YOUNG, PATCH_HEIGHTS, PATCH_SHORTENING = 1e6, (0.5, 0.5), 0.01


def patch_error(lower: int, upper: int, method: str, passes: int) -> float:
    """Greatest relative error of the vertical stress in the middle of the elements.

    Crisfield's blocks 1 x 0.5 with so many elements along their sides, two rows each, clamped below and above,
    a plane of symmetry on the left, nothing on the right; the upper one is the slave in one pass.
    """
    penalty = 1e4 * YOUNG
    scene = press(
        {
            "shape": "stacked_blocks",
            "width": 1,
            "height": list(PATCH_HEIGHTS),
            "divisions": [[lower, 2], [upper, 2]],
        },
        mesh={"cells": "tensor"},
        materials={"block": {"young": YOUNG, "poisson": 0}},
        bodies={"lower": "block", "upper": "block"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": [0, -PATCH_SHORTENING]},
            *rollers({"left": 0}, 2),
        ],
        contact={
            "pairs": [["upper_contact", "lower_contact"]],
            "method": method,
            "passes": passes,
            "normal_penalty": penalty,
        },
    )
    finished = run(scene, MPI.COMM_SELF)
    stress = FieldOutput(finished.problem).piece().stress[:, 1]
    exact = contact_patch_stress(YOUNG, PATCH_HEIGHTS, PATCH_SHORTENING, penalty)
    return float(np.abs(stress / exact - 1).max())


@pytest.mark.parametrize("mesh", NODE_PATCH_ERRORS)
def test_one_pass_with_nodes_fails_the_patch_test_as_published(mesh: tuple[int, int]) -> None:
    assert patch_error(*mesh, "node", 1) == pytest.approx(NODE_PATCH_ERRORS[mesh], rel=0.012)


@pytest.mark.parametrize("mesh", NODE_PATCH_ERRORS)
@pytest.mark.parametrize("method", ["node", "point"])
def test_two_passes_nearly_pass_the_patch_test(mesh: tuple[int, int], method: str) -> None:
    assert patch_error(*mesh, method, 2) < 5e-4


@pytest.mark.parametrize("method", ["node", "point"])
@pytest.mark.parametrize("passes", [1, 2])
def test_the_patch_test_is_passed_where_nodes_meet(method: str, passes: int) -> None:
    assert patch_error(3, 3, method, passes) < 1e-8


# --- Bimorph --------------------------------------------------------------------------------------


def test_the_bimorph_bends_as_published(comm: MPI.Comm) -> None:
    scene = press(
        {"shape": "cantilever", "length": 100, "layers": [0.5, 0.5], "divisions": [100, 2]},
        mesh={"cells": "tensor", "order": 2},
        model={"plane": "stress"},
        materials={
            "up": {"like": "pvdf_tzou", "poling": [0, 1]},
            "down": {"like": "pvdf_tzou", "poling": [0, -1]},
        },
        bodies={"layer_1": "down", "layer_2": "up"},
        boundaries=[
            {"on": "root", "displacement": [0, 0]},
            {"on": "bottom", "potential": 0},
            {"on": "top", "potential": 1},
        ],
    )
    finished = run(scene, comm)
    model = finished.model
    along_middle = np.isclose(model.unknowns.coordinates[:, 1], 0.5)
    x = model.unknowns.coordinates[along_middle, 0]
    deflection = finished.state.x.array.reshape(-1, model.unknowns.block)[along_middle, 1]
    places = np.arange(20.0, 101.0, 20.0)
    measured = np.array([deflection[np.isclose(x, place)].item() for place in places])
    coupled, theory = (
        np.array([bimorph_deflection(PVDF_TZOU, place, 1.0, 1.0, coupled) for place in places])
        for coupled in (True, False)
    )
    assert measured[-1] == pytest.approx(0.344143, rel=1e-3)
    # Near the root the clamping counts more: it takes a fixed length off the beam.
    np.testing.assert_allclose(measured, coupled, rtol=1.5e-3)
    # Beam theory without the coupling's stiffening of 0.25 %, as published: .0138 .0552 .1242 .2208 .3450.
    np.testing.assert_allclose(measured, theory, rtol=4e-3)
