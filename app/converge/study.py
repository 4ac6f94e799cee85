"""The runs of a convergence study: a scene on a series of meshes, orders 1 and 2, within a budget of time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
from mpi4py import MPI

from piezomat import simulation
from piezomat.converge.estimate import Estimate, best, limit
from piezomat.meshes.gmsh_io.mesh_file import MeshFile
from piezomat.pictures.curves import driver_of, electric_curve
from piezomat.pictures.data import RunData
from piezomat.progress import Progress
from piezomat.scene import Scene, SceneError
from piezomat.scene.errors import near, shown
from piezomat.solver.load_steps import steps

COARSEST = 2.0  # times the sizes of the scene
RATIO = 2.0**0.5  # of the sizes of one mesh and the next
FINER = 1.25  # least ratio of cells to the mesh before: built meshes come in steps
GROWTH = 1.25  # power of the unknowns that the time is assumed to grow with
MOST = 8  # meshes of one order
PATH = 0.05  # share of the tolerance by which the columns may differ where a stage is one step


@dataclass(frozen=True)
class Level:
    """One run: what it overrides, sizes, time (s) for the scene's whole load and of the run, values by column."""

    order: int
    overrides: dict[str, Any]
    cells: int
    unknowns: int
    seconds: float
    spent: float
    values: dict[str, float]

    def size(self, dimension: int) -> float:
        """Mean size of the cells, in an unit of its own."""
        return self.cells ** (-1.0 / dimension)


@dataclass(frozen=True)
class Study:
    """What a study has found.

    step: of the scene's load, at which the columns are compared. taken: steps in which that load was applied.
    """

    scene: Scene
    within: float
    step: int
    taken: int
    columns: list[str]
    levels: list[Level]
    failures: list[str] = field(default_factory=list)
    penalty_change: dict[str, float] = field(default_factory=dict)

    def series(self, order: int) -> list[Level]:
        """The runs of an order, the coarsest first."""
        return sorted((level for level in self.levels if level.order == order), key=lambda level: level.cells)

    def by_order(self, column: str) -> dict[int, Estimate]:
        """The limit of a column on the meshes of each order."""
        found = {}
        for order in (1, 2):
            runs = self.series(order)
            if len(runs) > 1:
                sizes = [run.size(self.scene.dimension) for run in runs]
                found[order] = limit(sizes, [run.values[column] for run in runs])
        return found

    def reference(self, column: str) -> Estimate:
        """The limit of a column, over both orders."""
        estimates = list(self.by_order(column).values())
        if not estimates:
            return Estimate(self.levels[-1].values[column] if self.levels else float("nan"), float("inf"), None)
        return best(estimates)

    def error(self, level: Level, column: str) -> float:
        """Distance of a run from the limit, as a share of the limit."""
        reference = self.reference(column)
        return abs(level.values[column] - reference.value) / abs(reference.value) if reference.value else float("nan")

    def uncertainty(self, column: str) -> float:
        """Uncertainty of the limit as a share of it."""
        reference = self.reference(column)
        return reference.uncertainty / abs(reference.value) if reference.value else float("nan")

    def cheapest(self) -> Level | None:
        """The run that takes least time of those surely within the tolerance in every column; None where none is."""
        good = [
            level
            for level in self.levels
            if all(self.error(level, column) + self.uncertainty(column) <= self.within for column in self.columns)
        ]
        return min(good, key=lambda level: level.seconds, default=None)

    def is_settled(self) -> bool:
        """Whether a run is surely within the tolerance."""
        return self.cheapest() is not None


def study(
    scene: Scene,
    comm: MPI.Comm,
    *,
    within: float = 0.01,
    columns: Sequence[str] = (),
    budget: float = 240.0,
    quiet: bool = False,
) -> Study:
    """Run a scene on finer and finer meshes until a column's limit is known within the tolerance. Collective.

    The load is that of the scene up to the step at which the force on what moves is largest (the last step where
    nothing moves), on the coarsest mesh; each stage in one step where that gives the same there. columns: of the
    history; by default that force, the voltage or charge, and the capacitance, or the elastic energy where there are
    less than two of these. budget: seconds after which no run is begun that would exceed it.

    SceneError: the sizes of the mesh are not the scene's to change; a column that the history does not have.
    """
    _check_sizes(scene)
    began = perf_counter()
    orders = (1,) if scene.contact is not None and scene.contact.smoothing else (1, 2)
    # Cells of order 2 have twice as many nodes along each edge.
    series = {order: _Series.of(scene, order) for order in orders}
    with Progress(comm, f"convergence: {scene.title}", MOST, 0, quiet=quiet) as progress:
        sizes = series[1].next()
        run = simulation.run(Scene.load(scene, sizes), comm, quiet=True)
        step = _step(Scene.load(scene, sizes), run.history)
        names = _columns(Scene.load(scene, sizes), run.history, columns)
        load, effort = _path(scene, sizes, run, step, names, within)
        found = Study(scene, within, step, sum(load["steps"]), names, [])
        first = _level(1, sizes, run.summary, run.history[step - 1], names, effort, whole=True)
        found.levels.append(first)
        progress.done(f"coarsest mesh: {first.unknowns:,} unknowns, {first.seconds:.1f} s; compared at step {step}")
        while series and not (found.is_settled() and len(found.series(1)) > 2):
            costs = {order: _expected(found, order, series[order]) for order in series}
            order = min(costs, key=costs.__getitem__)
            left = comm.bcast(budget - (perf_counter() - began))
            if comm.bcast(costs[order]) > left or len(found.series(order)) >= MOST:
                del series[order]
                continue
            sizes = series[order].next()
            try:
                finer = simulation.run(Scene.load(scene, {**sizes, "load": load}), comm, quiet=True)
            except (simulation.NotConverged, SceneError) as error:
                found.failures.append(f"{_said(sizes)}: {error}")
                progress.done(f"{_said(sizes)}: {error}")
                del series[order]
                continue
            level = _level(order, sizes, finer.summary, finer.history[-1], names, effort)
            same = found.series(order)
            if same and level.cells < FINER * same[-1].cells:
                continue
            found.levels.append(level)
            progress.done(f"{_said(sizes)}  {level.unknowns:,} unknowns  {level.spent:.1f} s")
        _ask_penalty(found, comm, load, progress)
    return found


@dataclass
class _Series:
    """The meshes of an order, the coarsest first: sizes (um) of the next one."""

    order: int
    size: float
    fine: float

    @classmethod
    def of(cls, scene: Scene, order: int) -> _Series:
        """The series that begins at twice the sizes of the scene, for its order; cells are no larger than bodies."""
        scale = COARSEST * order / scene.mesh.order
        size = min(scale * scene.mesh.size, max(scene.mesh.size, scene.geometry.size()))
        return cls(order, size, min(scale * (scene.mesh.contact_size or scene.mesh.size), size))

    def next(self) -> dict[str, Any]:
        """Overrides for the next mesh."""
        sizes = {"mesh.size": float(f"{self.size:.4g}"), "mesh.contact_size": float(f"{self.fine:.4g}")}
        self.size, self.fine = self.size / RATIO, self.fine / RATIO
        return {**sizes, "mesh.order": self.order}


def _expected(found: Study, order: int, series: _Series) -> float:
    """Time that the next mesh is expected to take, from that of the finest one so far of its order."""
    last = (found.series(order) or found.series(1)[:1])[-1]
    finer = (last.overrides["mesh.contact_size"] / last.order) / (series.fine / order)
    return last.spent * finer ** (found.scene.dimension * GROWTH)


def _path(
    scene: Scene, sizes: Mapping[str, Any], run: simulation.Run, step: int, names: Sequence[str], within: float
) -> tuple[dict[str, Any], float]:
    """The load up to a step, and the Newton iterations of the whole load over those of this one. Collective.

    Each stage is one step where the columns are then the same on this mesh, as without bonds that break.
    """
    rows = run.history
    load = _load_until(scene, step)
    short = {**load, "steps": [1] * len(load["steps"])}
    if short != load:
        try:
            taken = simulation.run(Scene.load(scene, {**sizes, "load": short}), run.model.comm, quiet=True).history
        except simulation.NotConverged:
            taken = []
        changes = [abs(taken[-1][n] - rows[step - 1][n]) / abs(rows[step - 1][n] or 1.0) for n in names if taken]
        if taken and max(changes, default=0.0) <= PATH * within:
            return short, _newton(rows) / _newton(taken)
    return load, _newton(rows) / _newton(rows[:step])


def _newton(rows: Sequence[Mapping[str, Any]]) -> int:
    return max(1, sum(row["newton"] for row in rows))


def _ask_penalty(found: Study, comm: MPI.Comm, load: dict[str, Any], progress: Progress) -> None:
    """A run with ten times the penalty of the scene, on the mesh that takes least time."""
    contact = found.scene.contact
    if contact is None:
        return
    key = "normal_penalty_factor" if contact.normal_penalty is None else "normal_penalty"
    stiffer = 10.0 * getattr(contact, key)
    level = min(found.levels, key=lambda level: level.spent)
    keys = {**level.overrides, "load": load, f"contact.{key}": stiffer}
    try:
        row = simulation.run(Scene.load(found.scene, keys), comm, quiet=True).history[-1]
    except (simulation.NotConverged, SceneError):
        return
    for column in found.columns:
        if level.values[column]:
            found.penalty_change[column] = abs(row[column] / level.values[column] - 1.0)
    progress.done(f"{key} = {stiffer:g}")


def _check_sizes(scene: Scene) -> None:
    if isinstance(scene.geometry, MeshFile):
        raise SceneError("geometry.file", "a mesh that is there", "a built shape, whose mesh sizes can be changed")
    if scene.mesh.size is None or getattr(scene.geometry, "divisions", None) is not None:
        raise SceneError("mesh.size", "a mesh whose cells are counted", "a built shape with mesh.size")


def _load_until(scene: Scene, step: int) -> dict[str, Any]:
    """The scene's load up to a step: whole stages, and the part of the last one."""
    every = list(steps(scene.load))
    chosen = every[:step]
    counts: dict[int, int] = {}
    for taken in chosen:
        counts[taken.stage] = counts.get(taken.stage, 0) + 1
    ends = np.cumsum(list(counts.values())) - 1
    factors = {name: [chosen[end].after[name] for end in ends] for name in scene.load.factors}
    return {"steps": list(counts.values()), "factors": factors}


def _as_run(scene: Scene, history: list[dict[str, Any]]) -> RunData:
    tables = scene.model_dump(mode="json", exclude_none=True)
    return RunData(scene.title, history, None, None, None, (scene.body_names, [p.name for p in scene.planes]), tables)


def _step(scene: Scene, history: list[dict[str, Any]]) -> int:
    """The step with the largest force on what moves; the last one where nothing does."""
    run = _as_run(scene, history)
    driver = driver_of(run)
    if driver is None:
        return len(history)
    force = np.abs(run.column(driver.force))
    return int(force.argmax()) + 1 if force.max() > 0.0 else len(history)


def _columns(scene: Scene, history: list[dict[str, Any]], wanted: Sequence[str]) -> list[str]:
    known = list(history[0])
    for name in wanted:
        if name not in known:
            raise SceneError(
                "--column", shown(name), f"a column of the history{near(name, known)}: see piezomat columns"
            )
    if wanted:
        return list(wanted)
    run = _as_run(scene, history)
    driver, electric = driver_of(run), electric_curve(run)
    found = [driver.force if driver is not None else "", electric.column if electric is not None else ""]
    names = [name for name in [*found, "capacitance"] if name in known and any(row[name] for row in history)]
    return names if len(names) > 1 else [*names, "elastic"]


def _level(
    order: int,
    overrides: Mapping[str, Any],
    summary: Mapping[str, Any],
    row: Mapping[str, Any],
    columns: Sequence[str],
    effort: float,
    *,
    whole: bool = False,
) -> Level:
    """effort: see `_path`. whole: the run was that of the whole load, which is taken for one of the study's."""
    values = {name: float(row[name]) for name in columns}
    seconds = summary["timings"]
    once = seconds["mesh"] + seconds["setup"]
    steps = seconds["total"] - once
    times = (seconds["total"], once + steps / effort) if whole else (once + steps * effort, seconds["total"])
    return Level(order, dict(overrides), summary["cells"], summary["dofs"], *times, values)


def _said(overrides: Mapping[str, Any]) -> str:
    return " ".join(f"{key}={value:g}" for key, value in overrides.items())
