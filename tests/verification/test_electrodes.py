"""Electrodes: facet groups, bodies and planes at one potential each, prescribed, charged or open."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.scene import Scene, SceneError
from piezomat.simulation import run
from piezomat.solver import capacitance
from piezomat.solver.outcome import SolveError
from tests.histories import assert_equal
from tests.scenes import pressed

EPSILON_0 = 8.8541878128e-6  # pC/(V um)
EXACT = 1e-8


def last(scene: Scene, comm: MPI.Comm = MPI.COMM_WORLD) -> dict[str, Any]:
    """The last row of the history of a run."""
    return run(scene, comm).history[-1]


# --- Closed forms


def capacitor(dimension: int, electrodes: list[dict[str, Any]], boundaries: list[dict[str, Any]]) -> Scene:
    """Two plates of 1 um2, 1 and 2 um thick, with 12 and 3 times the vacuum's permittivity, and metal between them."""
    held = [0.0] * dimension
    # Facing faces of the plates are one electrode: nothing else joins the plates.
    sides = [{"on": side, "displacement": held} for side in ("bottom", "top")]
    geometry = {"shape": "stacked_blocks", "height": [1.0, 2.0]}
    divisions = [[2, 3], [3, 4]] if dimension == 2 else [[2, 1, 3], [3, 2, 4]]
    depth = {} if dimension == 2 else {"depth": 1.0}
    return Scene(
        geometry=geometry | depth | {"divisions": divisions},
        mesh={"cells": "tensor"},
        materials={
            name: {"young": 1000.0, "poisson": 0.3, "permittivity": factor * EPSILON_0}
            for name, factor in (("twelve", 12.0), ("three", 3.0))
        },
        bodies={"lower": "twelve", "upper": "three"},
        boundaries=[*sides, *boundaries],
        electrodes=[{"name": "middle", "on": ["lower_contact", "upper_contact"]}, *electrodes][::-1],
    )


@pytest.mark.mpi
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_floating_electrode_divides_the_voltage(dimension: int) -> None:
    boundaries = [{"on": "bottom", "potential": 0.0}, {"on": "top", "potential": 10.0}]
    row = last(capacitor(dimension, [], boundaries))
    one, other = 12.0 * EPSILON_0, 1.5 * EPSILON_0
    assert row["voltage@middle"] == pytest.approx(10.0 * other / (one + other), rel=EXACT)
    assert row["charge@middle"] == pytest.approx(0.0, abs=EXACT * 10.0 * other)
    assert row["charge@top"] == pytest.approx(10.0 * one * other / (one + other), rel=EXACT)


@pytest.mark.parametrize("kind", ["direct", "iterative"])
def test_charge_put_on_a_floating_electrode(kind: str) -> None:
    ends = [{"name": "lid", "on": ["top"], "potential": 10.0}, {"name": "ground", "on": ["bottom"], "potential": 0.0}]
    scene = capacitor(2, ends, [])
    charged = [row.model_dump(exclude_none=True) for row in scene.electrodes]
    charged[-1]["charge"] = 5e-5
    solver = {"kind": kind} | ({"petsc": {"ksp_rtol": 1e-12}} if kind == "iterative" else {})
    row = last(Scene(**{**scene.model_dump(exclude_none=True), "electrodes": charged, "solver": solver}))
    one, other, charge = 12.0 * EPSILON_0, 1.5 * EPSILON_0, 5e-5
    voltage = (10.0 * other + charge) / (one + other)
    assert row["voltage@middle"] == pytest.approx(voltage, rel=EXACT)
    assert row["charge@middle"] == pytest.approx(charge, rel=EXACT)
    assert row["charge@lid"] == pytest.approx(other * (10.0 - voltage), rel=EXACT)
    assert row["charge@ground"] == pytest.approx(-one * voltage, rel=EXACT)
    charged[1] = {"name": "lid", "on": ["top"]}
    row = last(Scene(**{**scene.model_dump(exclude_none=True), "electrodes": charged, "solver": solver}))
    assert row["voltage@middle"] == pytest.approx(charge / one, rel=EXACT)
    assert row["voltage@lid"] == pytest.approx(charge / one, rel=EXACT)


@pytest.mark.parametrize(
    ("material", "sides", "voltage", "charge", "capacitance"),
    [
        ("pvdf", "free", 0.3016870671, -3.3e-5, 1.093848680e-4),
        ("pvdf", 0.0, 0.2064989519, -2.228571429e-5, 1.079216823e-4),
        ("pzt5h", "free", -1.952506841e-2, 5.942131042e-4, 3.043334300e-2),
        ("pzt5h", 0.0, -1.127935060e-2, 1.991452991e-4, 1.765574155e-2),
    ],
)
def test_block_pressed_along_its_poling(
    material: str, sides: str | float, voltage: float, charge: float, capacitance: float
) -> None:
    """References: exact, computed independently; the capacitance is that at a constant force."""

    def electrodes(**lid: float) -> list[dict[str, Any]]:
        ground = {"name": "ground", "on": ["bottom"], "potential": 0.0}
        return [ground, {"name": "lid", "on": ["top"], **lid}]

    def block(**lid: float) -> Scene:
        rows = [
            {"on": "bottom", "displacement": ["free", "free", 0.0]},
            {"on": "root", "displacement": [0.0, "free", "free"]},
            {"on": "front", "displacement": ["free", 0.0, "free"]},
            {"on": "top", "traction": [0.0, 0.0, -1.0]},
        ]
        if sides != "free":
            rows += [{"on": "tip", "displacement": [sides, "free", "free"]}]
            rows += [{"on": "back", "displacement": ["free", sides, "free"]}]
        return Scene(
            geometry={"shape": "cantilever", "length": 1.0, "layers": [0.5, 0.5], "width": 1.0, "divisions": [2, 1, 2]},
            bodies={"layer_*": material},
            boundaries=rows,
            electrodes=electrodes(**lid),
        )

    isolated, short = last(block()), last(block(potential=0.0))
    assert isolated["voltage@lid"] == pytest.approx(voltage, rel=1e-8)
    assert short["charge@lid"] == pytest.approx(charge, rel=1e-8)
    for row in (isolated, short):
        assert row["capacitance"] == pytest.approx(capacitance, rel=1e-8)


# --- The same as what is known


def electrode_scene(dimension: int, **changes: Any) -> Scene:
    """Two half fibers pressed together, the upper flat face one electrode."""
    return pressed(dimension, electrodes=[{"name": "lid", "on": ["top"]}], **changes)


SOLVERS: dict[str, dict[str, Any]] = {
    "condensed": {},
    "factorized": {"petsc": {"pc_type": "lu"}},
    "multigrid": {"kind": "iterative", "petsc": {"ksp_rtol": 1e-12}},
}


@pytest.mark.parametrize(("dimension", "solver"), [(2, "condensed"), (2, "factorized"), (3, "multigrid")])
def test_an_electrode_at_a_potential_is_a_boundary_at_it(dimension: int, solver: str) -> None:
    keys = {"solver": {"tolerance": 1e-10, **SOLVERS[solver]}}
    rows = pressed(dimension).model_dump(exclude_none=True)["boundaries"]
    rows[1] = rows[1] | {"potential": 5.0, "displacement": [0.0] * (dimension - 1) + [-0.04]}
    rows[0] = rows[0] | {"displacement": [0.0] * dimension}
    boundary = run(pressed(dimension, boundaries=rows, **keys), MPI.COMM_WORLD).history
    given = {"name": "lid", "on": ["top"], "potential": 5.0, "follows": "press"}
    electrode = run(pressed(dimension, electrodes=[given], **keys), MPI.COMM_WORLD).history
    for one, other in zip(boundary, electrode, strict=True):
        assert other["voltage@lid"] == pytest.approx(one["mean_potential@top"], rel=1e-12)
        assert other["charge@lid"] == pytest.approx(one["charge@top"], rel=1e-7)
        assert other["charge@top"] == pytest.approx(one["charge@top"], rel=1e-7)
        assert other["force_y@top"] == pytest.approx(one["force_y@top"], rel=1e-7, abs=1e-7 * abs(one["elastic"]))


@pytest.mark.mpi
@pytest.mark.parametrize("dimension", [2, 3])
def test_solvers_and_ranks_agree(dimension: int) -> None:
    """One open electrode, and one that holds a charge: condensed, factorized, multigrid; alone and on all ranks."""
    electrodes = [
        {"name": "lid", "on": ["top"], "charge": 1e-4, "follows": "press"},
        {"name": "floor", "on": ["bottom"]},
    ]
    rows = pressed(dimension).model_dump(exclude_none=True)["boundaries"]
    rows[0].pop("potential")
    rows = [{**row, "displacement": [0.0] * (dimension - 1) + [d]} for row, d in zip(rows, (0.0, -0.04), strict=True)]
    electrodes[1]["potential"] = 0.5
    histories = {}
    for name, solver in SOLVERS.items():
        keys = {"boundaries": rows, "electrodes": electrodes, "solver": {"tolerance": 1e-11, **solver}}
        histories[name] = run(pressed(dimension, **keys), MPI.COMM_WORLD).history
        if name == "condensed":
            assert_equal(histories[name], run(pressed(dimension, **keys), MPI.COMM_SELF).history)
    condensed = histories["condensed"][-1]
    assert condensed["charge@lid"] == pytest.approx(1e-4, rel=1e-8)
    for name in ("factorized", "multigrid"):
        row = histories[name][-1]
        assert row["voltage@lid"] == pytest.approx(condensed["voltage@lid"], rel=1e-7)
        assert row["charge@floor"] == pytest.approx(condensed["charge@floor"], rel=1e-7)
        assert row["elastic"] == pytest.approx(condensed["elastic"], rel=1e-7)


def test_finite_kinematics_with_an_open_electrode() -> None:
    """Another path of the tangent, which is assembled anew in each iteration; the energies balance."""
    history = run(
        electrode_scene(2, model={"kinematics": "finite"}, load={"steps": [8], "factors": {"press": [1.0]}}),
        MPI.COMM_WORLD,
    ).history
    row = history[-1]
    assert abs(row["charge@lid"]) < 1e-8 * row["electric"] / row["voltage@lid"]
    stored = sum(row[name] for name in ("elastic", "electric", "contact"))
    assert stored == pytest.approx(row["external_work"], rel=1e-2)
    assert max(r["newton"] for r in history) <= 6


@pytest.mark.mpi
def test_planes_as_electrodes() -> None:
    """A plane at a potential is an electrode of one plane; two planes and a body are one electrode."""

    def scene(plane: dict[str, Any], **keys: Any) -> Scene:
        floor = {"name": "floor", "point": "bottom"}
        lid = {"name": "lid", "point": "top", "motion": [0, -0.02], "follows": "press"}
        return pressed(
            2,
            geometry={"shape": "fiber_array", "columns": 1, "rows": 2},
            mesh={"size": 0.25, "contact_size": 0.08},
            bodies={"*": "pvdf"},
            boundaries=[],
            planes=[floor | {"potential": 0.0}, lid | plane],
            contact={"electric_range": 0.01},
            **keys,
        )

    given = {"name": "metal", "on": ["lid"], "potential": 3.0, "follows": "press"}
    plane = run(scene({"potential": 3.0, "potential_follows": "press"}), MPI.COMM_WORLD).history[-1]
    electrode = run(scene({}, electrodes=[given]), MPI.COMM_WORLD).history[-1]
    assert electrode["voltage@metal"] == pytest.approx(3.0, rel=1e-12)
    assert electrode["charge@metal"] == pytest.approx(plane["charge@lid"], rel=1e-6)
    assert electrode["charge@lid"] == pytest.approx(plane["charge@lid"], rel=1e-6)
    assert electrode["force_y@lid"] == pytest.approx(plane["force_y@lid"], rel=1e-6)
    open_circuit = run(scene({}, electrodes=[{"name": "metal", "on": ["lid"]}]), MPI.COMM_WORLD).history[-1]
    assert abs(open_circuit["voltage@metal"]) > 0.1
    assert abs(open_circuit["charge@metal"]) < 1e-8 * abs(plane["charge@lid"])
    # With the charge of the first run an open electrode comes to the potential of the first run.
    charge = plane["charge@lid"]
    charged = run(scene({}, electrodes=[{"name": "metal", "on": ["lid"], "charge": charge}]), MPI.COMM_WORLD).history[
        -1
    ]
    assert charged["voltage@metal"] == pytest.approx(3.0, rel=1e-3)


@pytest.mark.mpi
def test_an_open_plane_that_touches_nothing_as_yet() -> None:
    """Nothing but a weak link says which potential it has; without one the residual was not a number."""
    lid = {"name": "lid", "point": [0, 2.05], "normal": [0, -1], "motion": [0, -0.09], "follows": "press"}
    scene = pressed(
        2,
        geometry={"shape": "fiber_array", "columns": 1, "rows": 2},
        mesh={"size": 0.25, "contact_size": 0.08},
        bodies={"*": "pvdf"},
        boundaries=[],
        planes=[{"name": "floor", "point": "bottom", "potential": 0.0}, lid],
        electrodes=[{"name": "metal", "on": ["lid"]}],
        load={"steps": [3], "factors": {"press": [1.0]}},
    )
    history = run(scene, MPI.COMM_WORLD).history
    assert history[0]["force_y@lid"] == 0.0 and history[0]["voltage@metal"] == 0.0
    assert history[2]["force_y@lid"] < -1.0 and history[2]["voltage@metal"] > 1.0
    assert abs(history[2]["charge@metal"]) < 1e-6 * history[2]["electric"] / history[2]["voltage@metal"]


# --- Capacitance


@pytest.mark.mpi
@pytest.mark.parametrize("solver", SOLVERS)
def test_capacitance_is_the_slope_of_the_charge(solver: str) -> None:
    """One electrode holds a charge, the other a potential, with contact: against finite differences of runs."""

    def pressed_at(charge: float, potential: float) -> Any:
        rows = pressed(2).model_dump(exclude_none=True)["boundaries"]
        rows[0].pop("potential")
        rows[0]["displacement"], rows[1]["displacement"] = [0.0, 0.0], [0.0, -0.04]
        lid = {"name": "lid", "on": ["top"], "charge": charge}
        floor = {"name": "floor", "on": ["bottom"], "potential": potential}
        keys = {"tolerance": 1e-12, **SOLVERS[solver]}
        return run(pressed(2, boundaries=rows, electrodes=[lid, floor], solver=keys), MPI.COMM_WORLD)

    small = 1e-3
    result = pressed_at(0.0, 0.0)
    matrix = np.array(result.capacitance[-1])
    np.testing.assert_allclose(matrix, matrix.T, rtol=1e-12)
    assert matrix.sum(axis=1) == pytest.approx(0.0, abs=1e-6 * matrix.max())  # nothing else has a potential
    assert result.history[-1]["capacitance"] == pytest.approx(-matrix[0, 1], rel=1e-6)
    high, low = (pressed_at(sign * small * matrix[0, 0], 0.0).history[-1] for sign in (1.0, -1.0))
    assert high["voltage@lid"] - low["voltage@lid"] == pytest.approx(2.0 * small, rel=1e-4)
    high, low = (pressed_at(0.0, sign * small).history[-1] for sign in (1.0, -1.0))
    assert high["voltage@lid"] - low["voltage@lid"] == pytest.approx(2.0 * small, rel=1e-4)


@pytest.mark.parametrize("dimension", [2, 3])
def test_open_voltage_times_capacitance_is_the_charge_of_a_short_circuit(dimension: int) -> None:
    rows = pressed(dimension).model_dump(exclude_none=True)["boundaries"]
    rows[0].pop("potential")
    ground = {"name": "ground", "on": ["bottom"], "potential": 0.0}

    def row(**lid: float) -> dict[str, Any]:
        electrodes = [ground, {"name": "lid", "on": ["top"], **lid}]
        return last(pressed(dimension, boundaries=rows, electrodes=electrodes))

    isolated, short = row(), row(potential=0.0)
    mean = 0.5 * (isolated["capacitance"] + short["capacitance"])
    assert isolated["voltage@lid"] * mean == pytest.approx(-short["charge@lid"], rel=3e-3)


def test_capacitance_of_bodies_that_come_apart() -> None:
    """A Krylov solver begun at the response in contact diverged where there was none, which ended the run."""
    keys = {"load": {"steps": [2, 2], "factors": {"press": [1.0, -0.5]}}, "solver": {"kind": "iterative"}}
    result = run(electrode_scene(3, **keys, contact={"medium": "none"}), MPI.COMM_SELF)
    pressed_together, apart = result.capacitance[1][0][0], result.capacitance[3][0][0]
    assert result.history[3]["contact_area@lower-upper"] == 0.0
    assert 0.0 <= apart < 1e-3 * pressed_together


def test_a_capacitance_that_cannot_be_solved_for_is_none(monkeypatch: pytest.MonkeyPatch, caplog: Any) -> None:
    """The run goes on, and says so."""

    def failing(*given: Any, **more: Any) -> None:
        raise SolveError("on purpose")

    monkeypatch.setattr(capacitance, "solve", failing)
    result = run(electrode_scene(2), MPI.COMM_SELF)
    assert np.isnan(result.capacitance).all() and len(result.history) == 2
    assert "the capacitance of this step is not known: on purpose" in caplog.text


def test_without_any_potential_a_run_warns(caplog: Any) -> None:
    """The level of the potential is then what weak links make it; the difference is that of the closed form."""
    rows = [
        {"on": group, "displacement": [0.0 if i == axis else "free" for i in range(2)]}
        for group, axis in (("bottom", 1), ("root", 0), ("tip", 0))
    ]
    scene = Scene(
        geometry={"shape": "cantilever", "length": 1.0, "layers": [0.5, 0.5], "divisions": [2, 2]},
        bodies={"layer_*": "pvdf"},
        boundaries=[*rows, {"on": "top", "traction": [0.0, -1.0]}],
        electrodes=[{"name": "lid", "on": ["top"]}, {"name": "floor", "on": ["bottom"]}],
    )
    row = last(scene, MPI.COMM_SELF)
    assert "only differences of voltages have a meaning" in caplog.text
    assert row["voltage@lid"] - row["voltage@floor"] == pytest.approx(0.2064989519, rel=1e-6)
    charged = [{"name": "lid", "on": ["top"], "charge": 1e-5}, {"name": "floor", "on": ["bottom"]}]
    with pytest.raises(SceneError, match="1e-05 where nothing has a potential"):
        Scene(**{**scene.model_dump(exclude_none=True), "electrodes": charged})


# --- Circuits


@pytest.mark.mpi
@pytest.mark.parametrize("share", [0.5, 1.0, 10.0])
def test_a_capacitor_across_a_pressed_block(share: float) -> None:
    """References: exact, computed independently."""
    capacitance, rows = 1.079216823e-4, []
    for group, axis in (("bottom", 1), ("root", 0), ("tip", 0)):
        rows.append({"on": group, "displacement": [0.0 if i == axis else "free" for i in range(2)]})
    rows.append({"on": "top", "traction": [0.0, -1.0]})
    row = last(
        Scene(
            geometry={"shape": "cantilever", "length": 1.0, "layers": [0.5, 0.5], "divisions": [2, 2]},
            bodies={"layer_*": "pvdf"},
            boundaries=rows,
            electrodes=[{"name": "lid", "on": ["top"]}, {"name": "ground", "on": ["bottom"], "potential": 0.0}],
            circuits=[{"between": ["lid", "ground"], "capacitance": f"{share * capacitance!r} pF"}],
        )
    )
    assert row["voltage@lid"] == pytest.approx(0.2064989519 / (1.0 + share), rel=1e-8)
    assert row["charge@lid"] == pytest.approx(-share * capacitance * row["voltage@lid"], rel=1e-8)
    assert row["capacitance"] == pytest.approx(capacitance, rel=1e-8)


@pytest.mark.mpi
@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_an_instrument_on_pressed_fibers(kinematics: str) -> None:
    """The open circuit's charge is zero; what the instrument holds, the electrode has given."""
    rows = pressed(2).model_dump(exclude_none=True)["boundaries"]
    rows[0].pop("potential")
    ground = {"name": "ground", "on": ["bottom"], "potential": 0.0}
    keys = {
        "boundaries": rows,
        "electrodes": [ground, {"name": "lid", "on": ["top"]}],
        "model": {"kinematics": kinematics},
    }
    circuit = {"between": ["lid", "ground"], "capacitance": 1e-4}
    history = run(pressed(2, circuits=[circuit], **keys), MPI.COMM_WORLD).history
    row = history[-1]
    assert row["charge@lid"] == pytest.approx(-1e-4 * row["voltage@lid"], rel=1e-8)
    assert row["charge@ground"] == pytest.approx(-row["charge@lid"], rel=1e-6)
    isolated = last(pressed(2, **keys))
    total = 0.5 * (isolated["capacitance"] + row["capacitance"])
    assert row["voltage@lid"] * (total + 1e-4) == pytest.approx(isolated["voltage@lid"] * total, rel=3e-3)
    assert max(r["newton"] for r in history) <= 6


@pytest.mark.parametrize(
    ("circuit", "words"),
    [
        ({"between": ["lid", "gruond"], "capacitance": 1.0}, "circuits[0].between[1]"),
        ({"between": ["lid", "lid"], "capacitance": 1.0}, "two different electrodes"),
        ({"between": ["lid", "ground"], "capacitance": "10 ohm"}, "circuits[0].capacitance"),
        ({"between": ["lid", "ground"], "capacitance": 0.0}, "circuits[0].capacitance"),
        ({"between": ["lid", "ground"]}, "circuits[0].capacitance"),
    ],
)
def test_a_wrong_circuit_is_an_error_of_the_scene(circuit: dict[str, Any], words: str) -> None:
    with pytest.raises(SceneError) as error:
        pressed(2, electrodes=[{"name": "lid", "on": ["top"]}, {"name": "ground", "on": ["lower"]}], circuits=[circuit])
    assert words in str(error.value)


def test_units_of_a_capacitance() -> None:
    electrodes = [{"name": "lid", "on": ["top"]}, {"name": "ground", "on": ["lower"]}]
    for text, value in (("10 pF", 10.0), ("2nF", 2e3), ("1.5e-3 uF", 1.5e3), (3.0, 3.0), ("0.5 fF", 5e-4)):
        circuit = {"between": ["lid", "ground"], "capacitance": text}
        scene = pressed(2, electrodes=electrodes, circuits=[circuit])
        assert scene.circuits[0].capacitance == pytest.approx(value, rel=1e-12)


# --- What is refused


@pytest.mark.parametrize(
    ("electrodes", "words"),
    [
        ([{"name": "a", "on": ["nothing"]}], "electrodes[0].on[0]"),
        ([{"name": "a", "on": ["top"]}, {"name": "a", "on": ["bottom"]}], "a name of its own"),
        ([{"name": "a", "on": ["top"]}, {"name": "b", "on": ["t*"]}], 'is not of electrodes[0], "a"'),
        ([{"name": "a", "on": ["top"], "potential": 1.0, "charge": 1.0}], "either potential or charge"),
        ([{"name": "a", "on": ["top"], "follows": "press"}], "nothing without potential or charge"),
        ([{"name": "a", "on": ["top"], "potential": 1.0, "follows": "pull"}], "a factor of load.factors"),
    ],
)
def test_a_wrong_electrode_is_an_error_of_the_scene(electrodes: list[dict[str, Any]], words: str) -> None:
    with pytest.raises(SceneError) as error:
        pressed(2, electrodes=electrodes)
    assert words in str(error.value)


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("electrodes", "words"),
    [
        ([{"name": "a", "on": ["top"]}, {"name": "b", "on": ["upper"]}], ("b", "node", '"a"')),
        ([{"name": "a", "on": ["bottom"]}], ("a", 'the potential of boundaries[0] on "bottom"')),
        ([{"name": "a", "on": ["lower"]}], ("a", 'the potential of boundaries[0] on "bottom"')),
    ],
)
def test_electrodes_that_share_nodes_are_an_error(electrodes: list[dict[str, Any]], words: tuple[str, ...]) -> None:
    with pytest.raises(SceneError) as error:
        run(pressed(2, electrodes=electrodes), MPI.COMM_WORLD)
    assert all(word in str(error.value) for word in words)


def test_an_electrode_needs_a_permittivity() -> None:
    with pytest.raises(SceneError, match="unless the material of a body has a permittivity"):
        pressed(
            2,
            bodies={"lower": "elastic", "upper": "elastic"},
            electrodes=[{"name": "a", "on": ["top"]}],
            boundaries=[{"on": "bottom", "displacement": [0, 0]}],
            load={"steps": [1], "factors": {}},
        )
    with pytest.raises(SceneError, match="where no body has a permittivity"):
        run(
            pressed(2, bodies={"lower": "pvdf", "upper": "elastic"}, electrodes=[{"name": "a", "on": ["top"]}]),
            MPI.COMM_SELF,
        )


def test_numbers_of_an_electrode_do_not_depend_on_the_mesh_of_the_other_fields() -> None:
    """A conductor is a body that is an electrode: no field inside."""
    scene = pressed(2, electrodes=[{"name": "upper", "on": ["upper"]}])
    result = run(scene, MPI.COMM_SELF)
    values = result.problem.solution().x.array.reshape(-1, 3)[:, 2] * result.model.potential_scale
    inside = result.model.parts.node_part == 1
    assert np.ptp(values[inside]) < 1e-12 * np.abs(values).max()
