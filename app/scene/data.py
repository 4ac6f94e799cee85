"""What a scene file holds, and what follows from it at once: names, sizes, materials in global axes.

`Scene` adds the ways to read and write it and the checks. Nothing here is collective.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple, Union

import numpy as np
from numpy.typing import NDArray
from pydantic import Discriminator, Field, PrivateAttr, Tag

from piezomat.forms.constitutive import ConstitutiveLaw
from piezomat.forms.material_library import BUILT_IN
from piezomat.meshes.builders.centre_lines import Fiber
from piezomat.meshes.gmsh_io.mesh_file import MeshFile, read_groups
from piezomat.meshes.gmsh_io.model import MeshError
from piezomat.meshes.shapes import MeshSizes, catalogue
from piezomat.scene.errors import SceneError, mesh_error, shown
from piezomat.scene.keys import Keys, Name
from piezomat.scene.material_keys import MaterialKeys
from piezomat.scene.sections import (
    Boundary,
    Circuit,
    Contact,
    Electrode,
    Load,
    MeshKeys,
    ModelKeys,
    Output,
    Plane,
    Solver,
)


class Groups(NamedTuple):
    """What a geometry consists of: its dimension and the names of bodies and groups of facets."""

    dimension: int
    bodies: tuple[str, ...]
    facets: tuple[str, ...]


class Members(NamedTuple):
    """What an electrode consists of, by name."""

    facet_groups: tuple[str, ...]
    bodies: tuple[str, ...]
    planes: tuple[str, ...]


def _branch(geometry: Any) -> str:
    """The branch of `Geometry` that a table of keys or a geometry belongs to."""
    given = isinstance(geometry, dict) and "file" in geometry and "shape" not in geometry
    file = given or isinstance(geometry, MeshFile)
    return "mesh file" if file else "built shape"


Shapes = Annotated[Union[tuple(catalogue())], Field(discriminator="shape")]  # noqa: UP007 - of a list
Geometry = Annotated[
    Annotated[Shapes, Tag("built shape")] | Annotated[MeshFile, Tag("mesh file")], Discriminator(_branch)
]


class SceneData(Keys):
    """The keys of a scene file and what they amount to. Units um, uN, MPa, V, pC, pJ."""

    title: Name = Field("scene", description="names the run in picture and messages; of a file without title its name")
    geometry: Geometry = Field(description="a built shape or a gmsh mesh file")
    mesh: MeshKeys = Field(default_factory=MeshKeys)
    model: ModelKeys = Field(default_factory=ModelKeys)
    materials: dict[Name, MaterialKeys] = Field({}, description="materials of the scene by name")
    bodies: dict[str, Name] = Field(
        description='body, or pattern of bodies such as "ply_1_*" = material of the scene or built-in material'
    )
    boundaries: list[Boundary] = Field([], description="what is prescribed on groups of facets")
    planes: list[Plane] = Field([], description="rigid planes that the bodies meet")
    electrodes: list[Electrode] = Field([], description="facet groups, bodies and planes at one potential each")
    circuits: list[Circuit] = Field([], description="what is connected between electrodes")
    contact: Contact | None = None
    load: Load = Field(default_factory=Load)
    solver: Solver = Field(default_factory=Solver)
    output: Output = Field(default_factory=Output)

    _groups: Groups = PrivateAttr()

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
        return any(self.oriented(name).electric for name in set(self.bodies.values()))

    @property
    def potentials(self) -> list[float]:
        """The potentials that boundaries, planes and electrodes are given, without their factors."""
        rows = [*self.boundaries, *self.planes, *self.electrodes]
        return [row.potential for row in rows if row.potential is not None]

    @property
    def sizes(self) -> MeshSizes:
        """Sizes, order and kind of the elements to build; without `mesh.size` the size is that of the smallest body."""
        size = self.mesh.size or (1.0 if isinstance(self.geometry, MeshFile) else self.geometry.size())
        contact_size = self.mesh.contact_size or size
        return MeshSizes(size, contact_size, self.mesh.order, self.mesh.cells, dict(self.mesh.size_factors))

    @cached_property
    def outcome(self) -> object | None:
        """Measures of a recipe (crossings, porosity, ...), whose `str` is for the log; None for other geometries."""
        return None if isinstance(self.geometry, MeshFile) else self.geometry.outcome()

    def members(self, electrode: Electrode) -> Members:
        """The facet groups, bodies and planes that the names and patterns of an electrode stand for."""
        kinds = self.facet_groups, self.body_names, [plane.name for plane in self.planes]
        return Members(*(tuple(n for n in names if key_of(n, electrode.on) is not None) for names in kinds))

    def push(self, plane: Plane) -> tuple[NDArray[np.float64], float]:
        """Direction (d,) along which a plane by force moves, and the force along it at a load factor of 1, uN."""
        if plane.force is not None:
            size = float(np.linalg.norm(plane.force))
            return np.array(plane.force) / size, size
        return plane.inward(self.dimension), plane.pressure * self.area_of(plane)

    def area_of(self, plane: Plane) -> float | None:
        """Area of a plane, um2 (2D: um): given, or of a box seen from above; None: unknown."""
        if plane.area is not None or isinstance(self.geometry, MeshFile) or plane.point not in ("bottom", "top"):
            return plane.area
        return self.geometry.area

    @cached_property
    def centre_lines(self) -> Mapping[str, Fiber]:
        """Centre line of each body that has one, by name."""
        return {} if isinstance(self.geometry, MeshFile) else self.geometry.centre_lines()

    def material_name(self, body: str) -> str:
        """Name of the material of a body."""
        return self.bodies[key_of(body, self.bodies)]

    def material(self, body: str) -> ConstitutiveLaw:
        """The material of a body in global axes; in its own axes where they follow the centre line."""
        return self.oriented(self.material_name(body))

    def follows_line(self, name: str) -> bool:
        """Whether the axes of a material follow the centre line of each of its bodies."""
        keys = self.materials.get(name)
        return keys is not None and keys.follows_line

    def oriented(self, name: str) -> ConstitutiveLaw:
        """A material of the scene, or else a built-in one, with its axes along poling (3) and axis1.

        In its own axes where they follow the centre lines.
        """
        keys = self.materials.get(name)
        material = keys.unrotated() if keys is not None else BUILT_IN[name]
        poling = self.poling(name)
        if poling is None or self.follows_line(name):
            return material
        return material.rotated(in_space(poling), in_space(keys.axis1) if keys is not None else None)

    def poling(self, name: str) -> list[float] | Literal["across"] | None:
        """Direction of axis 3 of a material: as given, or up (y in 2D, z in 3D) where it matters."""
        keys = self.materials.get(name)
        if keys is not None and keys.poling is not None:
            return keys.poling
        poled = (keys.unrotated() if keys is not None else BUILT_IN[name]).is_piezoelectric
        matters = poled or (keys is not None and keys.axis1 is not None)
        return ([0.0, 1.0] if self.dimension == 2 else [0.0, 0.0, 1.0]) if matters else None


def groups_of(geometry: Any) -> Groups:
    """The names that a geometry offers. SceneError: a mesh file that cannot be read."""
    if not isinstance(geometry, MeshFile):
        try:
            return Groups(geometry.dimension, geometry.bodies(), geometry.facet_groups())
        except MeshError as error:
            raise mesh_error(error) from None
        except Exception as error:  # of NumPy and SciPy, for numbers that do not go together
            words = " ".join(str(error).split())[:200]
            raise SceneError(
                "geometry", f"a shape that cannot be made: {words}", "dimensions that fit together"
            ) from None
    if not geometry.file.is_file():
        raise SceneError("geometry.file", f"{shown(str(geometry.file))}: no such file", "a gmsh mesh (MSH 2.2 or 4.1)")
    try:
        return Groups(*read_groups(geometry.file))
    except MeshError as error:
        raise mesh_error(error) from None


def key_of(body: str, keys: Iterable[str]) -> str | None:
    """The key that stands for a body: its name, or else the first pattern that fits it; None for none."""
    keys = list(keys)
    return body if body in keys else next((key for key in keys if "*" in key and fnmatchcase(body, key)), None)


def in_space(direction: list[float] | None) -> list[float] | None:
    """The direction as a 3-vector."""
    return None if direction is None else [*direction, 0.0][:3]
