"""The scene: read from a file or made in Python, checked as a whole, written as TOML.

    scene = Scene.load("crossed_fibers", ["contact.method=node"])
    scene = Scene.load("crossed_fibers", {"contact.method": "node"})
    scene = Scene(geometry={"shape": "facing_halves"}, mesh={"size": 0.1}, bodies={...}, boundaries=[...])

Both ways pass the same checks and raise SceneError, one line. Nothing here is collective.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, Self

from pydantic import ValidationError, model_validator

from piezomat.scene import toml as scene_file
from piezomat.scene.checks import check
from piezomat.scene.data import SceneData, groups_of
from piezomat.scene.errors import SceneError, named, unknown_name
from piezomat.scene.estimate import check_size
from piezomat.scene.validation import scene_error
from piezomat.scene.values import check_values, plain


class Scene(SceneData):
    """A scene whose checks have passed. Attributes mirror the keys of the file; units um, uN, MPa, V, pC, pJ.

    SceneError: a key is unknown, missing or out of range, or keys of several sections do not fit.
    """

    def __init__(self, **data: Any) -> None:
        try:
            data = plain(data)
        except RecursionError:
            raise SceneError("", "values nested too deeply", "the tables of a scene") from None
        check_values(data)
        _check_geometry_kind(data.get("geometry"))
        try:
            # As JSON: pydantic's strict rules for JSON are those of a file, text for paths among them.
            text = json.dumps(data)
            self.__pydantic_validator__.validate_json(text, strict=True, self_instance=self)
        except ValidationError as error:
            raise scene_error(error, data, schema()) from None

    def to_toml(self) -> str:
        """The scene as TOML with every default written out; `Scene.load` reads it back to the same scene."""
        data = self.model_dump(mode="json", exclude_none=True)
        for name, table in data["materials"].items():
            poling = self.poling(name)
            if poling is not None:
                table["poling"] = poling
            if poling == "across":
                table["axis1"] = "along"
        return scene_file.to_toml(data)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        check_size(self.geometry, self.mesh)
        self._groups = groups_of(self.geometry)
        check(self)
        return self


def _load(
    cls: type[Scene], scene: str | Path | Mapping[str, Any] | SceneData, overrides: scene_file.Overrides = ()
) -> Scene:
    """A scene with overrides in place: texts KEY=VALUE, or values by key such as {"geometry.radius": 0.2}.

    scene: the path of a file, the name of a shipped example, the sections of a scene as a dict, or a Scene. A relative
    `geometry.file` is relative to the scene file; in a dict, to the working folder. Raises SceneError.
    """
    if isinstance(scene, (Mapping, SceneData)):
        data = plain(scene)
        scene_file.override(data, overrides)
        return cls(**data)
    found = scene_file.find(scene)
    try:
        data = scene_file.read(found, overrides)
        return cls(**{"title": found.stem, **data})
    except SceneError as error:
        raise error.in_file(found) from None


# `load` is a section of a scene (attribute of instances) and the way to read one (of the class).
Scene.load = classmethod(_load)  # type: ignore[assignment]


@cache
def schema() -> dict[str, Any]:
    """The JSON schema of a scene file."""
    return Scene.model_json_schema()


def _check_geometry_kind(geometry: Any) -> None:
    """Raise SceneError unless a geometry table names exactly one of a known shape and a file."""
    if not isinstance(geometry, dict):
        return
    tables = [table.get("properties", {}) for table in schema()["$defs"].values()]
    shapes = [keys["shape"]["const"] for keys in tables if "shape" in keys]
    if "file" in geometry and geometry.get("shape", "fibers") != "fibers":
        raise SceneError("geometry.file", "both shape and file", 'either shape or file, or shape = "fibers" and file')
    if ("file" not in geometry or "shape" in geometry) and geometry.get("shape") not in shapes:
        if "shape" not in geometry:
            raise SceneError("geometry.shape", "nothing", f"{named(shapes)}; or file = a gmsh mesh")
        raise unknown_name("geometry.shape", geometry["shape"], "a known shape", shapes)
