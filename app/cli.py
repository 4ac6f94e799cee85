"""The commands `run plan mesh view resume schema`; README.md says what each does and its exit status.

Rank 0 alone reads and prints. What it reads, or its error, goes to every rank, so that all exit alike.
DOLFINx, gmsh and VTK are imported by the commands that need them: a wrong scene is reported at once.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import signal
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from mpi4py import MPI

from piezomat.meshes.gmsh_io.model import MeshError
from piezomat.meshes.parallel import on_root
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
        options = on_root(comm, lambda: _parse(argv))
        return options if isinstance(options, int) else _COMMANDS[options.command](options, comm)
    except (SceneError, MeshError) as error:
        wrong = error if isinstance(error, SceneError) else mesh_error(error)
        return _fail(comm, wrong.in_file(_file(options)), WRONG_SCENE)
    except BrokenPipeError:
        # Python must not flush to the closed pipe when it exits.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            print("piezomat: interrupted", file=sys.stderr, flush=True)
        else:
            traceback.print_exc()
            sys.stderr.flush()
        # The other ranks may wait for this one in a collective call, where no exception would reach them.
        if comm.size > 1:
            comm.Abort(FAILED)
        return FAILED


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(WRONG_SCENE, f"{self.prog}: {message}\n")


def _parse(argv: Sequence[str] | None) -> argparse.Namespace | int:
    """The options, or the exit status where there is nothing left to do (help, wrong arguments)."""
    parser = _Parser(prog="piezomat", description="Piezoelectric bodies in adhesive contact.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    of_scene = {
        "run": "run a scene",
        "plan": "what would be modelled and solved, and why; nothing is solved",
        "mesh": "write the mesh of a scene",
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
            command.add_argument("--out", type=Path, metavar="DIR", help="default: results/NAME of the scene")
        if name == "mesh":
            command.add_argument("--out", type=Path, metavar="FILE.msh", required=True)
    for name, purpose in {
        "view": "draw pictures of a finished run",
        "resume": "go on from the last converged step of a run",
    }.items():
        command = commands.add_parser(name, help=purpose, description=purpose)
        command.add_argument("directory", type=Path, metavar="DIR", help="directory of the run")
    commands.add_parser("schema", help="print the JSON schema of a scene file")
    try:
        options = parser.parse_args(argv)
        if options.command in of_scene and options.scene is None:
            _take_scene(options, commands.choices[options.command])
    except SystemExit as stop:
        return int(stop.code or DONE)
    return options


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
    out = options.out or Path("results") / scene_file.find(options.scene).stem
    on_root(comm, lambda: _check_directory(out))
    return _simulate(scene, comm, out, resume=False)


def _resume(options: argparse.Namespace, comm: MPI.Comm) -> int:
    out: Path = options.directory
    on_root(comm, lambda: _check_results(out, "scene.toml"))
    scene = on_root(comm, lambda: _scene_of_run(out))
    return _simulate(scene, comm, out, resume=True)


def _simulate(scene: Scene, comm: MPI.Comm, out: Path, *, resume: bool) -> int:
    with importing():
        from piezomat import simulation
        from piezomat.results.checkpoint import CheckpointError
        from piezomat.results.vtk import ResultsError

    try:
        simulation.run(scene, comm, out, resume=resume)
    except simulation.NotConverged as error:
        return _fail(comm, error, NOT_CONVERGED)
    except (simulation.Interrupted, CheckpointError, ResultsError) as error:
        return _fail(comm, error, FAILED)
    return _done(comm, f"results in {out}")


def _plan(options: argparse.Namespace, comm: MPI.Comm) -> int:
    scene = _scene(options, comm)
    from piezomat import simulation

    return _done(comm, simulation.plan(scene, comm))


def _mesh(options: argparse.Namespace, comm: MPI.Comm) -> int:
    scene = _scene(options, comm)
    on_root(comm, lambda: _check_mesh_name(options.out))
    from piezomat.meshes.body_mesh import create

    create(comm, scene.geometry, scene.sizes, save=options.out)
    return _done(comm, f"mesh in {options.out}")


def _view(options: argparse.Namespace, comm: MPI.Comm) -> int:
    on_root(comm, lambda: _check_results(options.directory, "history.csv"))
    from piezomat.pictures import picture as pictures
    from piezomat.results.vtk import ResultsError

    try:
        return _done(comm, *on_root(comm, lambda: pictures.view(options.directory)))
    except ResultsError as error:
        return _fail(comm, error, FAILED)


def _schema(options: argparse.Namespace, comm: MPI.Comm) -> int:
    return _done(comm, json.dumps(schema(), indent=2))


_COMMANDS = {"run": _run, "plan": _plan, "mesh": _mesh, "view": _view, "resume": _resume, "schema": _schema}


def _scene(options: argparse.Namespace, comm: MPI.Comm) -> Scene:
    """The scene of the command, read by rank 0. Collective."""
    return on_root(comm, lambda: Scene.load(options.scene, options.set))


def _scene_of_run(out: Path) -> Scene:
    """The scene of a run, with the run's own copy of a mesh file, which may have changed since."""
    path, mesh = out / "scene.toml", out / "checkpoint" / "mesh.msh"
    geometry = scene_file.read(path).get("geometry", {})
    from_file = "file" in geometry and "shape" not in geometry
    copy = [f"geometry.file={json.dumps(str(mesh.absolute()))}"] if from_file and mesh.is_file() else []
    return Scene.load(path, copy)


def _check_directory(out: Path) -> None:
    """Raise SceneError unless results can be written to `out`, which need not exist."""
    there = next(path for path in (out, *out.absolute().parents) if path.exists())
    if not there.is_dir():
        raise SceneError("--out", f"{there}, which is a file", "a directory, new or of an older run")
    if not os.access(there, os.W_OK):
        raise SceneError("--out", f"{there}, which cannot be written to", "a writable directory")


def _check_mesh_name(out: Path) -> None:
    """Raise SceneError unless `out` can be the name of a new mesh file."""
    if out.suffix != ".msh":
        raise SceneError("--out", str(out), "a name that ends in .msh")
    if not out.absolute().parent.is_dir():
        raise SceneError("--out", f"{out}, in no directory", "a file in a directory that exists")


def _check_results(directory: Path, name: str) -> None:
    """Raise SceneError unless the directory holds that file of a run."""
    if not (directory / name).is_file():
        found = f"no {name} in it" if directory.is_dir() else "no such directory"
        raise SceneError("", found, "the directory of a run").in_file(directory)


def _file(options: Any) -> str:
    """The scene file that a command works on, for its errors."""
    return str(getattr(options, "scene", None) or Path(options.directory) / "scene.toml")


def _done(comm: MPI.Comm, *lines: object) -> int:
    """Print on rank 0."""
    if comm.rank == 0:
        # For PETSc, once loaded, a reader that has gone (`| head`) is a crash; for Python BrokenPipeError.
        signal.signal(signal.SIGPIPE, signal.SIG_IGN)
        for line in lines:
            print(line, flush=True)
    return DONE


def _fail(comm: MPI.Comm, error: Exception, status: int) -> int:
    """Print the error as one line on rank 0 and return the exit status."""
    if comm.rank == 0:
        print(" ".join(str(error).split()), file=sys.stderr, flush=True)
    return status
