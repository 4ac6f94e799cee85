"""Whole runs of small scenes: what is modelled, loads against closed forms, balances, failures, files."""

from __future__ import annotations

import gc
import json
import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from mpi4py import MPI

from piezomat import cli
from piezomat.results.files import read_history
from piezomat.results.summary import SUMMARY_KEYS
from piezomat.results.vtk import read_index
from piezomat.scene import Scene
from piezomat.simulation import NotConverged, Run, plan, run
from piezomat.solver.newton import Newton
from piezomat.usage import BUCKETS
from tests.scenes import rollers
from tests.verification import references

LENGTH, HEIGHT, WIDTH = 4.0, 1.0, 0.8
YOUNG, POISSON, PERMITTIVITY = 1000.0, 0.25, 2e-4
MATERIALS = {
    "bar": {"young": YOUNG, "poisson": POISSON},
    "capacitor": {"young": YOUNG, "poisson": POISSON, "permittivity": PERMITTIVITY},
}
QUIET = {"fields": "none", "picture": False}


def bar(material: str, *loads: dict[str, Any], **sections: Any) -> Scene:
    """A bar on rollers that leave a uniform state free to develop: 2D, or 3D where the loads have 3 components."""
    spatial = any(len(row.get("traction", ())) == 3 for row in loads)
    shape = {"shape": "cantilever", "length": LENGTH, "layers": [HEIGHT], "divisions": [4, 2, 2][: 2 + spatial]}
    held = {"root": 0, "bottom": 2, "front": 1} if spatial else {"root": 0, "bottom": 1}
    return Scene(
        **{
            "title": "Bar",
            "geometry": shape | ({"width": WIDTH} if spatial else {}),
            "materials": MATERIALS,
            "bodies": {"layer_1": material},
            "boundaries": [*rollers(held, 2 + spatial), *loads],
            "output": QUIET,
            **sections,
        }
    )


def halves(**sections: Any) -> Scene:
    """Two half discs with an electrode each, pressed and pulled while adhesion holds them."""
    return Scene(
        **{
            "title": "Half discs",
            "geometry": {"shape": "facing_halves"},
            "mesh": {"size": 0.25, "contact_size": 0.06},
            "bodies": {"lower": "pvdf", "upper": "pvdf_tzou"},
            "boundaries": [
                {"on": "bottom", "displacement": [0, 0], "potential": 0},
                {"on": "top", "displacement": [0.004, -0.03], "potential": 2.0, "follows": "press"},
            ],
            "contact": {
                "normal_penalty": 1e5,
                "electric_penalty": 0.1,
                "adhesion": {"law": "bilinear", "strength": 20.0, "energy": 0.1},
            },
            "load": {"steps": [2, 3], "factors": {"press": [1.0, -0.1]}},
            "output": QUIET,
            **sections,
        }
    )


def fields(finished: Run) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, d) of the nodes, and displacement and potential / scale (n, block) there."""
    model = finished.model
    return model.unknowns.coordinates, finished.state.x.array.reshape(-1, model.unknowns.block)


# --- What is modelled ------------------------------------------------------------------------------


def test_what_is_linear_is_one_linear_solve(comm: MPI.Comm) -> None:
    finished = run(bar("bar", {"on": "tip", "traction": [5.0, 0.0]}, load={"steps": [3]}), comm)
    effort = [[row[name] for name in ("newton", "linear_solves", "krylov", "cutbacks")] for row in finished.history]
    assert effort == [[1, 1, 1, 0]] * 3
    assert finished.contact is None
    about_contact = ("contact_force", "contact_area", "bonded", "max_")
    assert not [name for name in finished.history[0] if name.startswith(about_contact)]


def test_finite_kinematics_are_not_linear(comm: MPI.Comm) -> None:
    finished = run(bar("bar", {"on": "tip", "traction": [50.0, 0.0]}, model={"kinematics": "finite"}), comm)
    assert finished.history[0]["newton"] > 1


def test_without_permittivity_there_is_no_potential(comm: MPI.Comm) -> None:
    finished = run(bar("bar", {"on": "tip", "traction": [5.0, 0.0]}), comm)
    assert finished.model.unknowns.block == 2 and finished.model.unknowns.total == 2 * 5 * 3
    electric = [name for name in finished.history[0] if name.startswith(("charge", "mean_potential"))]
    assert not electric and finished.history[0]["electric"] == 0.0
    assert run(bar("capacitor", {"on": "bottom", "potential": 0.0}), comm).model.unknowns.total == 3 * 5 * 3


def test_the_plan_says_so(comm: MPI.Comm) -> None:
    linear = plan(bar("bar", {"on": "tip", "traction": [5.0, 0.0]}), comm)
    assert "no potential" in linear and "one linear solve" in linear and "no [contact]" in linear
    pressed = plan(halves(), comm)
    assert "Newton" in pressed and "bilinear" in pressed and "lower-upper" in pressed


# --- Loads against closed forms --------------------------------------------------------------------


@pytest.mark.mpi
@pytest.mark.parametrize("plane", ["strain", "stress"])
@pytest.mark.parametrize("load", [{"traction": [7.0, 0.0]}, {"pressure": -7.0}])
def test_traction_and_pressure(load: dict[str, Any], plane: str, comm: MPI.Comm) -> None:
    finished = run(bar("bar", {"on": "tip", **load}, model={"plane": plane}), comm)
    x, u = fields(finished)
    across = POISSON if plane == "stress" else POISSON / (1 - POISSON)
    strain = 7.0 / YOUNG * (1.0 if plane == "stress" else 1 - POISSON**2)
    np.testing.assert_allclose(u, x * [strain, -across * strain], rtol=0, atol=1e-12)
    row = finished.history[0]
    assert row["force_x@tip"] == pytest.approx(7.0 * HEIGHT, rel=1e-10)
    assert row["force_x@root"] == pytest.approx(-7.0 * HEIGHT, rel=1e-10)
    assert row["force_y@bottom"] == pytest.approx(0.0, abs=1e-10)
    assert row["elastic"] == pytest.approx(0.5 * 7.0 * strain * LENGTH * HEIGHT, rel=1e-10)


@pytest.mark.mpi
def test_charge_density(comm: MPI.Comm) -> None:
    plates = ({"on": "bottom", "potential": 0.5}, {"on": "top", "charge_density": 3e-4})
    finished = run(bar("capacitor", *plates), comm)
    x, u = fields(finished)
    potential = 0.5 + 3e-4 * x[:, 1] / PERMITTIVITY
    np.testing.assert_allclose(u[:, 2] * finished.model.potential_scale, potential, rtol=1e-10)
    row = finished.history[0]
    assert row["mean_potential@top"] == pytest.approx(0.5 + 3e-4 * HEIGHT / PERMITTIVITY, rel=1e-10)
    assert row["charge@top"] == pytest.approx(3e-4 * LENGTH, rel=1e-10)
    assert row["charge@bottom"] == pytest.approx(-3e-4 * LENGTH, rel=1e-10)
    assert row["electric"] == pytest.approx(0.5 * 3e-4**2 / PERMITTIVITY * LENGTH * HEIGHT, rel=1e-10)


@pytest.mark.mpi
@pytest.mark.parametrize("circuit", ["open", "short"])
def test_a_piezoelectric_bar_under_traction(circuit: str, comm: MPI.Comm) -> None:
    """The coupling, its signs, and the energy: 3D, poled upwards, pulled along its poling."""
    state = references.uniform_state(references.PVDF, "free", circuit, 4.0)
    top = {"on": "top", "traction": [0.0, 0.0, 4.0]} | ({"potential": 0.0} if circuit == "short" else {})
    finished = run(bar("pvdf", {"on": "bottom", "potential": 0.0}, top), comm)
    x, u = fields(finished)
    np.testing.assert_allclose(u[:, :3], x * state.strain[:3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(u[:, 3] * finished.model.potential_scale, -state.field[2] * x[:, 2], rtol=0, atol=1e-9)
    row, area = finished.history[0], LENGTH * WIDTH
    assert row["force_z@top"] == pytest.approx(4.0 * area, rel=1e-10)
    assert row["charge@top"] == pytest.approx(-state.displacement[2] * area, rel=1e-9, abs=1e-12)
    assert row["mean_potential@top"] == pytest.approx(-state.field[2] * HEIGHT, rel=1e-9, abs=1e-12)
    work = 0.5 * 4.0 * state.strain[2] * area * HEIGHT
    assert row["external_work"] == pytest.approx(work, rel=1e-10)
    assert row["elastic"] + row["electric"] == pytest.approx(work, rel=1e-10)


@pytest.mark.mpi
def test_free_components(comm: MPI.Comm) -> None:
    """A prescribed end that may contract is a bar under traction; one that may not is stiffer."""
    free, held = (
        run(bar("bar", {"on": "tip", "displacement": [0.04, across]}), comm).history[0] for across in ("free", 0.0)
    )
    assert free["force_x@tip"] == pytest.approx(YOUNG / (1 - POISSON**2) * 0.01 * HEIGHT, rel=1e-10)
    assert free["force_y@tip"] == 0.0
    assert held["force_x@tip"] > 1.001 * free["force_x@tip"] and held["force_y@tip"] != 0.0


@pytest.mark.mpi
def test_stages_and_factors(comm: MPI.Comm) -> None:
    """Each row follows its own factor, linearly within the stages; rows without one are constant."""
    scene = bar(
        "pvdf",
        {"on": "bottom", "potential": 0.0},
        {"on": "tip", "traction": [6.0, 0.0], "follows": "pull"},
        {"on": "top", "potential": 10.0, "follows": "switch"},
        load={"steps": [2, 4], "factors": {"pull": [1.0, -1.0], "switch": [0.0, 1.0]}},
    )
    rows = run(scene, comm).history
    pull, switch = [0.5, 1.0, 0.5, 0.0, -0.5, -1.0], [0.0, 0.0, 0.25, 0.5, 0.75, 1.0]
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    assert columns["step"].tolist() == [1, 2, 3, 4, 5, 6] and columns["stage"].tolist() == [1, 1, 2, 2, 2, 2]
    np.testing.assert_allclose(columns["factor:pull"], pull, rtol=0, atol=1e-15)
    np.testing.assert_allclose(columns["factor:switch"], switch, rtol=0, atol=1e-15)
    np.testing.assert_allclose(columns["force_x@tip"], np.multiply(pull, 6.0 * HEIGHT), rtol=0, atol=1e-10)
    np.testing.assert_allclose(columns["mean_potential@top"], np.multiply(switch, 10.0), rtol=0, atol=1e-10)
    # The whole of the work is stored, on this path of loads that are not proportional too.
    stored = columns["elastic"] + columns["electric"]
    np.testing.assert_allclose(columns["external_work"], stored, rtol=0, atol=1e-10 * stored.max())


@pytest.mark.mpi
def test_a_constant_load_beside_a_factor(comm: MPI.Comm) -> None:
    scene = bar(
        "bar",
        {"on": "tip", "traction": [2.0, 0.0]},
        {"on": "top", "pressure": 3.0, "follows": "press"},
        load={"steps": [1, 1], "factors": {"press": [1.0, 0.5]}},
    )
    rows = run(scene, comm).history
    assert [row["force_x@tip"] for row in rows] == pytest.approx([2.0 * HEIGHT] * 2, rel=1e-10)
    assert [row["force_y@top"] for row in rows] == pytest.approx([-3.0 * LENGTH, -1.5 * LENGTH], rel=1e-10)
    assert [row["force_y@bottom"] for row in rows] == pytest.approx([3.0 * LENGTH, 1.5 * LENGTH], rel=1e-10)


# --- Balances --------------------------------------------------------------------------------------


@pytest.mark.mpi
@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_forces_and_charges_balance(kinematics: str, comm: MPI.Comm) -> None:
    scene = halves(model={"kinematics": kinematics}, solver={"tolerance": 1e-11})
    rows = run(scene, comm).history
    assert max(row["contact_area@lower-upper"] for row in rows) > 0.0
    assert max(row["adhesion"] for row in rows) > 0.0
    forces = np.array([[[row[f"force_{a}@{on}"] for a in "xy"] for on in ("bottom", "top")] for row in rows])
    charges = np.array([[row["charge@bottom"], row["charge@top"]] for row in rows])
    assert np.abs(forces.sum(axis=1)).max() < 1e-9 * np.abs(forces).max()
    assert np.abs(charges.sum(axis=1)).max() < 1e-9 * np.abs(charges).max()
    # What presses on the lower body is what holds it.
    contact = np.array([[row[f"contact_force_{a}@lower-upper"] for a in "xy"] for row in rows])
    assert np.abs(contact + forces[:, 0]).max() < 1e-9 * np.abs(forces).max()
    assert contact[1, 1] < 0.0 < contact[-1, 1]


# --- Failures --------------------------------------------------------------------------------------


def reach_across_a_gap(**sections: Any) -> Scene:
    """The first step closes half of a gap, the second one presses and cannot converge in a single iteration."""
    top = {"on": "top", "displacement": [0, -0.04], "follows": "press"}
    return halves(
        geometry={"shape": "facing_halves", "gap": 0.025},
        bodies={"lower": "elastic", "upper": "elastic"},
        boundaries=[{"on": "bottom", "displacement": [0, 0]}, top],
        contact={"normal_penalty": 1e5},
        load={"steps": [2], "factors": {"press": [1.0]}},
        solver={"max_iterations": 1, "max_cutbacks": 0},
        **sections,
    )


@pytest.mark.mpi
def test_what_converged_is_kept(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    out = shared_tmp_path / "out"
    with pytest.raises(NotConverged, match=rf"step 2 failed.*steps 1 to 1 are kept in {out}"):
        run(reach_across_a_gap(output={"fields": "end", "picture": False}), comm, out)
    comm.Barrier()
    assert [row["step"] for row in read_history(out / "history.csv")] == [1]
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert not summary["converged"] and "step 2 failed" in summary["reason"] and len(summary["steps"]) == 1
    (entry,) = read_index(out / "fields.pvd")
    assert entry.step == 1
    # The fields are those of step 1, not of the failed attempt.
    moved = max(-pyvista.read(out / piece).point_data["displacement"][:, 1].min() for piece in entry.files)
    assert moved == pytest.approx(0.02, rel=1e-10)


@pytest.mark.mpi
def test_exit_status_of_what_does_not_converge(
    comm: MPI.Comm, shared_tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(shared_tmp_path)
    if comm.rank == 0:
        Path("scene.toml").write_text(reach_across_a_gap().to_toml(), encoding="utf-8")
    comm.Barrier()
    assert cli.main(["run", "scene.toml", "--out", "out"]) == 3
    out, err = capfd.readouterr()
    assert out.count("step ") == (comm.rank == 0)
    if comm.rank == 0:
        assert err.startswith("step 2 failed") and err.endswith("steps 1 to 1 are kept in out\n")
    assert err.count("\n") == (comm.rank == 0)
    # With more iterations it goes on from there.
    comm.Barrier()
    if comm.rank == 0:
        path = Path("out/scene.toml")
        text = path.read_text(encoding="utf-8")
        assert "max_iterations = 1\n" in text
        path.write_text(text.replace("max_iterations = 1\n", "max_iterations = 20\n"), encoding="utf-8")
    comm.Barrier()
    assert cli.main(["resume", "out"]) == 0
    assert [row["step"] for row in read_history(Path("out/history.csv"))] == [1, 2]


# --- Files -----------------------------------------------------------------------------------------


@pytest.mark.mpi
@pytest.mark.parametrize("wanted", ["none", "end", "all"])
def test_fields(wanted: str, comm: MPI.Comm, shared_tmp_path: Path) -> None:
    finished = run(halves(output={"fields": wanted, "picture": False}), comm, shared_tmp_path)
    comm.Barrier()
    steps = {"none": [], "end": [5], "all": [1, 2, 3, 4, 5]}[wanted]
    for name in ("fields", "contact"):
        index = shared_tmp_path / f"{name}.pvd"
        assert [entry.step for entry in read_index(index)] == steps
        assert index.exists() == bool(steps)
    if not steps:
        return
    pieces = [pyvista.read(shared_tmp_path / piece) for piece in read_index(shared_tmp_path / "fields.pvd")[-1].files]
    cells = finished.model.mesh.topology.index_map(2).size_global
    assert sum(piece.n_cells for piece in pieces) == cells
    for piece in pieces:
        assert set(piece.point_data) == {"displacement", "potential", "places"}
        in_cells = {
            "stress": 6,
            "von_mises": 1,
            "strain": 6,
            "electric_field": 3,
            "electric_displacement": 3,
            "poling": 3,
            "body": 1,
        }
        assert {n: piece.cell_data[n].size // piece.n_cells for n in piece.cell_data} == in_cells
    # At the upper electrode the fields are what the scene prescribes at the end.
    x, moved, potential = (
        np.concatenate([np.array(get(piece)) for piece in pieces])
        for get in (lambda p: p.points, lambda p: p.point_data["displacement"], lambda p: p.point_data["potential"])
    )
    top = np.isclose(x[:, 1], 0.5)
    assert top.any()
    np.testing.assert_allclose(moved[top], np.tile([-0.0004, 0.003, 0.0], (top.sum(), 1)), rtol=0, atol=1e-14)
    np.testing.assert_allclose(potential[top], -0.2, rtol=1e-12)
    for entry in read_index(shared_tmp_path / "contact.pvd"):
        found = [pyvista.read(shared_tmp_path / piece) for piece in entry.files]
        gap, pressure = (np.concatenate([piece.point_data[n] for piece in found]) for n in ("gap", "pressure"))
        status = np.concatenate([piece.point_data["status"] for piece in found])
        assert all({"normal", "potential_jump", "pair"} <= set(piece.point_data) for piece in found)
        row = finished.history[entry.step - 1]
        # A node between two points is deeper than both.
        deepest = max(-gap.min(), 0.0)
        assert deepest <= row["max_penetration@lower-upper"] <= 2.0 * deepest
        assert max(pressure.max(), 0.0) == pytest.approx(row["max_pressure@lower-upper"], rel=1e-12)
        assert np.array_equal(status == 1, gap <= 0.0)


@pytest.mark.mpi
def test_summary(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    finished = run(halves(), comm, shared_tmp_path)
    comm.Barrier()
    summary = json.loads((shared_tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert tuple(summary) == SUMMARY_KEYS
    assert summary["title"] == "Half discs" and summary["converged"] and summary["reason"]
    assert summary["ranks"] == comm.size and summary["bodies"] == ["lower", "upper"]
    unknowns = finished.model.unknowns
    assert summary["dofs"] == unknowns.total == unknowns.space.dofmap.index_map.size_global * 3
    assert summary["cells"] == finished.model.mesh.topology.index_map(2).size_global
    assert summary["steps"] == finished.history == read_history(shared_tmp_path / "history.csv")
    timings = summary["timings"]
    assert set(timings) == {*BUCKETS, "total"} and min(timings.values()) >= 0.0
    assert sum(timings[name] for name in BUCKETS) <= timings["total"] * (1 + 1e-9)
    assert all(timings[name] > 0.0 for name in ("mesh", "assembly", "contact", "linear_solve", "output"))
    assert summary["peak_memory_mb"] > 10 * comm.size
    loads = summary["shares"]
    assert sum(loads["dofs"]) == summary["dofs"] and min(loads["memory_mb"]) > 10
    points = sum(len(p.near_points) for p in finished.contact.point_sets)
    assert sum(loads["contact_points"]) == comm.allreduce(points) > 0
    assert all(len(values) == comm.size for values in loads.values())
    assert {"piezomat", "dolfinx", "petsc", "gmsh", "numpy", "python", "mpi"} <= set(summary["versions"])
    # The scene as it was run can be run again.
    assert Scene.load(shared_tmp_path / "scene.toml").model_dump() == halves().model_dump()


@pytest.mark.slow
def test_picture(comm: MPI.Comm, tmp_path: Path) -> None:
    run(halves(output={"fields": "end", "picture": True}), comm, tmp_path)
    picture = pyvista.read(tmp_path / "picture.png")
    assert min(picture.dimensions[:2]) > 300
    colours = np.unique(picture.active_scalars.reshape(-1, picture.active_scalars.shape[-1]), axis=0)
    assert len(colours) > 50
    before = (tmp_path / "picture.png").stat().st_mtime_ns
    assert cli.main(["view", str(tmp_path)]) == 0
    assert (tmp_path / "picture.png").stat().st_mtime_ns > before


def test_an_older_run_gives_way(comm: MPI.Comm, tmp_path: Path) -> None:
    """A new run into the same folder leaves nothing of the old one, and touches nothing else."""
    run(halves(output={"fields": "all", "picture": False}), comm, tmp_path)
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    run(bar("bar", {"on": "tip", "traction": [5.0, 0.0]}), comm, tmp_path)
    there = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")}
    checkpoint = {f"checkpoint/{name}" for name in ("mesh.msh", "step_0000.npz", "step_0001.npz")}
    names = "scene.toml history.csv summary.json log.txt notes.txt .piezomat checkpoint".split()
    assert there == {*names, *checkpoint}


def test_a_run_leaves_no_solver_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not even to the garbage collector, which cannot see through every PETSc: many runs would use up its memory."""
    solvers: list[weakref.ref[Newton]] = []
    start = Newton.__init__

    def watched(self: Newton, *arguments: Any) -> None:
        solvers.append(weakref.ref(self))
        start(self, *arguments)

    monkeypatch.setattr(Newton, "__init__", watched)
    gc.disable()
    try:
        run(halves(load={"steps": [1], "factors": {"press": [0.2]}}), MPI.COMM_SELF)
    finally:
        gc.enable()
    assert [found() for found in solvers] == [None]
