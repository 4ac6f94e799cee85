"""The scene of a run: read from the folder of the run, and what of it may change before the run goes on.

The table or mesh that the scene reads is the run's own copy in the checkpoint, which stays as it was.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from itertools import islice
from pathlib import Path
from typing import Any

from mpi4py import MPI

from piezomat.results import checkpoint
from piezomat.results.folder import CHECKPOINT, FIBERS, MESH
from piezomat.scene import Scene, SceneError
from piezomat.scene import toml as scene_file
from piezomat.scene.errors import shown
from piezomat.solver.load_steps import steps

# Sections that a run takes up as they are when it goes on; of [load] what comes after the last step.
MAY_CHANGE = ("title", "solver", "output")
_SCENE = "scene.toml"


def text_of(scene: Scene) -> str:
    """The scene as TOML with every default, and with the absolute path of its file."""
    file = getattr(scene.geometry, "file", None)
    return (scene if file is None else _reading(scene, file.absolute())).to_toml()


def of_run(out: Path) -> Scene:
    """The scene in the folder of a run, as it may have been edited since; without scene.toml that of the checkpoint.

    SceneError: it is wrong, or there is none. Not collective.
    """
    path = out / _SCENE
    try:
        return _scene(scene_file.read(path) if path.is_file() else tomllib.loads(_scene_of_checkpoint(out)), out)
    except SceneError as error:
        raise error.in_file(path) from None


def check_unchanged(scene: Scene, before: str, step: int, out: Path) -> None:
    """Raise SceneError unless a run can go on with `scene` after `step`, having begun with the scene `before` (TOML).

    The error names the first key that differs.
    """
    first = _scene(tomllib.loads(before), out)
    old, new = (tomllib.loads(text_of(scene)) for scene in (first, scene))
    for key in MAY_CHANGE:
        old.pop(key, None)
        new.pop(key, None)
    loads = old.pop("load", {}), new.pop("load", {})
    difference = _difference(old, new, "")
    if difference is None and _steps(first, step) != _steps(scene, step):
        difference = _difference(*loads, "load")
    if difference is None:
        return
    key, was, found = difference
    may = f"{', '.join(MAY_CHANGE)} and the load after step {step} may change"
    allowed = f"{shown(was)}, with which the run began ({may}); a new run takes other values"
    raise SceneError(key, found if found is None else shown(found), allowed).in_file(out / _SCENE)


def _scene(tables: dict[str, Any], out: Path) -> Scene:
    """The scene of tables, which reads the run's own copy of its file but names the file that it named."""
    geometry = tables.get("geometry")
    if not isinstance(geometry, dict) or not isinstance(geometry.get("file"), str):
        return Scene(**tables)
    copy = out / CHECKPOINT / (FIBERS if "shape" in geometry else MESH)
    if not copy.is_file():
        return Scene(**tables)
    scene = Scene(**(tables | {"geometry": geometry | {"file": str(copy.absolute())}}))
    return _reading(scene, Path(geometry["file"]))


def _scene_of_checkpoint(out: Path) -> str:
    try:
        scalars = checkpoint.load(MPI.COMM_SELF, out / CHECKPOINT).scalars
    except checkpoint.CheckpointError as error:
        raise SceneError("", f"no {_SCENE}, and {error}", "the directory of a run").in_file(out) from None
    if not isinstance(scalars, dict) or not isinstance(scalars.get("scene"), str):
        raise SceneError("", f"no {_SCENE}", "the directory of a run").in_file(out)
    return scalars["scene"]


def _reading(scene: Scene, file: Path) -> Scene:
    return scene.model_copy(update={"geometry": scene.geometry.model_copy(update={"file": file})})


def _steps(scene: Scene, last: int) -> list[Any]:
    """Stage and factors of the steps up to the last one taken."""
    return [(step.stage, step.after) for step in islice(steps(scene.load), last)]


def _difference(old: Any, new: Any, path: str) -> tuple[str, Any, Any] | None:
    """The first key that differs, with the old and the new value; None: there is none."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        inner = [(f"{path}.{key}" if path else str(key), old.get(key), new.get(key)) for key in [*old, *new]]
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        inner = [(f"{path}[{i}]", a, b) for i, (a, b) in enumerate(zip(old, new, strict=True))]
    else:
        return None if old == new and isinstance(old, bool) == isinstance(new, bool) else (path, old, new)
    return next((found for name, a, b in inner if (found := _difference(a, b, name)) is not None), None)
