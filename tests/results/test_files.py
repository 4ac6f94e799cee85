"""Results of a run: exact round trips, whole files whatever happens, cells of all ranks in VTK's order."""

from __future__ import annotations

import json
import logging
import math
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.forms import fenicsx
from piezomat.results.files import Results, read_history
from piezomat.results.summary import SUMMARY_KEYS, versions
from piezomat.results.vtk import ContactPoints, FieldPiece, ResultsError, grid, read_index
from piezomat.usage import Timer
from tests.conftest import bare_environment

COLUMNS = ["step", "stage", "factor:press", "force_x@a, b", 'charge@"top"', "newton", "seconds"]
# number of nodes of each (cell, order)
CELLS = {
    ("triangle", 1): 3,
    ("triangle", 2): 6,
    ("quadrilateral", 1): 4,
    ("quadrilateral", 2): 9,
    ("tetrahedron", 1): 4,
    ("tetrahedron", 2): 10,
    ("hexahedron", 1): 8,
    ("hexahedron", 2): 27,
}


def row(step: int) -> dict[str, float | int | str]:
    """A row with numbers that their decimals alone would not give back."""
    values = (step, 1, np.float64(step / 3), -1e-308 / step, 0.1 + 0.2, np.int32(4), float("nan"))
    return dict(zip(COLUMNS, values, strict=True))


def same_rows(a: list[dict[str, Any]], b: list[dict[str, Any]]) -> bool:
    return repr(a) == repr([{name: getattr(v, "item", lambda v=v: v)() for name, v in r.items()} for r in b])


@pytest.mark.mpi
def test_history_comes_back_as_it_was(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    with Results(shared_tmp_path / "a" / "run", comm) as results:
        results.start("title = 'é'\n", COLUMNS)
        for step in (1, 2, 3):
            results.row(row(step) if comm.rank == 0 else {})
        rows = [row(step) for step in (1, 2, 3)]
        assert same_rows(results.rows, rows)
        assert same_rows(read_history(results.out / "history.csv"), rows)
        assert (results.out / "scene.toml").read_text(encoding="utf-8") == "title = 'é'\n"
        comm.barrier()
        with pytest.raises(ResultsError, match="missing or unknown: seconds, speed"):
            results.row({("speed" if key == "seconds" else key): value for key, value in row(4).items()})
        assert len(results.rows) == 3


@pytest.mark.mpi
def test_start_removes_an_older_run_and_nothing_else(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    foreign = [
        "notes.txt",
        "fields/mine.vtu",
        "fields/step_1.vtu",
        "mesh.msh",
        "checkpoint_old/step_0001.npz",
    ]
    older = [
        "history.csv",
        "summary.json",
        "picture.png",
        "fields.pvd",
        "contact.pvd",
        "log.txt",
        "scene.toml",
    ]
    older += ["fields/step_0001_rank_0000.vtu", "fields/.step_0002_rank_0003.part.vtu", ".history.part.csv"]
    older += ["contact/step_0001_rank_0000.vtp", "checkpoint/step_0001.npz", "checkpoint/mesh.msh"]
    older += ["checkpoint/.step_0002.part.npz", "checkpoint/.mesh.part.msh"]
    if comm.rank == 0:
        for name in foreign + older:
            (shared_tmp_path / name).parent.mkdir(exist_ok=True)
            (shared_tmp_path / name).write_text("x")
    comm.barrier()
    with Results(shared_tmp_path, comm) as results:
        results.start("", COLUMNS)
    files = {str(f.relative_to(shared_tmp_path)) for f in shared_tmp_path.rglob("*") if f.is_file()}
    assert files == {*foreign, "scene.toml", "history.csv", "log.txt"}
    assert read_history(shared_tmp_path / "history.csv") == []
    assert not (shared_tmp_path / "contact").exists()


@pytest.mark.mpi
def test_cannot_start_where_a_file_stands(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    if comm.rank == 0:
        (shared_tmp_path / "run").write_text("a file")
    comm.barrier()
    with pytest.raises(OSError):
        Results(shared_tmp_path / "run", comm).start("", COLUMNS)


@pytest.mark.mpi
@pytest.mark.parametrize("moment", ["write", "replace"])
def test_history_survives_a_failed_write(
    comm: MPI.Comm, shared_tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    def crash(*args: Any, **kwargs: Any) -> Any:
        raise OSError(28, "No space left on device")

    with Results(shared_tmp_path, comm) as results:
        results.start("", COLUMNS)
        results.row(row(1))
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync" if moment == "write" else "replace", crash)
            with pytest.raises(OSError, match="No space left"):
                results.row(row(2))
        assert same_rows(read_history(shared_tmp_path / "history.csv"), [row(1)])
        assert not list(shared_tmp_path.glob(".*"))
        comm.barrier()
        results.row(row(2))
        assert same_rows(read_history(shared_tmp_path / "history.csv"), [row(1), row(2)])


FOREVER = """
import sys
from pathlib import Path
from mpi4py import MPI
from piezomat.results.files import Results
results = Results(Path(sys.argv[1]), MPI.COMM_SELF)
results.start("title = 'x'", ["step", "force"])
for step in range(1, 10**6):
    results.row({"step": step, "force": step / 3})
"""


def test_history_of_a_killed_process_is_whole(tmp_path: Path) -> None:
    root = Path(__file__).resolve().parents[2]
    rng = np.random.default_rng(5)
    for _ in range(3):
        process = subprocess.Popen([sys.executable, "-c", FOREVER, str(tmp_path)], cwd=root, env=bare_environment())
        while not list(tmp_path.glob("history.csv")) and process.poll() is None:
            time.sleep(0.001)
        time.sleep(float(rng.uniform(0.05, 0.15)))
        process.send_signal(signal.SIGKILL)
        process.wait()
        rows = read_history(tmp_path / "history.csv")
        assert len(rows) > 0
        assert rows == [{"step": step, "force": step / 3} for step in range(1, len(rows) + 1)]
        for file in tmp_path.iterdir():
            file.unlink()


def unit_mesh(comm: MPI.Comm, cell: str, order: int) -> Any:
    """Unit square or cube of cells with curved sides when order is 2 (its volume unchanged to that order)."""
    import gmsh

    dim = 2 if cell in ("triangle", "quadrilateral") else 3
    x, cells = np.empty((0, dim)), np.empty((0, CELLS[cell, order]), np.int64)
    if comm.rank == 0:
        gmsh.initialize(["-noenv"], interruptible=False)
        try:
            gmsh.option.setNumber("General.Terminal", 0)
            box = gmsh.model.occ.addRectangle(0, 0, 0, 1, 1)
            if dim == 3:
                layers = [2] if cell == "hexahedron" else []
                gmsh.model.occ.extrude([(2, box)], 0, 0, 1, layers, recombine=cell == "hexahedron")
            gmsh.model.occ.synchronize()
            if cell in ("quadrilateral", "hexahedron"):
                for _, curve in gmsh.model.getEntities(1):
                    gmsh.model.mesh.setTransfiniteCurve(curve, 3)
                gmsh.model.mesh.setTransfiniteSurface(box)
                gmsh.model.mesh.setRecombine(2, box)
            gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
            gmsh.model.mesh.generate(dim)
            gmsh.model.mesh.setOrder(order)
            tags, coordinates, _ = gmsh.model.mesh.getNodes()
            number = np.zeros(int(tags.max()) + 1, np.int64)
            number[tags.astype(int)] = np.arange(len(tags))
            x = coordinates.reshape(-1, 3)[:, :dim]
            types, _, nodes = gmsh.model.mesh.getElements(dim)
            assert len(types) == 1
            cells = number[nodes[0].astype(int)].reshape(-1, CELLS[cell, order])
            cells = cells[:, fenicsx.gmsh_permutation(cell, CELLS[cell, order])]
        finally:
            gmsh.finalize()
    mesh = fenicsx.create_mesh(comm, cells, x, cell, order)
    mesh.geometry.x[:, 0] += shift(mesh.geometry.x, order)
    return mesh


def shift(x: Any, order: int) -> Any:
    """A shear along x that keeps all volumes and that elements of that order represent exactly."""
    return 0.3 * x[:, 1] ** order


def piece(mesh: Any, rank: int) -> FieldPiece:
    """Fields whose values tell where they belong."""
    cells = grid(mesh)
    x, n = cells.points, len(cells.cells)
    middle = x[cells.cells].mean(axis=1) if n else np.empty((0, 3))
    return FieldPiece(
        grid=cells,
        displacement=x * [1, 2, 3],
        potential=x[:, 0] - 2 * x[:, 1],
        stress=np.column_stack([middle, middle]),
        electric_field=middle,
        electric_displacement=-middle,
        body=np.full(n, rank),
    )


@pytest.mark.mpi
@pytest.mark.parametrize(("cell", "order"), CELLS)
def test_fields_of_every_cell_type(comm: MPI.Comm, shared_tmp_path: Path, cell: str, order: int) -> None:
    import pyvista

    mesh = unit_mesh(comm, cell, order)
    with Results(shared_tmp_path, comm) as results:
        results.start("", COLUMNS)
        results.fields(3, 0.5, piece(mesh, comm.rank))
        results.fields(12, 2.0, piece(mesh, comm.rank))
    entries = read_index(shared_tmp_path / "fields.pvd")
    assert [(entry.step, entry.time) for entry in entries] == [(3, 0.5), (12, 2.0)]
    assert str(entries[0].files[0]) == "fields/step_0003_rank_0000.vtu"
    assert len(list((shared_tmp_path / "fields").iterdir())) == sum(len(entry.files) for entry in entries)
    if comm.rank == 0:
        reader = pyvista.PVDReader(str(shared_tmp_path / "fields.pvd"))
        assert list(reader.time_values) == [0.5, 2.0]
        reader.set_active_time_value(2.0)
        parts = list(reader.read())
        volume = 0.0
        for part in parts:
            for i in range(part.n_cells):
                assert_nodes_in_order(part.get_cell(i), order)
                volume += jacobian_integral(part.get_cell(i))
            assert np.allclose(part["displacement"], part.points * [1, 2, 3], rtol=0, atol=1e-15)
            assert np.allclose(part["potential"], part.points @ [1, -2, 0], rtol=0, atol=1e-15)
            middle = np.array([part.get_cell(i).points.mean(axis=0) for i in range(part.n_cells)])
            assert np.allclose(part["stress"], np.column_stack([middle, middle]), rtol=0, atol=1e-14)
            assert np.allclose(part["electric_displacement"], -middle, rtol=0, atol=1e-14)
            assert part["body"].dtype == np.int32
        assert volume == pytest.approx(1.0, rel=1e-12)
        assert sum(part.n_cells for part in parts) == mesh.topology.index_map(mesh.topology.dim).size_global


def assert_nodes_in_order(cell: Any, order: int) -> None:
    """Each node lies where VTK's coordinates of it say, between the corners, once the shear is undone."""
    import pyvista

    corners = {3: 3, 6: 3, 4: 4, 9: 4, 10: 4, 8: 8, 27: 8}[cell.n_points]
    straight = {3: pyvista.CellType.TRIANGLE, 8: pyvista.CellType.HEXAHEDRON}.get(
        corners, pyvista.CellType.QUAD if cell.dimension == 2 else pyvista.CellType.TETRA
    )
    linear = pyvista.UnstructuredGrid([corners, *range(corners)], [straight], np.zeros((corners, 3))).GetCell(0)
    flat = cell.points.copy()
    places = np.array([cell.GetParametricCoords()[i] for i in range(3 * cell.n_points)]).reshape(-1, 3)
    flat[:, 0] -= shift(cell.points, order)  # y is not sheared
    for node, place in zip(flat, places, strict=True):
        weights = np.zeros(corners)
        linear.InterpolateFunctions(place, weights)
        assert np.allclose(weights @ flat[:corners], node, rtol=0, atol=1e-12)


def jacobian_integral(cell: Any) -> float:
    """Volume (area) of a cell by VTK's own shape functions for it: wrong if the order of nodes is."""
    dim, nodes = cell.dimension, cell.n_points
    points = cell.points[:, :dim]
    gauss, weight = np.polynomial.legendre.leggauss(3)
    if nodes in (4, 8, 9, 27) and not (dim == 3 and nodes == 4):
        axes, weights = [(gauss + 1) / 2] * dim, [weight / 2] * dim
        places = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, dim)
        w = np.prod(np.stack(np.meshgrid(*weights, indexing="ij"), -1).reshape(-1, dim), axis=1)
    elif dim == 2:
        places, w = np.array([[1, 1], [4, 1], [1, 4]]) / 6, np.full(3, 1 / 6)
    else:
        a, b = (5 - math.sqrt(5)) / 20, (5 + 3 * math.sqrt(5)) / 20
        places, w = np.full((4, 3), a), np.full(4, 1 / 24)
        places[[0, 1, 2], [0, 1, 2]] = b
    total = 0.0
    for place, factor in zip(places, w, strict=True):
        slopes = np.zeros(dim * nodes)
        cell.InterpolateDerivs(np.r_[place, np.zeros(3 - dim)], slopes)
        total += factor * np.linalg.det(slopes.reshape(dim, nodes) @ points)
    return total


@pytest.mark.mpi
def test_ranks_without_cells_or_points(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    import pyvista

    first = comm.rank == 0
    x = np.array([[0.0, 0], [1, 0], [0, 1]]) if first else np.empty((0, 2))
    cells = np.array([[0, 1, 2]]) if first else np.empty((0, 3), np.int64)
    destinations = np.array([comm.size - 1], np.int32) if first else None
    mesh = fenicsx.create_mesh(comm, cells, x, "triangle", 1, destinations)
    n = 2 if comm.rank == comm.size - 1 else 0
    points = ContactPoints(np.ones((n, 3)), np.ones((n, 3)), np.ones(n), np.ones(n), np.ones(n, int), np.zeros(n, int))
    nothing = ContactPoints(*[np.empty((0, 3))] * 2, *[np.empty(0)] * 4)
    with Results(shared_tmp_path, comm) as results:
        results.start("", COLUMNS)
        results.fields(1, 1.0, piece(mesh, comm.rank))
        results.contact(1, points, 1.0)
        results.contact(2, nothing)
    last = f"rank_{comm.size - 1:04d}"
    assert [str(f) for e in read_index(shared_tmp_path / "fields.pvd") for f in e.files] == [
        f"fields/step_0001_{last}.vtu"
    ]
    contact = read_index(shared_tmp_path / "contact.pvd")
    assert [(e.step, e.time, len(e.files)) for e in contact] == [(1, 1.0, 1), (2, 2.0, 1)]
    data = pyvista.read(shared_tmp_path / contact[0].files[0])
    assert data.n_points == 2 and set(data.point_data) == {"normal", "gap", "pressure", "status", "pair"}
    assert data["status"].tolist() == [1, 1]
    assert pyvista.read(shared_tmp_path / contact[1].files[0]).n_points == 0


@pytest.mark.mpi
def test_wrong_piece_on_one_rank_fails_on_all_and_is_not_named(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    mesh = unit_mesh(comm, "triangle", 1)
    good = piece(mesh, 0)
    bad = FieldPiece(good.grid, good.displacement, good.stress[:-1], good.body)
    with Results(shared_tmp_path, comm) as results:
        results.start("", COLUMNS)
        results.fields(1, 1.0, good)
        with pytest.raises(ValueError, match="stress has"):
            results.fields(2, 2.0, bad if comm.rank == comm.size - 1 else good)
    assert [entry.step for entry in read_index(shared_tmp_path / "fields.pvd")] == [1]


@pytest.mark.mpi
def test_resume_keeps_what_came_before(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    mesh = unit_mesh(comm, "triangle", 1)
    with Results(shared_tmp_path, comm) as results:
        results.start("title = 'x'", COLUMNS)
        logging.getLogger("piezomat").info("first run")
        for step in (1, 2, 3):
            results.row(row(step))
            results.fields(step, step, piece(mesh, comm.rank))
        results.summary({key: None for key in SUMMARY_KEYS})
    with Results(shared_tmp_path, comm) as results:
        results.resume(COLUMNS, 2)
        logging.getLogger("piezomat").info("second run")
        assert same_rows(results.rows, [row(1), row(2)])
        assert [entry.step for entry in read_index(shared_tmp_path / "fields.pvd")] == [1, 2]
        assert not list((shared_tmp_path / "fields").glob("step_0003*"))
        assert not (shared_tmp_path / "summary.json").exists()
        comm.barrier()
        results.row(row(3))
    assert same_rows(read_history(shared_tmp_path / "history.csv"), [row(1), row(2), row(3)])
    assert [line.split()[-2:] for line in (shared_tmp_path / "log.txt").read_text().splitlines()] == [
        ["first", "run"],
        ["second", "run"],
    ]
    comm.barrier()
    with Results(shared_tmp_path, comm) as results:
        with pytest.raises(ResultsError, match="no row of step 7"):
            results.resume(COLUMNS, 7)
        with pytest.raises(ResultsError, match="missing or unknown: more"):
            results.resume([*COLUMNS, "more"], 2)
        results.resume(COLUMNS, 5, rows=[row(4), row(5), row(6)])
        assert same_rows(read_history(shared_tmp_path / "history.csv"), [row(4), row(5)])
        comm.barrier()
        results.resume(COLUMNS, 0)
        assert results.rows == []


@pytest.mark.mpi
def test_summary_has_the_keys_of_the_contract(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    given = {
        "title": "t",
        "converged": np.bool_(True),
        "reason": "done",
        "dofs": np.int64(12),
        "cells": 4,
        "bodies": ("lower", "upper"),
        "recipe": None,
        "warnings": ["a doubt"],
        "capacitance": {"electrodes": [], "matrices": []},
        "timings": Timer().timings(comm),
        "shares": {"dofs": [12]},
    }
    with Results(shared_tmp_path, comm) as results:
        results.start("", COLUMNS)
        results.row(row(1))
        results.summary(given)
        text = (shared_tmp_path / "summary.json").read_text()
        comm.barrier()
        with pytest.raises(ValueError, match="missing or unknown: dofs, nodes"):
            results.summary({("nodes" if key == "dofs" else key): value for key, value in given.items()})
    summary = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert tuple(summary) == SUMMARY_KEYS
    assert summary["ranks"] == comm.size and summary["converged"] is True and summary["dofs"] == 12
    assert summary["steps"][0]["seconds"] is None and summary["steps"][0]["step"] == 1
    assert summary["steps"][0]["factor:press"] == 1 / 3
    assert {"piezomat", "dolfinx", "petsc", "python", "numpy", "gmsh", "mpi"} <= set(summary["versions"])
    assert list(summary["timings"]) == "setup mesh assembly contact linear_solve output total".split()
    assert summary["peak_memory_mb"] > 20 * comm.size


def test_versions_are_numbers() -> None:
    for name, version in versions().items():
        assert re.search(r"\d+\.\d+", version), name


def test_unreadable_results_are_named(tmp_path: Path) -> None:
    with pytest.raises(ResultsError, match="there is no"):
        read_history(tmp_path / "history.csv")
    (tmp_path / "history.csv").write_text("step,force\none,2\n")
    with pytest.raises(ResultsError, match="is not a history"):
        read_history(tmp_path / "history.csv")
    (tmp_path / "fields.pvd").write_text("<VTKFile><DataSet")
    with pytest.raises(ResultsError, match="is not an index"):
        read_index(tmp_path / "fields.pvd")
