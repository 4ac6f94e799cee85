"""The scene: the data model of a scene file, and every check that needs more than one of its sections.

    scene = Scene.load("crossed_fibers", ["contact.method=node"])
    scene = Scene(geometry={"shape": "facing_halves"}, mesh={"size": 0.1}, bodies={...}, boundaries=[...])

Both ways pass the same checks and raise SceneError, one line. Nothing here is collective.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from pydantic import BaseModel, Discriminator, Field, PrivateAttr, Tag, ValidationError, model_validator

from piezomat.forms.materials import BUILT_IN, Material
from piezomat.meshes.gmsh_io.mesh_file import MeshError, MeshFile, read_groups
from piezomat.meshes.shapes import MeshSizes, Shapes
from piezomat.scene import checks as scene_checks
from piezomat.scene import toml as scene_file
from piezomat.scene.errors import SceneError, named, scene_error, shown, unknown_name
from piezomat.scene.sections import (
    Boundary,
    Contact,
    Keys,
    Load,
    MaterialKeys,
    MeshKeys,
    ModelKeys,
    Name,
    Output,
    Plane,
    Solver,
)

__all__ = ["MeshError", "Scene", "SceneError", "mesh_error", "schema"]


class Groups(NamedTuple):
    """What a geometry consists of: its dimension and the names of bodies and groups of facets."""

    dimension: int
    bodies: tuple[str, ...]
    facets: tuple[str, ...]


def _branch(geometry: Any) -> str:
    """The branch of `Geometry` that a table of keys or a geometry belongs to."""
    given = isinstance(geometry, dict) and "file" in geometry and "shape" not in geometry
    file = given or isinstance(geometry, MeshFile)
    return "mesh file" if file else "built shape"


Geometry = Annotated[
    Annotated[Shapes, Tag("built shape")] | Annotated[MeshFile, Tag("mesh file")], Discriminator(_branch)
]


class Scene(Keys):
    """A scene. Attributes mirror the keys of the file; units um, uN, MPa, V, pC, pJ. Raises SceneError."""

    title: Name = Field("scene", description="default: the name of the file")
    geometry: Geometry = Field(description="a built shape or a gmsh mesh file")
    mesh: MeshKeys = Field(default_factory=MeshKeys)
    model: ModelKeys = Field(default_factory=ModelKeys)
    materials: dict[Name, MaterialKeys] = Field({}, description="materials of the scene by name")
    bodies: dict[str, Name] = Field(
        description='body, or pattern of bodies such as "ply_1_*" = material of the scene or built-in material'
    )
    boundaries: list[Boundary] = Field([], description="what is prescribed on groups of facets")
    planes: list[Plane] = Field([], description="rigid planes that the bodies meet")
    contact: Contact | None = None
    load: Load = Field(default_factory=Load)
    solver: Solver = Field(default_factory=Solver)
    output: Output = Field(default_factory=Output)

    _groups: Groups = PrivateAttr()

    def __init__(self, **data: Any) -> None:
        data = _plain(data)
        _check_geometry_kind(data.get("geometry"))
        try:
            # As JSON: pydantic's strict rules for JSON are those of a file, text for paths among them.
            text = json.dumps(data, default=str)
            self.__pydantic_validator__.validate_json(text, strict=True, self_instance=self)
        except ValidationError as error:
            raise scene_error(error, data, schema()) from None

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return self._groups.dimension

    @property
    def body_names(self) -> tuple[str, ...]:
        """Names of the bodies of the geometry, in its order."""
        return self._groups.bodies

    @property
    def facet_groups(self) -> tuple[str, ...]:
        """Names of the groups of facets of the geometry."""
        return self._groups.facets

    @property
    def electric(self) -> bool:
        """Whether any body carries a potential."""
        return any(self.oriented(name).permittivity is not None for name in set(self.bodies.values()))

    @property
    def sizes(self) -> MeshSizes:
        """Sizes, order and kind of the elements to build; sizes that no one asks for are the body's own."""
        size = self.mesh.size or (1.0 if isinstance(self.geometry, MeshFile) else self.geometry.size())
        contact_size = self.mesh.contact_size or size
        return MeshSizes(size, contact_size, self.mesh.order, self.mesh.cells, dict(self.mesh.size_factors))

    @cached_property
    def outcome(self) -> object | None:
        """What the recipe of the geometry came to, to be shown in words; None for a geometry that is no recipe."""
        return None if isinstance(self.geometry, MeshFile) else self.geometry.outcome()

    def material(self, body: str) -> Material:
        """The material of a body in global axes."""
        return self.oriented(self.bodies[scene_checks.key_of(body, self.bodies)])

    def oriented(self, name: str) -> Material:
        """A material of the scene, or else a built-in one, with its axes along poling (3) and axis1."""
        keys = self.materials.get(name)
        material = keys.unrotated() if keys is not None else BUILT_IN[name]
        poling = self.poling(name)
        if poling is None:
            return material
        return material.rotated(_in_space(poling), _in_space(keys.axis1 if keys is not None else None))

    def poling(self, name: str) -> list[float] | None:
        """Direction of axis 3 of a material: as given, or up (y in 2D, z in 3D) where it matters."""
        keys = self.materials.get(name)
        if keys is not None and keys.poling is not None:
            return keys.poling
        piezo = (keys.unrotated() if keys is not None else BUILT_IN[name]).piezo
        matters = piezo.any() or (keys is not None and keys.axis1 is not None)
        return ([0.0, 1.0] if self.dimension == 2 else [0.0, 0.0, 1.0]) if matters else None

    def to_toml(self) -> str:
        """The scene as TOML with every default written out; `Scene.load` reads it back to the same scene."""
        data = self.model_dump(mode="json", exclude_none=True)
        for name, table in data["materials"].items():
            poling = self.poling(name)
            if poling is not None:
                table["poling"] = poling
        return scene_file.to_toml(data)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        self._groups = _groups_of(self.geometry)
        scene_checks.bodies(self)
        scene_checks.mesh(self)
        scene_checks.gap(self)
        scene_checks.orientations(self)
        scene_checks.boundaries(self)
        scene_checks.planes(self)
        scene_checks.contact(self)
        scene_checks.load(self)
        return self


def _load(cls: type[Scene], path: str | Path, overrides: Sequence[str] = ()) -> Scene:
    """The scene of a file or of a shipped example, with overrides KEY=VALUE in place. Raises SceneError."""
    found = scene_file.find(path)
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


def _groups_of(geometry: Any) -> Groups:
    """The names that a geometry offers. Raises SceneError for a mesh file that cannot be read."""
    if not isinstance(geometry, MeshFile):
        try:
            return Groups(geometry.dimension, geometry.bodies(), geometry.facet_groups())
        except MeshError as error:
            raise mesh_error(error) from None
    if not geometry.file.is_file():
        raise SceneError("geometry.file", f"{shown(str(geometry.file))}: no such file", "a gmsh mesh (MSH 2.2 or 4.1)")
    try:
        return Groups(*read_groups(geometry.file))
    except MeshError as error:
        raise mesh_error(error) from None


def mesh_error(error: MeshError) -> SceneError:
    """A MeshError as an error of the scene, under the key that is to blame."""
    words = {"geometry.file": "a file of the geometry that can be used", "out": "a file that can be written"}
    key = "--out" if error.key == "out" else error.key
    return SceneError(key, str(error), words.get(error.key, "dimensions and sizes that can be meshed"))


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


def _plain(value: Any) -> Any:
    """Models, tuples, arrays and paths given in Python as a TOML file would give them."""
    if isinstance(value, BaseModel):
        return _plain(value.model_dump(mode="json", exclude_none=True))
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    return str(value.absolute()) if isinstance(value, Path) else value


def _in_space(direction: list[float] | None) -> list[float] | None:
    """The direction as a 3-vector."""
    return None if direction is None else [*direction, 0.0][:3]
