"""What the paths of the command line may be: checked before any work, by rank 0. Each check raises SceneError."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from piezomat.results.folder import check_free, check_scene_stays, is_of_a_run
from piezomat.scene import Scene, SceneError
from piezomat.scene import toml as scene_file
from piezomat.scene.errors import LONGEST, shown


def path_of(text: str, allowed: str) -> Path:
    """The value of --out as a path. Raises SceneError for one that the system does not take."""
    if not text:
        raise SceneError("--out", '""', allowed)
    try:
        os.stat(text)
    except (FileNotFoundError, NotADirectoryError):
        pass
    except (OSError, ValueError) as error:
        raise SceneError("--out", f"{shown(text)}: {getattr(error, 'strerror', None) or error}", allowed) from None
    return Path(text)


def check_directory(out: Path, scene: Path) -> None:
    """Raise SceneError unless results of a scene file can be written to `out`, which need not exist."""
    there = next(path for path in (out, *out.absolute().parents) if path.exists())
    if not there.is_dir():
        raise SceneError("--out", f"{there}, which is a file", "a directory, new or of an older run")
    check_writable(there)
    check_scene_stays(out, scene)
    check_free(out)


def check_study(out: Path) -> None:
    """Raise SceneError unless the files of a convergence study can be written to `out`, which need not exist."""
    there = next(path for path in (out, *out.absolute().parents) if path.exists())
    if not there.is_dir():
        raise SceneError("--out", f"{there}, which is a file", "a directory, new or of an older study")
    check_writable(there)


def check_writable(there: Path) -> None:
    """Raise SceneError unless a file can be made in a directory."""
    try:
        os.rmdir(tempfile.mkdtemp(dir=there, prefix=".piezomat-"))  # a mode says nothing of /proc, nor to root
    except OSError as error:
        raise SceneError(
            "--out", f"{there}, which cannot be written to ({error.strerror})", "a writable directory"
        ) from None


def check_own(directory: Path, names: str, what: str) -> None:
    """Raise SceneError where a file would be replaced that no run has made."""
    if any(directory.glob(names)) and not is_of_a_run(directory):
        raise SceneError("", f"{what} that no run has drawn", "the directory of a run").in_file(directory)


def mesh_name(text: str, scene: Scene) -> Path:
    """The name of a new mesh file. Raises SceneError for a text that can be none, and for a file the scene reads."""
    out = path_of(text, "a name that ends in .msh")
    if out.suffix != ".msh":
        raise SceneError("--out", str(out), "a name that ends in .msh")
    if not out.absolute().parent.is_dir():
        raise SceneError("--out", f"{out}, in no directory", "a file in a directory that exists")
    check_writable(out.absolute().parent)
    if out.exists() and (file := getattr(scene.geometry, "file", None)) is not None and out.samefile(file):
        raise SceneError("--out", f"{out}, which the scene reads", "another file")
    return out


def check_results(directory: Path, name: str = "") -> None:
    """Raise SceneError unless there is the directory and, where a name is given, that file of a run in it."""
    if not (scene_file.is_file(directory / name) if name else scene_file.is_directory(directory)):
        found = f"no {name} in it" if scene_file.is_directory(directory) else "no such directory"
        name = str(directory)
        raise SceneError("", found, "the directory of a run").in_file(shown(name) if len(name) > LONGEST else directory)
