"""Scenes that once gave a wrong answer, or none: a regression test for each."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.contact import interfaces as contact
from piezomat.scene import Scene, SceneError
from piezomat.simulation import NotConverged, run
from piezomat.solver import newton as solver
from piezomat.solver.load_steps import Step, Stepper, StepReport
from piezomat.solver.outcome import SolveError
from piezomat.usage import peak_memory_mb
from scripts.studies.mats import CHEAP, COARSE, STEPS, mat, value
from tests.scenes import press


def blocks(**changes: Any) -> Scene:
    """Two blocks of 1 x 0.5 um on each other, the upper one guided sideways."""
    keys: dict[str, Any] = {
        "geometry": {"shape": "stacked_blocks", "height": [0.5, 0.5], "divisions": [[3, 3], [4, 4]]},
        "materials": {"soft": {"young": 1000.0, "poisson": 0.3}},
        "bodies": {"lower": "soft", "upper": "soft"},
        "boundaries": [
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": [0, "free"], "traction": [0, -1.0]},
        ],
        "contact": {},
    }
    return Scene(**{**keys, **changes})


@pytest.mark.parametrize("gap", [0.0, 0.01])
def test_a_traction_presses_a_body_that_only_contact_holds(gap: float) -> None:
    """The weak springs of the floating block let it fly through the other one."""
    geometry = {"shape": "stacked_blocks", "height": [0.5, 0.5], "divisions": [[3, 3], [4, 4]], "gap": gap}
    last = run(blocks(geometry=geometry), MPI.COMM_SELF).history[-1]
    assert last["contact_force_y@lower-upper"] == pytest.approx(-1.0, rel=1e-5)
    assert last["force_y@bottom"] == pytest.approx(1.0, rel=1e-5)
    assert last["newton"] <= 4  # with the inside held where nothing is in balance yet it took 40


@pytest.mark.parametrize("gap", [0.01, 0.05])
def test_no_block_of_a_pile_leaps_through_the_next(gap: float) -> None:
    """Springs ten times weaker threw four blocks through the lowest: contact was lost, and then they flew."""
    names = [f"block_{i}" for i in range(1, 6)]
    scene = blocks(
        geometry={
            "shape": "stacked_blocks",
            "height": [0.3] * 5,
            "divisions": [[3, 2], [4, 2], [5, 2], [3, 2], [4, 2]],
            "gap": gap,
        },
        mesh={"cells": "tensor", "order": 2},
        bodies=dict.fromkeys(names, "soft"),
    )
    last = run(scene, MPI.COMM_SELF).history[-1]
    for lower, upper in itertools.pairwise(names):
        assert last[f"contact_force_y@{lower}-{upper}"] == pytest.approx(-1.0, rel=1e-3)


def test_a_load_that_nothing_holds_is_said() -> None:
    boundaries = [
        {"on": "bottom", "displacement": [0, 0]},
        {"on": "top", "displacement": [0, "free"], "traction": [0, 1.0]},
    ]
    with pytest.raises(NotConverged, match=r"nothing holds|flies away"):
        run(blocks(boundaries=boundaries, solver={"max_cutbacks": 1}), MPI.COMM_SELF)


def test_finite_kinematics_press_like_small_ones_where_little_moves() -> None:
    """The line search evaluated its trials in Newton's own state."""
    forces = []
    for kinematics in ("small", "finite"):
        boundaries = [
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": [0, -1e-4]},
        ]
        scene = blocks(boundaries=boundaries, model={"kinematics": kinematics})
        forces.append(run(scene, MPI.COMM_SELF).history[-1]["contact_force_y@lower-upper"])
    assert forces[1] == pytest.approx(forces[0], rel=1e-3) and forces[0] < -0.05


@pytest.mark.parametrize("tilt", [0.0, 30.0])
def test_a_step_without_any_load_ends_at_once(tilt: float) -> None:
    """Gaps that are zero but for rounding were held against no force at all."""
    geometry = {"shape": "stacked_blocks", "height": [0.5, 0.5], "divisions": [[3, 3], [4, 4]], "tilt": tilt}
    boundaries = [{"on": "bottom", "displacement": [0, 0]}, {"on": "top", "displacement": [0, 0]}]
    last = run(blocks(geometry=geometry, boundaries=boundaries), MPI.COMM_SELF).history[-1]
    assert abs(last["force_y@top"]) < 1e-8 and last["cutbacks"] == 0


def test_a_step_that_changes_nothing_ends_at_once() -> None:
    boundaries = [
        {"on": "bottom", "displacement": [0, 0]},
        {"on": "right", "traction": [1.0, 0.0], "follows": "pull"},
    ]
    load = {"steps": [1, 1], "factors": {"pull": [1.0, 1.0]}}
    geometry = {"shape": "cantilever", "length": 2.0, "layers": [0.5], "divisions": [4, 2]}
    scene = blocks(
        geometry=geometry,
        bodies={"layer_1": "soft"},
        boundaries=[{**boundaries[0], "on": "root"}, {**boundaries[1], "on": "tip"}],
        contact=None,
        load=load,
    )
    first, second = run(scene, MPI.COMM_SELF).history
    assert second["elastic"] == pytest.approx(first["elastic"], rel=1e-12)


def test_the_spring_of_a_soft_floating_body_is_soft() -> None:
    """Springs scaled by the stiffest body held a soft one between two stiff ones: forces did not balance."""
    scene = blocks(
        geometry={"shape": "stacked_blocks", "height": [0.5, 0.5, 0.5], "divisions": [[2, 2], [3, 2], [2, 2]]},
        materials={"steel": {"young": 2e5, "poisson": 0.0}, "soft": {"young": 1.0, "poisson": 0.0}},
        bodies={"block_1": "steel", "block_2": "soft", "block_3": "steel"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": [0, -0.01]},
        ],
    )
    last = run(scene, MPI.COMM_SELF).history[-1]
    lower, upper = last["contact_force_y@block_1-block_2"], last["contact_force_y@block_2-block_3"]
    assert lower == pytest.approx(upper, rel=1e-5) and lower == pytest.approx(-0.02, rel=0.2)


def test_a_load_inside_a_body_is_refused() -> None:
    scene = blocks(
        geometry={"shape": "cantilever", "length": 2.0, "layers": [0.5, 0.5], "divisions": [4, 2]},
        bodies={"layer_1": "soft", "layer_2": "soft"},
        boundaries=[
            {"on": "root", "displacement": [0, 0]},
            {"on": "interface_1", "traction": [0, -1.0]},
        ],
        contact=None,
    )
    with pytest.raises(SceneError, match="inside a body"):
        run(scene, MPI.COMM_SELF)


def test_bonds_tear_where_a_point_leaves_the_surface() -> None:
    """Slid sideways, the part of the upper block that has left the lower one is no longer bonded."""
    scene = blocks(
        boundaries=[
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": ["free", -0.001]},
            {"on": "top", "displacement": [0.6, "free"], "follows": "slide"},
        ],
        contact={"adhesion": {"law": "bilinear", "strength": 1.0, "energy": 0.01}},
        load={"steps": [1, 12], "factors": {"slide": [0.0, 1.0]}},
    )
    history = run(scene, MPI.COMM_SELF).history
    assert history[0]["bonded_area@lower-upper"] == pytest.approx(1.0, rel=1e-9)
    assert history[-1]["bonded_area@lower-upper"] < 0.6


def facing_halves(penalty: float, steps: int = 5, **contact: Any) -> Scene:
    """The half discs of the issue on stiff contact: 15,000 unknowns, pressed by 0.05 um."""
    return Scene(
        geometry={"shape": "facing_halves"},
        mesh={"size": 0.038, "contact_size": 0.008, "size_factors": {"upper": 0.9}},
        bodies={"lower": "pvdf", "upper": "pvdf"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0], "potential": 0},
            {"on": "top", "displacement": [0, -0.05], "follows": "press"},
        ],
        contact={"normal_penalty": penalty, "electric_penalty": 0.1, **contact},
        load={"steps": [steps], "factors": {"press": [1.0]}},
    )


@pytest.mark.parametrize(
    ("passes", "penalty", "force"),
    [
        (1, 1e4, -32.316),
        (1, 1e5, -45.255),
        (1, 1e6, -47.162),
        (1, 1e7, -47.354),
        (1, 1e8, -47.372),
        (2, 1e4, -32.351),
        (2, 1e5, -45.263),
        (2, 1e6, -47.174),
        (2, 1e7, -47.369),
        (2, 1e8, -47.390),
    ],
)
def test_no_penalty_is_too_stiff_or_too_soft(passes: int, penalty: float, force: float) -> None:
    """Far from equilibrium the tangent was indefinite, and steps were cut or took twenty iterations.

    Tractions turned with their facets, and the electric contact pulled at surfaces beyond the edge of the contact. And
    steps closed points that the next ones opened again, two at a time: ten iterations at the stiffest penalty.
    """
    history = run(facing_halves(penalty, passes=passes), MPI.COMM_SELF).history
    assert all(row["cutbacks"] == 0 for row in history)
    assert sum(row["newton"] for row in history) <= 5.5 * len(history)
    assert history[-1]["force_y@top"] == pytest.approx(force, rel=1e-4)
    one = run(facing_halves(penalty, steps=1, passes=passes), MPI.COMM_SELF).history[-1]
    assert one["force_y@top"] == pytest.approx(force, rel=1e-4)


def test_memory_does_not_grow_with_the_number_of_steps() -> None:
    """What Python lets go PETSc destroys when all ranks ask it to: a long snap filled 24 GB before any had."""
    scene, peaks = facing_halves(1e5), []
    mesh = scene.mesh.model_copy(update={"size": 0.076, "contact_size": 0.016})
    for steps in (10, 60):
        load = scene.load.model_copy(update={"steps": [steps]})
        run(scene.model_copy(update={"mesh": mesh, "load": load}), MPI.COMM_SELF)
        peaks.append(peak_memory_mb(MPI.COMM_SELF))
    assert peaks[1] - peaks[0] < 10.0


def test_surfaces_too_far_inside_each_other_are_named_as_the_reason() -> None:
    """Fine facets that a soft penalty leaves far inside each other buckle: no search and no tangent helps."""
    scene = facing_halves(1e4, steps=1)
    mesh = scene.mesh.model_copy(update={"size": 0.076, "contact_size": 0.016})
    boundaries = [*scene.boundaries[:1], scene.boundaries[1].model_copy(update={"displacement": [0, -0.2]})]
    scene = scene.model_copy(update={"mesh": mesh, "boundaries": boundaries})
    with pytest.raises(NotConverged, match=r"[0-9.]+ facets inside each other.*raise the normal penalty"):
        run(scene.model_copy(update={"solver": scene.solver.model_copy(update={"max_cutbacks": 3})}), MPI.COMM_SELF)


def strongly_coupled(voltage: float, size: float = 0.02, **contact: Any) -> Scene:
    """Half discs of PZT-5H between electrodes that a traction presses together: nothing but contact holds the upper."""
    return Scene(
        geometry={"shape": "facing_halves"},
        mesh={"size": 0.12, "contact_size": size, "size_factors": {"upper": 0.9}},
        bodies={"lower": "pzt5h", "upper": "pzt5h"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0], "potential": 0},
            {
                "on": "top",
                "displacement": [0, "free"],
                "traction": [0, -40],
                "potential": voltage,
                "follows": "press",
            },
        ],
        contact=contact,
        load={"steps": [4], "factors": {"press": [1]}},
        output={"fields": "none", "picture": False},
    )


@pytest.mark.parametrize("method", ["point", "segment", "node"])
@pytest.mark.parametrize("voltage", [20.0, 50.0, -50.0])
def test_electrodes_across_a_contact_do_not_pull_surfaces_together(voltage: float, method: str) -> None:
    """Over a tenth of a facet, as the electric contact faded out, they did: no step converged from 20 V on."""
    last = run(strongly_coupled(voltage, method=method), MPI.COMM_SELF).history[-1]
    # The top is 1 um wide.
    assert last["force_y@bottom"] == pytest.approx(40.0, rel=1e-6)
    assert last["contact_force_y@lower-upper"] == pytest.approx(-40.0, rel=1e-6)
    assert last["charge@bottom"] == pytest.approx(-last["charge@top"], rel=1e-6)
    assert last["charge@top"] * voltage > 0.0
    assert last["max_potential_jump@lower-upper"] < 0.02 * abs(voltage)


def test_the_charge_of_a_contact_between_electrodes_does_not_hang_on_the_mesh() -> None:
    """The gap over which it fades out is the voltage's and not the facet's: 20 V leave 0.270, 0.273, 0.275 pC."""
    charges = [run(strongly_coupled(20.0, size), MPI.COMM_SELF).history[-1]["charge@top"] for size in (0.02, 0.01)]
    assert charges[0] == pytest.approx(charges[1], rel=0.02)


def test_a_gap_too_short_for_the_voltage_is_named_as_the_reason() -> None:
    scene = strongly_coupled(50.0, electric_range=0.002)
    with pytest.raises(
        NotConverged, match=r"surfaces 50 V apart may pull harder.*raise contact.electric_range to 0.05"
    ):
        run(scene.model_copy(update={"solver": scene.solver.model_copy(update={"max_cutbacks": 1})}), MPI.COMM_SELF)


def test_the_voltage_does_not_scatter_with_the_mesh() -> None:
    """Where the electric contact ends abruptly it does, by 0.5 %; a charge that fades out leaves 0.1 %."""
    scatter = []
    for electric_range in (1e-8, None):
        voltages = []
        for size in (0.0194, 0.0197, 0.02, 0.0203, 0.0206):
            scene = facing_halves(1e5, steps=1, electric_range=electric_range)
            mesh = scene.mesh.model_copy(update={"size": 0.1, "contact_size": size})
            voltages.append(
                run(scene.model_copy(update={"mesh": mesh}), MPI.COMM_SELF).history[-1]["mean_potential@top"]
            )
        scatter.append(np.std(voltages) / np.mean(voltages))
    assert scatter[1] < 1e-3 and scatter[1] < 0.5 * scatter[0]


def test_a_point_that_has_left_its_facet_is_looked_up_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Late in a solve points keep facets that they have left, and the end of the solve was taken for equilibrium."""
    detect, set_up = contact.Interfaces.detect, contact.Interfaces.set_tolerance_and_tangent

    def lenient(method: Any) -> Any:
        def changed(self: contact.Interfaces, *given: Any, **named: Any) -> None:
            method(self, *given, **named)
            self._projection_tolerance = 5.0

        return changed

    monkeypatch.setattr(contact.Interfaces, "detect", lenient(detect))
    monkeypatch.setattr(contact.Interfaces, "set_tolerance_and_tangent", lenient(set_up))
    boundaries = [
        {"on": "bottom", "displacement": [0, 0], "potential": 0},
        {"on": "top", "displacement": [0.03, -0.02]},
    ]
    scene = facing_halves(1e5)
    scene = Scene(**{**scene.model_dump(exclude_unset=True), "boundaries": boundaries, "load": {}})
    for p in run(scene, MPI.COMM_SELF).problem.contact.surface_pairs:
        pressed = p.projection.gap < 0.0
        assert p.slave.kind.overshoot(p.projection.xi[pressed]).max() <= 0.101


def test_no_body_stays_where_a_wild_step_threw_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A block that Newton's method threw sideways stayed there: weak springs let it, and the forces balanced."""
    monkeypatch.setattr(solver.Newton, "_predict", thrown(solver.Newton._predict))
    scene = blocks(
        geometry={"shape": "stacked_blocks", "height": [0.5, 0.3], "divisions": [[3, 3], [4, 2]]},
        solver={"max_cutbacks": 0},
    )
    finished = run(scene, MPI.COMM_SELF)
    assert finished.history[-1]["contact_force_y@lower-upper"] == pytest.approx(-1.0, rel=1e-5)
    assert np.abs(finished.problem.model.unknowns.displacements(finished.problem.state)).max() < 0.01


def thrown(predict: Any) -> Any:
    """A start value that throws the upper block sideways, the first time."""
    times = iter([0.45])

    def changed(newton: solver.Newton, *given: Any, **more: Any) -> None:
        predict(newton, *given, **more)
        state = newton.problem.state
        upper = newton.problem.model.unknowns.coordinates[: newton.problem.model.unknowns.owned, 1] > 0.0
        state.array.reshape(-1, 2)[upper, 0] += next(times, 0.0)

    return changed


def test_fine_curved_facets_far_inside_each_other_neither_scallop_nor_slide_about() -> None:
    """Order 2, penetration of two thirds of a facet, pressures of a tenth of the modulus: 8 iterations a step at most.

    With three points a facet, which load vertices and side nodes unevenly, the last two steps took 46 and 25.
    """
    history = run(
        press(
            {"shape": "facing_halves"},
            mesh={"size": 0.12, "contact_size": 0.004, "order": 2, "size_factors": {"upper": 0.9}},
            bodies={"lower": "elastic", "upper": "elastic"},
            boundaries=[
                {"on": "bottom", "displacement": [0, 0]},
                {"on": "top", "displacement": [0, -0.05], "follows": "press"},
            ],
            contact={"normal_penalty": 1e5},
            load={"steps": [5], "factors": {"press": [1.0]}},
        ),
        MPI.COMM_SELF,
    ).history
    assert max(row["newton"] for row in history) <= 8 and not any(row["cutbacks"] for row in history)
    assert history[-1]["max_penetration@lower-upper"] > 0.6 * 0.004


@pytest.mark.parametrize(("count", "seed"), [(6, 3), (30, 2)])
def test_loose_fibers_do_not_swing_in_the_pull_of_potentials(count: int, seed: int) -> None:
    """The tangent was indefinite where only the fading electric contact pulls on a fiber: steps of no length, cuts."""
    keys = mat(count, seed, steps=1, finer=COARSE) | CHEAP
    keys |= {"load.factors.press": [1.0 / STEPS], "solver.kind": "direct"}
    scene = Scene.load("random_mat", [f"{key}={value(thing)}" for key, thing in keys.items()])
    (last,) = run(scene, MPI.COMM_SELF).history
    assert last["cutbacks"] == 0 and last["newton"] <= 25
    assert last["force_z@lid"] < -1.0 and last["stabilization"] < 1e-3 * last["elastic"]


def test_what_has_failed_is_not_tried_again_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of a share larger than what is left of the step may still be all that is left."""
    done, tried = [0.0], []

    def part(stepper: Stepper, before: Any, factors: dict[str, float], committed: Any, report: StepReport) -> None:
        tried.append((done[-1], factors["press"]))
        if factors["press"] - done[-1] > (0.6 if not done[-1] else 0.3):
            raise SolveError("too far")
        done.append(factors["press"])

    monkeypatch.setattr(Stepper, "_part", part)
    stepper = Stepper(SimpleNamespace(contact=None), None, max_cutbacks=3)
    report = stepper.advance(Step(1, 1, {"press": 0.0}, {"press": 1.0}), lambda factors: None)
    assert done[-1] == 1.0 and report.cutbacks == len(tried) - len(done) + 1
    assert len(set(tried)) == len(tried) > len(done)


def test_the_rest_of_a_step_snaps_as_a_part_of_its_size_would(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts grow from step to step and need not divide one: what is left at its end is small enough to snap."""
    snapped: list[float] = []

    def part(stepper: Stepper, before: Any, factors: dict[str, float], committed: Any, report: StepReport) -> None:
        if factors["press"] == 1.0:
            raise SolveError("bonds snap")
        committed(factors)

    def snap(stepper: Stepper, before: Any, factors: dict[str, float], committed: Any, report: StepReport) -> None:
        snapped.append(factors["press"])

    monkeypatch.setattr(Stepper, "_part", part)
    monkeypatch.setattr(Stepper, "_snap", snap)
    stepper = Stepper(SimpleNamespace(contact=SimpleNamespace(adhesive=True)), None, max_cutbacks=4)
    stepper.size = 0.23828125
    report = stepper.advance(Step(1, 1, {"press": 0.0}, {"press": 1.0}), lambda factors: None)
    assert snapped == [1.0] and report.cutbacks == 3
