"""Conductors: bodies of metal, of one potential each, in dielectrics and in contact."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from mpi4py import MPI

from piezomat.scene import Scene, SceneError
from piezomat.simulation import plan, run
from tests.histories import assert_equal
from tests.scenes import press

EPSILON_0 = 8.8541878128e-6  # pC/(V um)
EXACT = 1e-8
SOLVERS: dict[str, dict[str, Any]] = {
    "direct": {},
    "iterative": {"kind": "iterative", "petsc": {"ksp_rtol": 1e-12}},
}
HELD = [{"on": side, "displacement": [0.0, 0.0]} for side in ("bottom", "top")]
# Capacitances of the outer layers, 1 and 2 um thick, of 1 um2: 2D, per um of depth.
ONE, OTHER = 12.0 * EPSILON_0, 1.5 * EPSILON_0


def layers(*materials: str, **changes: Any) -> Scene:
    """Layers that share nodes, 1, 0.5, 2 and perhaps 0.5 um thick, held at the bottom and at the top."""
    heights = [1.0, 0.5, 2.0, 0.5][: len(materials)]
    keys: dict[str, Any] = {
        "mesh": {"cells": "tensor"},
        "materials": {
            "twelve": {"young": 1000.0, "poisson": 0.3, "permittivity": 12.0 * EPSILON_0},
            "three": {"young": 1000.0, "poisson": 0.3, "permittivity": 3.0 * EPSILON_0},
            "steel": {"young": 2e5, "poisson": 0.3, "conductor": True},
            "copper": {"like": "elastic", "young": 1e5, "conductor": True},
        },
        "bodies": {f"layer_{i}": name for i, name in enumerate(materials, start=1)},
        "boundaries": [
            HELD[0] | {"potential": 0.0},
            HELD[1] | {"potential": 10.0},
        ],
    }
    geometry = {"shape": "cantilever", "length": 1.0, "layers": heights, "divisions": [3, 2 * sum(map(int, heights))]}
    return press(geometry, **{**keys, **changes})


def last(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> dict[str, Any]:
    """The last row of the history of a run."""
    return run(scene, comm).history[-1]


@pytest.mark.mpi
@pytest.mark.parametrize("kinematics", ["small", "finite"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_floating_conductor_between_dielectrics(solver: str, kinematics: str) -> None:
    """Two capacitors in series, whatever the thickness of the metal; named as an electrode it has columns."""
    keys = {"solver": SOLVERS[solver], "model": {"kinematics": kinematics}}
    scene = layers("twelve", "steel", "three", **keys)
    charge = 10.0 * ONE * OTHER / (ONE + OTHER)
    row = last(scene)
    assert row["charge@top"] == pytest.approx(charge, rel=EXACT)
    assert row["charge@bottom"] == pytest.approx(-charge, rel=EXACT)
    for on in (["layer_2"], ["interface_1"], ["interface_2", "layer_2"]):
        row = last(layers("twelve", "steel", "three", electrodes=[{"name": "metal", "on": on}], **keys))
        assert row["voltage@metal"] == pytest.approx(10.0 * OTHER / (ONE + OTHER), rel=EXACT)
        assert row["charge@metal"] == pytest.approx(0.0, abs=EXACT * charge)
        assert row["charge@top"] == pytest.approx(charge, rel=EXACT)


def test_charge_and_capacitance_of_a_conductor() -> None:
    boundaries = [HELD[0] | {"potential": 0.0}, HELD[1]]
    ends = [{"name": "metal", "on": ["layer_2"], "charge": 5e-5}, {"name": "lid", "on": ["top"]}]
    row = last(layers("twelve", "steel", "three", boundaries=boundaries, electrodes=ends))
    assert row["voltage@metal"] == pytest.approx(5e-5 / ONE, rel=EXACT)
    assert row["voltage@lid"] == pytest.approx(5e-5 / ONE, rel=EXACT)
    ends = [{"name": "ground", "on": ["bottom"], "potential": 0.0}, {"name": "lid", "on": ["top"]}]
    row = last(layers("twelve", "steel", "three", boundaries=HELD, electrodes=ends))
    assert row["capacitance"] == pytest.approx(ONE * OTHER / (ONE + OTHER), rel=1e-6)


@pytest.mark.mpi
def test_plates_of_metal_at_given_potentials() -> None:
    """A potential on the outer face of a plate is that of the plate, its charge the one on the dielectric."""
    boundaries = [HELD[0] | {"potential": 1.0}, HELD[1] | {"potential": 9.0, "follows": "on"}]
    load = {"steps": [1], "factors": {"on": [2.0]}}
    row = last(layers("steel", "twelve", "copper", boundaries=boundaries, load=load))
    charge = 17.0 * 12.0 * EPSILON_0 / 0.5
    assert row["mean_potential@top"] == pytest.approx(18.0, rel=EXACT)
    assert row["mean_potential@bottom"] == pytest.approx(1.0, rel=EXACT)
    assert row["charge@top"] == pytest.approx(charge, rel=EXACT)
    assert row["charge@bottom"] == pytest.approx(-charge, rel=EXACT)


@pytest.mark.mpi
def test_conductors_that_share_nodes_are_one() -> None:
    """The potential of the lower of two metals is that of the upper one, which touches the dielectric."""
    boundaries = [HELD[0] | {"potential": 0.0}, HELD[1] | {"potential": 7.0}]
    row = last(layers("three", "twelve", "steel", "copper", boundaries=boundaries))
    series = 1.0 / (1.0 / (3.0 * EPSILON_0) + 0.5 / (12.0 * EPSILON_0))
    assert row["charge@top"] == pytest.approx(7.0 * series, rel=EXACT)


def test_a_conductor_that_touches_nothing_stays_regular() -> None:
    """Far from the other body and held by nothing: no potential and no charge, not a singular matrix."""
    scene = press(
        {"shape": "stacked_blocks", "height": [1.0, 1.0], "gap": 5.0, "divisions": [[2, 2], [3, 3]]},
        mesh={"cells": "tensor"},
        materials={"steel": {"young": 2e5, "poisson": 0.3, "conductor": True}},
        bodies={"lower": "pvdf", "upper": "steel"},
        boundaries=[{"on": "bottom", "displacement": [0, 0], "potential": 0}, {"on": "top", "displacement": [0, -0.1]}],
        electrodes=[{"name": "metal", "on": ["upper"]}],
        contact={},
    )
    row = last(scene)
    assert row["voltage@metal"] == pytest.approx(0.0, abs=1e-12)
    assert row["charge@metal"] == pytest.approx(0.0, abs=1e-15)


@pytest.mark.mpi
def test_metal_on_a_piezoelectric_block_in_contact() -> None:
    """A metal block pressed on a short block: the open voltage of a piezoelectric body under a metal one, all ranks."""
    scene = press(
        {"shape": "stacked_blocks", "height": [1.0, 0.5], "divisions": [[4, 4], [4, 2]]},
        mesh={"cells": "tensor"},
        materials={"steel": {"young": 2e5, "poisson": 0.3, "conductor": True}},
        bodies={"lower": "pvdf", "upper": "steel"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0], "potential": 0},
            {"on": "top", "displacement": [0, -0.02], "follows": "press"},
        ],
        electrodes=[{"name": "metal", "on": ["upper"]}],
        contact={},
        load={"steps": [2], "factors": {"press": [1.0]}},
        solver={"tolerance": 1e-11},
    )
    history = run(scene, MPI.COMM_WORLD).history
    row = history[-1]
    assert abs(row["voltage@metal"]) > 1.0
    assert row["mean_potential@top"] == pytest.approx(row["voltage@metal"], rel=1e-12)
    assert abs(row["charge@metal"]) < 1e-8 * row["electric"] / abs(row["voltage@metal"])
    assert_equal(history, run(scene, MPI.COMM_SELF).history)


@pytest.mark.mpi
def test_resumed_runs_keep_the_potential_of_a_conductor(tmp_path_factory: pytest.TempPathFactory) -> None:
    comm = MPI.COMM_WORLD
    folder = Path(comm.bcast(str(tmp_path_factory.mktemp("resumed")) if comm.rank == 0 else None))
    boundaries = [HELD[0] | {"potential": 0.0}, HELD[1] | {"potential": 10.0, "follows": "on"}]
    load = {"steps": [2, 2], "factors": {"on": [0.5, 1.0]}}
    keys = layers("twelve", "steel", "three", boundaries=boundaries, load=load).model_dump(exclude_none=True)
    whole = run(Scene(**keys), comm).history
    run(Scene(**keys | {"load": {"steps": [2], "factors": {"on": [0.5]}}}), comm, folder / "run")
    assert_equal(run(Scene(**keys), comm, folder / "run", resume=True).history, whole)


def test_the_plan_names_conductors() -> None:
    scene = layers("twelve", "steel", "three")
    assert "layer_2 (open, no net charge)" in plan(scene, MPI.COMM_SELF).replace('"', "")


# --- Errors before any work


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"young": 1.0, "poisson": 0.3, "permittivity": 1e-4}, r"permittivity: found 0.0001; allowed: nothing with"),
        ({"young": 1.0, "poisson": 0.3, "piezo": {"e31": 0, "e32": 0, "e33": 1}}, r"piezo: .*nothing with conductor"),
        ({"like": "pvdf"}, r'like: found "pvdf"; allowed: a material without permittivity'),
    ],
)
def test_materials_that_cannot_be(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        layers("m", "m", materials={"m": {**keys, "conductor": True}})


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("materials", "changes", "message"),
    [
        (
            ("steel", "copper"),
            {},
            r"boundaries\[1\].potential: found another potential than boundaries\[0\] of the conductor",
        ),
        (
            ("twelve", "steel", "three"),
            {"electrodes": [{"name": "a", "on": ["interface_1"]}, {"name": "b", "on": ["interface_2"]}]},
            r'electrodes\[1\].on: found "b", which has .* nodes in common with "a"; .* or touch one conductor',
        ),
        (
            ("twelve", "steel"),
            {"electrodes": [{"name": "a", "on": ["interface_1"]}]},
            r'electrodes\[0\].on: found "a", of which .* nodes have the potential of boundaries\[1\] on "top"',
        ),
        (
            ("twelve", "elastic"),
            {},
            r'boundaries\[1\].potential: found 10.0 on "top", where no body has a permittivity; .* is a conductor',
        ),
    ],
)
def test_conductors_that_cannot_be(materials: tuple[str, ...], changes: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        run(layers(*materials, **changes), MPI.COMM_WORLD)
