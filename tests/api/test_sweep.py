"""`pz.sweep`: one table of all combinations, what is done is kept, ranks, runs that do not converge."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import pytest
from mpi4py import MPI

import piezomat as pz
from piezomat import simulation
from piezomat.api import sweep as module

SMALL = {"mesh.size": 0.2, "mesh.contact_size": 0.1, "load.steps": [2, 1], "output.picture": False}
VALUES = {"contact.method": ["node", "point"], "materials.pvdf.young": [2000.0, 3000.0]}


def columns(table: Any) -> dict[str, list[Any]]:
    return {name: list(table[name]) for name in table}


def test_a_row_for_each_combination() -> None:
    scene = pz.Scene.load("fibers_2d", SMALL | {"materials": {"pvdf": {"like": "pvdf"}}, "bodies": {"*": "pvdf"}})
    table = columns(
        pz.sweep(scene, VALUES, {"load": {"steps": [2], "factors": {"press": [1]}}}, quiet=True, comm=MPI.COMM_SELF)
    )
    assert table["contact.method"] == ["node", "node", "point", "point"]
    assert table["materials.pvdf.young"] == [2000.0, 3000.0, 2000.0, 3000.0]
    assert table["step"] == [2] * 4 and all(table["converged"])
    alone = pz.run(
        scene,
        {"load.steps": [2], "load.factors.press": [1], "contact.method": "point", "materials.pvdf.young": 3000.0},
        quiet=True,
        comm=MPI.COMM_SELF,
    )
    assert table["elastic"][3] == pytest.approx(alone.history[-1]["elastic"], rel=1e-9)
    assert table["elastic"][3] != pytest.approx(table["elastic"][2], rel=1e-3)


def test_what_is_done_is_not_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values = {"contact.method": ["node", "point"]}
    before = columns(pz.sweep("fibers_2d", values, SMALL, out=tmp_path, quiet=True, steps="all", comm=MPI.COMM_SELF))
    assert before["step"] == [1, 2, 3, 1, 2, 3]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["method=node", "method=point", "sweep.csv"]
    with (tmp_path / "sweep.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["force_y@top"]) for row in rows] == before["force_y@top"]

    ran: list[str] = []
    run = simulation.run

    def counted(scene: pz.Scene, *arguments: Any, **options: Any) -> Any:
        ran.append(scene.contact.method)
        return run(scene, *arguments, **options)

    monkeypatch.setattr(simulation, "run", counted)
    values = {"contact.method": ["node", "point", "segment"]}
    after = columns(pz.sweep("fibers_2d", values, SMALL, out=tmp_path, quiet=True, steps="all", comm=MPI.COMM_SELF))
    assert ran == ["segment"]
    assert after["force_y@top"][:6] == before["force_y@top"]
    # A case of other values is run anew, also where its folder is there.
    pz.sweep("fibers_2d", values, SMALL | {"load.steps": [1, 1]}, out=tmp_path, quiet=True, comm=MPI.COMM_SELF)
    assert ran == ["segment", "node", "point", "segment"]


def test_an_interrupted_case_goes_on(tmp_path: Path) -> None:
    class Stopped(Exception):
        pass

    def stop(problem: Any, contact: Any, row: dict[str, Any]) -> None:
        if row["step"] == 3:
            raise Stopped

    scene = pz.Scene.load("fibers_2d", {**SMALL, "contact.method": "node"})
    with pytest.raises(Stopped):
        simulation.run(scene, MPI.COMM_SELF, tmp_path / "method=node", quiet=True, watch=stop)
    (case,) = module._cases("fibers_2d", {"contact.method": ["node"]}, SMALL)
    history, converged, how = module._rows(case, tmp_path, 1, MPI.COMM_SELF)
    assert how == "resumed" and converged and [row["step"] for row in history] == [1, 2, 3]


@pytest.mark.slow
def test_runs_on_ranks_that_mpirun_starts(tmp_path: Path) -> None:
    values = {"contact.method": ["node"]}
    table = columns(pz.sweep("fibers_2d", values, SMALL, ranks=2, out=tmp_path, quiet=True, comm=MPI.COMM_SELF))
    assert pz.open(tmp_path / "method=node").summary["ranks"] == 2
    alone = columns(pz.sweep("fibers_2d", values, SMALL, quiet=True, comm=MPI.COMM_SELF))
    assert table["elastic"] == pytest.approx(alone["elastic"], rel=1e-9)


def test_a_case_that_does_not_converge_keeps_its_steps(tmp_path: Path) -> None:
    few = SMALL | {"solver.max_cutbacks": 0, "solver.max_iterations": 1, "boundaries.1.displacement": [0, -0.2]}
    for out in (None, tmp_path):
        values = {"solver.max_iterations": [1, 25]}
        table = columns(pz.sweep("fibers_2d", values, few, out=out, quiet=True, comm=MPI.COMM_SELF))
        assert table["converged"] == [False, True]


def test_all_scenes_are_checked_before_the_first_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulation, "run", lambda *arguments, **options: pytest.fail("a run has begun"))
    with pytest.raises(pz.SceneError, match=r"contact\.method"):
        pz.sweep("fibers_2d", {"contact.method": ["point", "points"]}, quiet=True, comm=MPI.COMM_SELF)


def test_names_of_folders_are_names() -> None:
    values = {"geometry.file": ["a/../b", "a/.._b"], "load.steps": [[1] * 200]}
    names = [
        module._name({"geometry.file": f, "load.steps": s})
        for f in values["geometry.file"]
        for s in values["load.steps"]
    ]
    assert len(set(names)) == 2 and all("/" not in name and len(name) < 100 for name in names)
    assert module._name({"a.radius": 0.2, "b.radius": 0.3}) == "a.radius=0.2,b.radius=0.3"


@pytest.mark.mpi
def test_on_ranks_of_its_own(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    table = columns(
        pz.sweep("fibers_2d", {"contact.method": ["node"]}, SMALL, out=shared_tmp_path, quiet=True, comm=comm)
    )
    assert table["step"] == [3]
    assert (
        columns(pz.sweep("fibers_2d", {"contact.method": ["node"]}, SMALL, out=shared_tmp_path, quiet=True, comm=comm))
        == table
    )
    if comm.size > 1:
        with pytest.raises(ValueError, match="starts mpirun itself"):
            pz.sweep("fibers_2d", {"contact.method": ["node"]}, ranks=2, comm=comm)
