"""Load steps that end before they converge: at a bound on their iterations, or at a signal; and steps that say so."""

from __future__ import annotations

import functools
import itertools
import signal
from pathlib import Path

import gmsh
import numpy as np
import pytest
from mpi4py import MPI

from piezomat import progress, simulation
from piezomat.progress import Progress
from piezomat.scene import Scene
from piezomat.simulation import Interrupted, NotConverged, run
from piezomat.solver.load_steps import steps
from piezomat.solver.step_watch import StepWatch, TooManyIterations
from tests.marching import stepper_of
from tests.scenes import pressed

# Round on round without a boundary sideways: nothing but springs keeps the upper body from rolling off.
ROLLING = [
    "mesh.size=0.2",
    "mesh.contact_size=0.02",
    'boundaries.1.displacement=["free", "free"]',
    "boundaries.1.traction=[0, -5]",
    "load.steps=[1, 1]",
    "contact.electric_range=0.002",
]
NONE_THEN_PRESSED = {"steps": [1, 1], "factors": {"press": [0.0, 1.0]}}  # a step without iterations, and one with


@pytest.mark.slow
def test_a_step_that_would_not_end_has_a_bound() -> None:
    """Counted in iterations, failed tries included; the state is that of the last part that converged."""
    scene, bound = Scene.load("fibers_2d", ROLLING), 300
    reason = rf"step 2 has not converged in {bound} Newton iterations, \d+ tries, the last of 1/\d of the step: .*rolls"
    with stepper_of(scene, MPI.COMM_SELF) as stepper:
        stepper.watch.max_iterations = bound
        first, second = itertools.islice(steps(scene.load), 2)
        kept = []
        stepper.advance(first, lambda part: None)
        kept.append(stepper.problem.state.array.copy())
        with pytest.raises(TooManyIterations, match=reason):
            stepper.advance(second, lambda part: kept.append(stepper.problem.state.array.copy()))
        assert stepper.watch.iterations == bound + 1
        assert np.array_equal(stepper.problem.state.array, kept[-1])


def test_a_run_keeps_what_converged_before_the_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulation, "StepWatch", functools.partial(StepWatch, max_iterations=2))
    with pytest.raises(NotConverged, match=r"step 2 has not converged in 2 .* steps 1 to 1 are kept"):
        run(pressed(2, load=NONE_THEN_PRESSED), MPI.COMM_SELF, tmp_path / "out")
    assert (tmp_path / "out" / "history.csv").read_text(encoding="utf-8").count("\n") == 2


@pytest.mark.mpi
def test_a_signal_acts_at_the_next_iteration(
    comm: MPI.Comm, shared_tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On any rank; all ranks end alike, and the run that is taken up again ends as one that was not stopped."""
    out = shared_tmp_path / "out"
    shown: list[str] = []

    def working(self: Progress, line: str) -> None:
        shown.append(line)
        if line.startswith("step 2") and "2 iterations" in line and comm.rank == comm.size - 1:
            signal.raise_signal(signal.SIGTERM)

    scene = pressed(2, load=NONE_THEN_PRESSED)
    with monkeypatch.context() as patch, pytest.raises(Interrupted) as stopped:
        patch.setattr(Progress, "working", working)
        run(scene, comm, out)
    assert str(stopped.value).startswith("interrupted in step 2: steps 1 to 1 are kept in")
    assert str(stopped.value).endswith(f"go on with: piezomat resume {out}")
    assert "2 iterations" in shown[-1]
    resumed, whole = run(scene, comm, out, resume=True).history, run(scene, comm).history
    names = [name for name in whole[-1] if name.startswith(("force", "mean_potential"))]
    assert names and resumed[-1] == pytest.approx(
        {**resumed[-1], **{n: whole[-1][n] for n in names}}, rel=1e-8, abs=1e-9
    )


def test_long_steps_say_what_they_are_at(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """After 10 s, then every 10 s at most, where there is no terminal ever more seldom."""
    now = 0.0
    monkeypatch.setattr(progress, "monotonic", lambda: now)
    row = {"step": 1, "cutbacks": 0, "newton": 3, "linear_solves": 4, "seconds": 1.0}
    with Progress(MPI.COMM_SELF, "title", 3, 0) as display:
        for now in (1.0, 9.9, 10.1, 15.0, 29.0, 30.2, 69.0):
            display.working(f"at {now}")
        display.step(row)
        for now in (78.0, 79.1):
            display.working(f"at {now}")
    lines = capsys.readouterr().out.splitlines()
    assert [line.strip() for line in lines if "at" in line and "step" not in line] == ["at 10.1", "at 30.2", "at 79.1"]


@pytest.mark.slow
def test_steps_whose_end_rounding_may_have_picked_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The tips of a C driven past each other: two ranks ended at another force than one and three. Not before."""
    _write_c(tmp_path / "c.msh")
    scene = Scene(
        geometry={"file": tmp_path / "c.msh"},
        model={"kinematics": "finite"},
        materials={"soft": {"young": 1000.0, "poisson": 0.3}},
        bodies={"c": "soft"},
        boundaries=[
            {"on": "up", "displacement": ["free", -0.4], "follows": "close"},
            {"on": "down", "displacement": ["free", 0.4], "follows": "close"},
            {"on": "back", "displacement": [0, "free"]},
        ],
        contact={"self_contact": True, "method": "node"},
        load={"steps": [24], "factors": {"close": [1.0]}},
    )
    run(scene, MPI.COMM_SELF)
    warnings = [line for line in capsys.readouterr().out.splitlines() if "rounding may have picked" in line]
    assert len(warnings) == 1
    numbers = warnings[0].split("in steps ")[1].split(":")[0].split(", ")
    assert min(map(int, numbers)) > 15  # the tips meet in step 16


def _write_c(path: Path) -> None:
    """Two arms of 4 x 0.5 um, 0.5 um apart, with a web on their left."""
    gmsh.initialize(argv=[])
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.2)
        occ = gmsh.model.occ
        arm, web = occ.addRectangle(0, 0.25, 0, 4, 0.5), occ.addRectangle(-0.5, 0, 0, 0.5, 0.75)
        half = [(2, arm), (2, web)]
        mirrored = occ.copy(half)
        occ.mirror(mirrored, 0, 1, 0, 0)
        body = occ.fuse(half, mirrored)[0][0]
        occ.synchronize()
        middles = {tag: occ.getCenterOfMass(1, tag) for _, tag in gmsh.model.getBoundary([body], oriented=False)}
        gmsh.model.addPhysicalGroup(2, [body[1]], name="c")
        ends = {"up": (4, 1), "down": (4, -1), "back": (-0.5, 0)}
        for name, (x, side) in ends.items():
            tags = [tag for tag, at in middles.items() if abs(at[0] - x) < 1e-6 and at[1] * side >= 0]
            gmsh.model.addPhysicalGroup(1, tags, name=name)
        gmsh.model.mesh.generate(2)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()
