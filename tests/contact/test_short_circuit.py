"""Electrodes that meet: one potential or an error, before the solve or when they close during the run."""

from __future__ import annotations

from typing import Any

import pytest
from mpi4py import MPI

from piezomat.forms.material_library import BUILT_IN
from piezomat.scene import Scene, SceneError
from piezomat.simulation import NotConverged, run


def layers(lower: float, upper: float, *, gap: float = 0.0, depth: bool = False, **changes: Any) -> Scene:
    """Two layers poled against each other, with electrodes on both faces: grounded outside, these voltages inside."""
    divisions = [[2, 2], [3, 2]] if not depth else [[2, 2, 1], [3, 2, 1]]
    shape = {"shape": "stacked_blocks", "height": [0.5, 0.5], "divisions": divisions, "gap": gap}
    free = ["free"] * (2 if depth else 1)
    keys: dict[str, Any] = {
        "geometry": shape | ({"depth": 1.0} if depth else {}),
        "mesh": {"cells": "tensor"},
        "materials": {"up": {"like": "pzt4"}, "down": {"like": "pzt4", "poling": [*[0] * len(free), -1]}},
        "bodies": {"lower": "up", "upper": "down"},
        "boundaries": [
            {"on": "bottom", "displacement": [*free, 0], "potential": 0},
            {"on": "left", "displacement": [0, *free]},
            {"on": "right", "displacement": [0, *free]},
            {"on": "top", "displacement": [*free, 0], "potential": 0},
            {"on": "lower_contact", "potential": lower},
            {"on": "upper_contact", "potential": upper},
        ],
        "contact": {},
        "output": {"fields": "none", "picture": False},
    }
    if depth:
        keys["boundaries"] += [{"on": side, "displacement": ["free", 0, "free"]} for side in ("front", "back")]
    return Scene(**{**keys, **changes})


@pytest.mark.mpi
@pytest.mark.parametrize("penalty", [{}, {"electric_penalty": 0}])
def test_electrodes_at_one_potential_have_the_charge_of_the_closed_form(comm: MPI.Comm, penalty: dict) -> None:
    row = run(layers(10.0, 10.0, contact=penalty), comm).history[-1]
    # The field is against the poling: both layers contract, without stress along it, and part.
    pzt4 = BUILT_IN["pzt4"]
    free = pzt4.permittivity[2, 2] + pzt4.piezo[2, 2] ** 2 / pzt4.stiffness[2, 2]
    for name in ("charge@lower_contact", "charge@upper_contact"):
        assert row[name] == pytest.approx(free * 10.0 / 0.5, rel=1e-9)
    assert row["charge@lower_contact"] == pytest.approx(0.1521, abs=5e-5)


def test_electrodes_of_their_own_at_different_potentials_may_not_touch(comm: MPI.Comm) -> None:
    """Rows [[electrodes]], against each other and against a boundary; an open one may touch any other."""
    rows = layers(0.0, 0.0).model_dump(exclude_none=True)["boundaries"]
    lower = {"name": "one", "on": ["lower_contact"], "potential": 10.0}
    upper = {"name": "other", "on": ["upper_contact"], "potential": 0.0}
    with pytest.raises(SceneError, match='"other" at 0 V in contact with "one" at 10 V') as caught:
        run(layers(0.0, 0.0, boundaries=rows[:4], electrodes=[lower, upper]), comm)
    assert caught.value.key == "electrodes[1].potential"
    with pytest.raises(SceneError, match='"one" at 10 V in contact with "upper_contact" at 0 V') as caught:
        run(layers(0.0, 0.0, boundaries=[*rows[:4], rows[5]], electrodes=[lower]), comm)
    assert caught.value.key == "electrodes[0].potential"
    touching = run(
        layers(0.0, 0.0, boundaries=rows[:4], electrodes=[lower, {"name": "other", "on": ["upper_contact"]}]), comm
    )
    assert 5.0 < touching.history[-1]["voltage@other"] <= 10.0


@pytest.mark.mpi
@pytest.mark.parametrize("depth", [False, True])
@pytest.mark.parametrize("method", ["point", "node", "segment"])
def test_electrodes_at_different_potentials_may_not_touch(comm: MPI.Comm, depth: bool, method: str) -> None:
    with pytest.raises(SceneError, match='"upper_contact" at 0 V in contact with "lower_contact" at 10 V') as caught:
        run(layers(10.0, 0.0, depth=depth, contact={"method": method}), comm)
    assert caught.value.key == "boundaries[5].potential"


def test_insulated_electrodes_may_touch_and_no_charge_passes() -> None:
    row = run(layers(10.0, 0.0, contact={"electric_penalty": 0}), MPI.COMM_SELF).history[-1]
    assert row["charge@lower_contact"] == pytest.approx(-row["charge@bottom"], rel=1e-9)
    assert abs(row["charge@upper_contact"] + row["charge@top"]) < 1e-9 * abs(row["charge@bottom"])


@pytest.mark.mpi
def test_electrodes_that_close_during_the_run_end_it(comm: MPI.Comm) -> None:
    rows = [row.model_dump(exclude_none=True) for row in layers(10.0, 0.0).boundaries]
    rows[3] = {"on": "top", "displacement": ["free", -0.15], "potential": 0, "follows": "press"}
    closing = layers(10.0, 0.0, gap=0.1, boundaries=rows, load={"steps": [4], "factors": {"press": [1.0]}})
    words = r'in step \d "lower_contact" at 10 V and "upper_contact" at 0 V have come into contact, a short circuit'
    with pytest.raises(NotConverged, match=words) as caught:
        run(closing, comm)
    assert "steps 1 to" in str(caught.value)


@pytest.mark.mpi
@pytest.mark.parametrize("voltage", [0.0, 3.0])
def test_a_plane_that_meets_an_electrode(comm: MPI.Comm, voltage: float) -> None:
    planes = [{"name": "lid", "point": "top", "motion": [0, -0.01], "potential": voltage}]
    scene = layers(10.0, 10.0, planes=planes)
    if voltage:
        with pytest.raises(SceneError, match='"lid" at 3 V in contact with "top" at 0 V') as caught:
            run(scene, comm)
        assert caught.value.key == "planes[0].potential"
    else:
        assert run(scene, comm).history


@pytest.mark.mpi
def test_electrodes_that_floating_metal_joins_are_a_short_circuit(comm: MPI.Comm) -> None:
    """A conductor between two others: alone it takes up the potential of either, together they are one circuit."""

    def metals(upper: float, gap: float, **changes: Any) -> Scene:
        geometry = {"shape": "stacked_blocks", "height": [0.5] * 3, "gap": gap, "divisions": [[2, 2], [3, 2], [2, 2]]}
        keys: dict[str, Any] = {
            "geometry": geometry,
            "mesh": {"cells": "tensor"},
            "materials": {"steel": {"young": 2e5, "poisson": 0.3, "conductor": True}},
            "bodies": {"*": "steel"},
            "boundaries": [
                {"on": "bottom", "displacement": [0, 0], "potential": 0},
                {"on": "block_2_left", "displacement": [0, "free"]},
                {"on": "block_2_right", "displacement": [0, "free"]},
                {"on": "top", "displacement": [0, 0], "potential": upper},
            ],
            "contact": {},
            "output": {"fields": "none", "picture": False},
        }
        return Scene(**{**keys, **changes})

    words = '"top" at 10 V in contact with "bottom" at 0 V by way of other metal'
    with pytest.raises(SceneError, match=words) as caught:
        run(metals(10.0, 0.0), comm)
    assert caught.value.key == "boundaries[3].potential"
    assert run(metals(0.0, 0.0), comm).history
    rows = metals(10.0, 0.01).model_dump(exclude_none=True)["boundaries"]
    rows[3] |= {"displacement": [0, -0.05], "potential": 10.0, "follows": "press"}
    load = {"steps": [5], "factors": {"press": [1.0]}}
    with pytest.raises(NotConverged, match="have come into contact by way of other metal, a short circuit"):
        run(metals(10.0, 0.01, boundaries=rows, load=load), comm)
