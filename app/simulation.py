"""One run from the scene to the results: mesh, model, contact, load steps, files."""

from __future__ import annotations

import logging
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import Any

from mpi4py import MPI

from piezomat import __version__, environment
from piezomat.assembly.problem import Problem
from piezomat.assembly.terms import NewTerm, Terms
from piezomat.contact.cohesive_zone import coarse_cohesive_zone
from piezomat.contact.interfaces import Interfaces
from piezomat.contact.setup import interfaces_of
from piezomat.contact.short_circuit import short_circuit
from piezomat.contact.start_checks import check_start
from piezomat.contact.unseen_penetration import unseen_corners
from piezomat.discretization.model import Model
from piezomat.interrupts import StopRequest, stop_on_signal
from piezomat.meshes.body_mesh import BodyMesh, Partition
from piezomat.meshes.parallel import on_root
from piezomat.meshes.shapes.mats import Fibers
from piezomat.progress import Progress
from piezomat.results import restart
from piezomat.results.atomic import temporary_name
from piezomat.results.checkpoint import Checkpoint, CheckpointError
from piezomat.results.energy_balance import EnergyBalance
from piezomat.results.fields import FieldOutput, contact_points
from piezomat.results.files import OutputError, Results
from piezomat.results.folder import CHECKPOINT, MESH, RunFolder
from piezomat.results.quantities import columns, pair_columns, pair_rows, row
from piezomat.results.run_doubts import RunDoubts
from piezomat.results.run_mesh import mesh_of_run
from piezomat.results.run_scene import text_of
from piezomat.results.summary import summary, summary_values
from piezomat.scene import Scene
from piezomat.scene.errors import named
from piezomat.solver.description import describe
from piezomat.solver.load_steps import Step, Stepper, StepReport, steps
from piezomat.solver.newton import Newton
from piezomat.solver.outcome import ERRATIC, SolveError
from piezomat.solver.step_watch import StepWatch, StopRequested, TooManyIterations
from piezomat.usage import Timer

log = logging.getLogger("piezomat")


class NotConverged(RuntimeError):
    """The run ended before its last step; the message says why and what is kept. Raised on all ranks."""


class Interrupted(RuntimeError):
    """A signal has ended the run; the message says what is kept. Raised on all ranks."""


# Called with the problem, its interfaces (None without any) and the row of each step that has converged.
Watch = Callable[[Problem, Interfaces | None, Mapping[str, Any]], object]


@dataclass(repr=False)
class Run:
    """A finished run.

    history: a row for each load step, by column. capacitance: matrix of the electrodes at the end of each step, pC/V
    (2D: per um of depth). summary: see `piezomat.results.summary`. model, problem: with the last state. contact: its
    interfaces, evaluated there; None without any. bodies: the mesh.
    """

    history: list[dict[str, Any]]
    capacitance: list[list[list[float]]]
    summary: dict[str, Any]
    model: Model
    problem: Problem
    contact: Interfaces | None
    bodies: BodyMesh

    @property
    def state(self) -> Any:
        """The last state as a dolfinx Function: displacement (um) and potential / model.potential_scale. Collective."""
        return self.problem.solution()


def run(
    scene: Scene,
    comm: MPI.Comm,
    out: Path | None = None,
    *,
    resume: bool = False,
    partition: Partition | None = None,
    quiet: bool = False,
    watch: Watch | None = None,
    terms: Sequence[NewTerm] = (),
) -> Run:
    """History and last state of a scene; with `out`, its results are written there. Collective.

    resume: continue from the checkpoint in `out`, on any number of ranks. partition: which rank gets which cell (for
    tests). quiet: nothing is printed. watch: see `Watch`. terms: what makes terms of the problem beside its own, from
    its model.

    SceneError: the scene is wrong, `out` is not free for the run or another run is at work there, or `resume` finds
    another scene; raised before any work. CheckpointError: there is no sound checkpoint. NotConverged, Interrupted,
    OutputError: the steps that converged are kept in `out`.
    """
    timer = Timer()
    read = [file] if (file := getattr(scene.geometry, "file", None)) is not None else []
    owned = RunFolder(comm, out, resume=resume, read=read) if out is not None else None
    with owned or nullcontext(), stop_on_signal(comm) as stop:
        stored = restart.find(comm, out, scene) if resume else None
        # Until the folder is the run's, the mesh has a temporary name there.
        saved = temporary_name(out / MESH) if owned is not None and not resume else None
        with timer("mesh"):
            bodies = mesh_of_run(scene, comm, out, resume=resume, save=saved, partition=partition)
        with timer("setup"):
            model = Model(scene, bodies)
            contact = interfaces_of(model)
        with timer("assembly"):
            every = Terms.of(model, contact, terms)
        problem = Problem(model, every, timer)
        newton = Newton(problem, every, scene.solver, StepWatch(stop.requested))
        augment_tolerance = scene.contact.augment if scene.contact is not None else None
        stepper = Stepper(problem, every, newton, scene.solver.max_cutbacks, augment_tolerance)
        balance = EnergyBalance(problem, every)
        if not resume:
            check_start(model, contact, problem.state)
        session = _Session(scene, comm, out, timer, model, problem, every, stepper, balance, quiet, watch)
        try:
            if stored is not None:
                session.resume(stored, owned)
            else:
                session.start(saved, owned)
            session.take_steps(stop)
        except OutputError as error:
            raise session.failed(error) from error
        finally:
            session.close()
            newton.close()
            problem.close()
    return Run(session.history, session.capacitance, session.summary, model, problem, contact, bodies)


@dataclass
class _Session:
    """The load steps of a run and their results; without `out` nothing is written.

    history: rows of the steps that have converged. capacitance: matrices of the electrodes at the end of each.
    last_step (int): number of the last of them, 0 for none.
    results: the files of the run, None without `out`.
    """

    scene: Scene
    comm: MPI.Comm
    out: Path | None
    timer: Timer
    model: Model
    problem: Problem
    terms: Terms
    stepper: Stepper
    balance: EnergyBalance
    quiet: bool
    watch: Watch | None

    def __post_init__(self) -> None:
        self.summary: dict[str, Any] = {}
        self.history: list[dict[str, Any]] = []
        self.capacitance: list[list[list[float]]] = []
        self._doubts = RunDoubts(self.problem, self.terms.contact)
        self.results = Results(self.out, self.comm) if self.out is not None else None
        self.last_step = 0
        self._scene_text = text_of(self.scene)
        self._saved_step = 0
        self._mesh_digest = ""
        self._fields: FieldOutput | None = None

    def start(self, saved: Path | None, folder: RunFolder | None) -> None:
        """Start the result files; `saved` is the mesh in the folder under a temporary name."""
        names = columns(self.model, self.terms.contact)
        if self.results is None or folder is None:
            return
        with self.timer("output"):
            folder.keep()
            geometry = self.scene.geometry
            self.results.start(self._scene_text, names, saved, geometry.file if isinstance(geometry, Fibers) else None)
            self._warn_of_locks(folder)
            self._mesh_digest = on_root(self.comm, lambda: restart.sha256(self.out / CHECKPOINT / MESH))
            self._save_checkpoint()

    def resume(self, stored: Checkpoint, folder: RunFolder) -> None:
        """Take up an interrupted run where its checkpoint ends, and its result files."""
        names = columns(self.model, self.terms.contact)
        with self.timer("output"):
            restart.restore(stored, self.problem, self.stepper, self.balance)
            self.last_step = self._saved_step = stored.step
            self.history = [dict(row) for row in stored.scalars.history]
            self.capacitance = [*stored.scalars.capacitance]
            self._mesh_digest = stored.scalars.mesh or on_root(
                self.comm, lambda: restart.sha256(self.out / CHECKPOINT / MESH)
            )
            self._last_state = self.problem.copy_state()
            self._restore_last_step()
            self.results.resume(names, self.last_step, self.history, self._scene_text)
            folder.keep()
        self._warn_of_locks(folder)
        if stored.damage:
            log.warning("%s; the checkpoint before it is used", stored.damage)
            if self.comm.rank == 0:
                print(f"piezomat: {stored.damage}; the checkpoint before it is used", file=sys.stderr)
        if stored.scalars.scene is None:
            log.warning("the checkpoint does not hold its scene: whether it has changed since is not known")
        by = stored.scalars.version
        version = f", from a checkpoint of piezomat {by}" if by != __version__ else ""
        log.info("resumed after step %d on %s%s", self.last_step, _ranks(self.comm.size), version)

    def take_steps(self, stop: StopRequest) -> None:
        """Take the load steps that are left and write the results of each. Raises NotConverged or Interrupted."""
        todo = [step for step in steps(self.scene.load) if step.number > self.last_step]
        progress = Progress(self.comm, self.scene.title, self.last_step + len(todo), self.last_step, quiet=self.quiet)
        reason = "all load steps converged"
        failure: Exception | None = None
        erratic: list[str] = []
        self.stepper.watch.show_with(progress.working)
        with progress:
            if self.scene.outcome is not None:
                log.info("%s", self.scene.outcome)
            for note in environment.notes():
                log.warning("%s", note)
            log.info("%s", describe(self.problem, self.terms.contact, self.stepper.newton.linear))
            contact = self.terms.contact
            for text in [*self.model.warnings, coarse_cohesive_zone(self.model, contact), unseen_corners(contact)]:
                if text is not None:
                    progress.warn(text)
            for step in todo:
                if stop.requested():
                    failure = self._interrupted("")
                    break
                began = perf_counter()
                try:
                    report = self.stepper.advance(step, lambda part: self.balance.add_part(part.snap_through_work))
                    self._check_electrodes(step)
                except StopRequested as where:
                    failure = self._interrupted(f" {where}")
                    break
                except (SolveError, TooManyIterations) as error:
                    failure = NotConverged(f"{error}; {self._what_is_kept(self.last_step)}")
                    break
                self._record(step, report, self.comm.bcast(perf_counter() - began))
                progress.step(self.history[-1])
                for text in self._doubts.step(step.number, lambda: self._field_output().piece()):
                    progress.warn(text)
                if report.is_erratic:
                    erratic.append(str(step.number))
            if erratic:
                progress.warn(ERRATIC.format(steps=named(erratic)))
            for text in self._doubts.end(self.history):
                progress.warn(text)
        if failure is not None:
            reason = str(failure)
            log.error("%s", reason)
            self._restore_last_step()
        self._conclude(failure is None, reason, progress.warnings)
        if failure is not None:
            raise failure

    def close(self) -> None:
        """Close the log."""
        if self.results is not None:
            self.results.close()

    def failed(self, error: Exception) -> OutputError:
        """What to raise where results cannot be written."""
        log.error("%s", error)
        return OutputError(f"{error}; {self._what_is_kept(self._saved_step)}")

    def _warn_of_locks(self, folder: RunFolder) -> None:
        if not folder.locked:
            log.warning("%s lies in a file system without locks: nothing keeps a second run out", self.out)

    def _check_electrodes(self, step: Step) -> None:
        """Raise SolveError if electrodes at different potentials have come into contact."""
        contact = self.terms.contact
        found = short_circuit(self.model, contact, step.after) if contact is not None else None
        if found is not None:
            raise SolveError(f"in step {step.number} {found}")

    def _record(self, step: Step, report: StepReport, seconds: float) -> None:
        capacitance = cache(self.stepper.newton.capacitance)
        self.history.append(row(self.problem, self.terms, self.balance, step, report, seconds, capacitance))
        if (matrix := capacitance()) is not None:
            self.capacitance.append(matrix.tolist())
        self.last_step = step.number
        self._last_state = self.problem.copy_state()  # a later step may fail after some of its parts have converged
        if self.watch is not None:
            self.watch(self.problem, self.terms.contact, self.history[-1])
        if self.results is None:
            return
        with self.timer("output"):
            # The checkpoint holds the history too and comes after the fields: a run killed between any two of these
            # writes loses nothing, since on resuming it repeats what is not in the checkpoint.
            if self.scene.output.fields == "all":
                self._write_fields()
            self._write_pairs()
            self._save_checkpoint()
            self.results.row(self.history[-1])

    def _restore_last_step(self) -> None:
        """Return to the end of the last step that converged as a whole, with contact evaluated there."""
        if self.last_step == 0:
            return
        self.problem.restore(self._last_state)
        self.stepper.revisit()
        self.balance.restart_planes()

    def _conclude(self, converged: bool, reason: str, warnings: list[str]) -> None:
        if self.results is not None:
            with self.timer("output"):
                if self.history and self.scene.output.fields == "end":
                    self._write_fields()
        outcome = {"converged": converged, "reason": reason, "warnings": warnings}
        values = summary_values(self.model, self.terms.contact, self.timer, self.capacitance, outcome)
        if self.results is None:
            self.summary = summary(self.comm, self.history, values)
            return
        self.summary = self.results.summary(values)
        if self.scene.output.picture and self.history:
            with self.timer("output"):
                on_root(self.comm, self._picture)

    def _write_pairs(self) -> None:
        contact = self.terms.contact
        if contact is not None and contact.surface_pairs:
            self.results.pairs(self.last_step, pair_columns(self.model), pair_rows(contact, self.model))

    def _field_output(self) -> FieldOutput:
        if self._fields is None:
            self._fields = FieldOutput(self.problem)
        return self._fields

    def _write_fields(self) -> None:
        self.results.fields(self.last_step, float(self.last_step), self._field_output().piece())
        if self.terms.contact is not None:
            points = contact_points(self.terms.contact, self.model)
            self.results.contact(self.last_step, points, float(self.last_step))

    def _save_checkpoint(self) -> None:
        try:
            restart.save(
                self.out / CHECKPOINT,
                self.last_step,
                self.problem,
                self.stepper,
                self.balance,
                self.history,
                self.capacitance,
                self._scene_text,
                self._mesh_digest,
            )
        except CheckpointError as error:
            raise OutputError(str(error)) from error
        self._saved_step = self.last_step

    def _picture(self) -> None:
        from piezomat.pictures.picture import view

        try:
            view(self.out)
        except Exception as error:  # a picture must not cost the run its results
            log.warning("no picture: %s", error)
            print(f"piezomat: no picture: {error}", file=sys.stderr)

    def _interrupted(self, where: str) -> Interrupted:
        resume = f"; go on with: piezomat resume {shlex.quote(str(self.out))}" if self.out is not None else ""
        return Interrupted(f"interrupted{where}: {self._what_is_kept(self.last_step)}{resume}")

    def _what_is_kept(self, last: int) -> str:
        where = f" in {self.out}" if self.out is not None else ""
        return f"steps 1 to {last} are kept{where}" if last > 0 else "no step had converged"


def plan(scene: Scene, comm: MPI.Comm) -> str:
    """What would be modelled and solved, and why; nothing is solved. Collective."""
    from piezomat.plan_text import plan_text

    model = Model(scene, mesh_of_run(scene, comm))
    return plan_text(scene, model, interfaces_of(model))


def _ranks(number: int) -> str:
    return "1 rank" if number == 1 else f"{number} ranks"
