"""The commands `run plan mesh view resume schema`; README.md says what each does and its exit status.

Rank 0 alone reads and prints. What it reads, or its error, goes to every rank, so that all exit alike.
DOLFINx, gmsh and VTK are imported by the commands that need them: a wrong scene is reported at once.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import shutil
import sys
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from mpi4py import MPI

from piezomat import environment
from piezomat.cli_paths import check_directory, check_own, check_results, check_study, mesh_name, path_of
from piezomat.meshes.gmsh_io.model import MeshError
from piezomat.meshes.parallel import on_root
from piezomat.progress import ignore_broken_pipes
from piezomat.scene import Scene, SceneError, schema
from piezomat.scene import toml as scene_file
from piezomat.scene.errors import mesh_error, named
from piezomat.usage import importing

DONE, FAILED, WRONG_SCENE, NOT_CONVERGED = 0, 1, 2, 3


def main(argv: Sequence[str] | None = None) -> int:
    """Exit status of the command line `argv` (default: that of the process). Collective over all ranks."""
    comm = MPI.COMM_WORLD
    options: Any = None
    # The log of a run is its log.txt; the terminal gets the progress and the outcome.
    logger = logging.getLogger("piezomat")
    logger.propagate = False
    if not logger.handlers:
        logger.addHandler(logging.NullHandler())  # without any, the ranks that keep no log would print errors
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _log_warning
            options = on_root(comm, lambda: _parse(argv))
            return options if isinstance(options, int) else _COMMANDS[options.command](options, comm)
    except (SceneError, MeshError) as error:
        wrong = error if isinstance(error, SceneError) else mesh_error(error)
        return _fail(comm, wrong.in_file(_file(options)), WRONG_SCENE)
    except BaseException as error:
        words = _foreign(error)
        if words is not None:
            print(f"piezomat: {words}", file=sys.stderr, flush=True)
        else:
            traceback.print_exc()
            sys.stderr.flush()
        # The other ranks may wait for this one in a collective call, where no exception would reach them.
        if comm.size > 1:
            comm.Abort(FAILED)
        return FAILED


def _foreign(error: BaseException) -> str | None:
    """One line for an error of the system or of a library; None for an error of this program, which has a traceback."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted"
    if isinstance(error, MemoryError):
        return "there is not enough memory"
    if isinstance(error, OSError):
        return " ".join(str(error).split())
    if type(error).__module__.startswith("petsc4py"):
        return f"PETSc: {' '.join(str(error).strip().splitlines()[-1].split())}"
    return str(error) if type(error).__name__ == "LibraryError" else None


def _log_warning(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
    """Write a warning of a library to the log of the run: on the terminal it would be no line of this program."""
    logging.getLogger("piezomat").debug("%s: %s", category.__name__, message)


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(WRONG_SCENE, f"{self.prog}: {' '.join(message.split())}\n")


def _parse(argv: Sequence[str] | None) -> argparse.Namespace | int:
    """The options, or the exit status where there is nothing left to do (help, wrong arguments)."""
    parser = _Parser(prog="piezomat", description="Piezoelectric bodies in adhesive contact.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    of_scene = {
        "run": "run a scene",
        "plan": "what would be modelled and solved, and why; nothing is solved",
        "columns": "the columns of the history of a scene, with units and meanings; nothing is solved",
        "mesh": "write the mesh of a scene",
        "converge": "accuracy against time on a series of meshes, and the cheapest within a tolerance",
    }
    for name, purpose in of_scene.items():
        command = commands.add_parser(name, help=purpose, description=purpose)
        command.add_argument("scene", metavar="SCENE", nargs="?", help="path, or name of a shipped example")
        command.add_argument(
            "--set",
            nargs="+",
            action="extend",
            default=[],
            metavar="KEY=VALUE",
            help="override keys",
        )
        if name == "run":
            command.add_argument("--out", metavar="DIR", help="default: results/NAME of the scene")
        if name == "converge":
            command.add_argument("--within", type=_share, default=0.01, metavar="1%%", help="tolerance; default: 1%%")
            command.add_argument("--column", nargs="+", default=[], metavar="NAME", help="columns of the history")
            command.add_argument("--budget", type=float, default=240.0, metavar="S", help="of time, s; default: 240")
            command.add_argument("--out", metavar="DIR", help="default: results/NAME_converge")
        if name == "mesh":
            command.add_argument("--out", metavar="FILE.msh", required=True)
    for name, purpose in {
        "view": "draw pictures of a finished run",
        "report": "one page on a run: text, report.html, report.json",
        "resume": "go on from the last converged step of a run",
    }.items():
        command = commands.add_parser(name, help=purpose, description=purpose)
        command.add_argument("directory", type=_directory, metavar="DIR", help="directory of the run")
        if name == "view":
            _add_choices(command)
    commands.add_parser("schema", help="print the JSON schema of a scene file")
    try:
        options = parser.parse_args(argv)
        if options.command in of_scene and options.scene is None:
            _take_scene(options, commands.choices[options.command])
    except SystemExit as stop:
        return int(stop.code or DONE)
    return options


def _share(text: str) -> float:
    """A tolerance such as 1% or 0.01."""
    try:
        value = float(text.removesuffix("%")) * (0.01 if text.endswith("%") else 1.0)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1.0:
        raise argparse.ArgumentTypeError(f"found {text}; allowed: a share such as 1% or 0.01")
    return value


def _add_choices(command: argparse.ArgumentParser) -> None:
    """The options of `view`: what is drawn, by default what says most."""
    command.add_argument("--step", type=int, metavar="N", help="a step that has fields")
    command.add_argument("--field", help="colours the bodies: potential, displacement, von_mises, stress, strain, ...")
    command.add_argument("--component", help="x, y, z, or xx yy zz yz xz xy of stress and strain")
    command.add_argument("--x", metavar="COLUMN", help="of the history, below the curves; default: what moves")
    command.add_argument("--panel", nargs="+", default=[], metavar="NAME", help="of bodies, zone, pressure, curves")
    command.add_argument("--format", default="png", metavar="png|pdf|svg", help="default: png")


def _directory(text: str) -> Path:
    """A directory of the command line; without a name it would be the working directory."""
    if not text:
        raise argparse.ArgumentTypeError('found ""; allowed: the directory of a run')
    return Path(text)


def _take_scene(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """Find SCENE where it was written behind `--set KEY=VALUE`, which takes all the words that follow."""
    words = [word for word in options.set if "=" not in word]
    if len(words) != 1:
        shipped = named(scene_file.examples())
        parser.error(f"SCENE is missing: the path of a scene file or a shipped example: {shipped}")
    options.scene = words[0]
    options.set.remove(words[0])


def _run(options: argparse.Namespace, comm: MPI.Comm) -> int:
    scene = _scene(options, comm)
    path = scene_file.find(options.scene)
    out = Path("results") / path.stem
    if options.out is not None:
        out = on_root(comm, lambda: path_of(options.out, "a directory, new or of an older run"))
    on_root(comm, lambda: check_directory(out, path))
    return _simulate(scene, comm, out, resume=False)


def _resume(options: argparse.Namespace, comm: MPI.Comm) -> int:
    out: Path = options.directory
    on_root(comm, lambda: check_results(out))
    from piezomat.results.run_scene import of_run

    scene = on_root(comm, lambda: of_run(out))
    return _simulate(scene, comm, out, resume=True)


def _simulate(scene: Scene, comm: MPI.Comm, out: Path, *, resume: bool) -> int:
    with _compiled_forms(comm):
        return _simulate_with_cache(scene, comm, out, resume=resume)


def _simulate_with_cache(scene: Scene, comm: MPI.Comm, out: Path, *, resume: bool) -> int:
    with importing():
        from piezomat import simulation
        from piezomat.results.checkpoint import CheckpointError
        from piezomat.results.files import OutputError
        from piezomat.results.vtk import ResultsError

    try:
        simulation.run(scene, comm, out, resume=resume)
    except simulation.NotConverged as error:
        return _fail(comm, error, NOT_CONVERGED)
    except (simulation.Interrupted, OutputError, CheckpointError, ResultsError) as error:
        return _fail(comm, error, FAILED)
    return _done(comm, f"results in {out}")


def _plan(options: argparse.Namespace, comm: MPI.Comm) -> int:
    scene = _scene(options, comm)
    with _compiled_forms(comm):
        from piezomat import simulation

        return _result(comm, simulation.plan(scene, comm))


def _columns(options: argparse.Namespace, comm: MPI.Comm) -> int:
    scene = _scene(options, comm)
    with _compiled_forms(comm):
        from piezomat.results.column_list import columns_of

        return _result(comm, columns_of(scene, comm))


def _mesh(options: argparse.Namespace, comm: MPI.Comm) -> int:
    scene = _scene(options, comm)
    out = on_root(comm, lambda: mesh_name(options.out, scene))
    from piezomat.meshes import body_mesh

    try:
        body_mesh.write(comm, scene.geometry, scene.sizes, out)
    except MeshError as error:
        if error.key != "out":
            raise
        return _fail(comm, error, FAILED)
    return _done(comm, f"mesh in {out}")


def _converge(options: argparse.Namespace, comm: MPI.Comm) -> int:
    scene = _scene(options, comm)
    name = f"{scene_file.find(options.scene).stem}_converge"
    out = Path("results") / name if options.out is None else on_root(comm, lambda: path_of(options.out, "a directory"))
    on_root(comm, lambda: check_study(out))
    with _compiled_forms(comm):
        from piezomat import simulation
        from piezomat.converge.page import write
        from piezomat.converge.study import study

        try:
            found = study(scene, comm, within=options.within, columns=options.column, budget=options.budget)
        except simulation.NotConverged as error:
            return _fail(comm, error, NOT_CONVERGED)
        except simulation.Interrupted as error:
            return _fail(comm, error, FAILED)
        return _result(comm, on_root(comm, lambda: write(found, out)))


def _view(options: argparse.Namespace, comm: MPI.Comm) -> int:
    on_root(comm, lambda: check_results(options.directory, "history.csv"))
    on_root(comm, lambda: check_own(options.directory, "picture.*", "a picture"))
    from piezomat.pictures.picture import Choice, view
    from piezomat.results.vtk import ResultsError

    choice = Choice(options.step, options.field, options.component, options.x, tuple(options.panel))
    try:
        return _done(comm, *on_root(comm, lambda: view(options.directory, choice, options.format)))
    except ResultsError as error:
        return _fail(comm, error, WRONG_SCENE if str(error).startswith("--") else FAILED)


def _report(options: argparse.Namespace, comm: MPI.Comm) -> int:
    on_root(comm, lambda: check_results(options.directory, "history.csv"))
    on_root(comm, lambda: check_own(options.directory, "report.*", "a report"))
    from piezomat.report.page import report
    from piezomat.results.vtk import ResultsError

    try:
        return _result(comm, on_root(comm, lambda: report(options.directory)).rstrip("\n"))
    except ResultsError as error:
        return _fail(comm, error, FAILED)


def _schema(options: argparse.Namespace, comm: MPI.Comm) -> int:
    return _result(comm, json.dumps(schema(), indent=2))


_COMMANDS = {
    "run": _run,
    "plan": _plan,
    "columns": _columns,
    "mesh": _mesh,
    "converge": _converge,
    "view": _view,
    "report": _report,
    "resume": _resume,
    "schema": _schema,
}


def _scene(options: argparse.Namespace, comm: MPI.Comm) -> Scene:
    """The scene of the command, read by rank 0. Collective."""
    return on_root(comm, lambda: Scene.load(options.scene, options.set))


@contextmanager
def _compiled_forms(comm: MPI.Comm) -> Iterator[None]:
    """Context in which there is a folder for compiled forms: the user's, or a temporary one. Collective."""
    made = on_root(comm, environment.temporary_cache)
    environment.use_cache(made)
    try:
        yield
    finally:
        if made is not None and comm.rank == 0:
            shutil.rmtree(made, ignore_errors=True)


def _file(options: Any) -> str:
    """The scene file that a command works on, for its errors."""
    scene = getattr(options, "scene", None)
    return str(Path(options.directory) / "scene.toml") if scene is None else scene


def _done(comm: MPI.Comm, *lines: object) -> int:
    """Print on rank 0 what was done, which nobody needs to read."""
    _print(comm, lines)
    return DONE


def _result(comm: MPI.Comm, text: str) -> int:
    """Print on rank 0 what the command is for."""
    error = _print(comm, [text])
    if error is None or isinstance(error, BrokenPipeError):  # `| head`
        return DONE if error is None else FAILED
    return _fail(comm, OSError(f"standard output: {error.strerror or error}"), FAILED)


def _print(comm: MPI.Comm, lines: Sequence[object]) -> OSError | None:
    """Print on rank 0; the error, on all ranks, if that fails. Collective."""
    failure: OSError | None = None
    if comm.rank == 0:
        ignore_broken_pipes()
        try:
            for line in lines:
                print(line, flush=True)
        except OSError as error:
            failure = error
            # Python must not flush to the closed stream when it exits.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return comm.bcast(failure)


def _fail(comm: MPI.Comm, error: Exception, status: int) -> int:
    """Print the error as one line on rank 0 and return the exit status."""
    if comm.rank == 0:
        print(" ".join(str(error).split()), file=sys.stderr, flush=True)
    return status
