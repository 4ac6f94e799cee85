"""Base class of the built-in shapes."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import BaseModel, ConfigDict

from piezomat.meshes.builders.centre_lines import Fiber
from piezomat.meshes.builders.sizes import MeshSizes


class Shape(BaseModel):
    """Geometry with named bodies and facet groups, known before it is meshed. Lengths in um.

    A shape for scenes has a field `shape`, the Literal of its name.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @property
    def dimension(self) -> int:
        """2 or 3."""
        raise NotImplementedError

    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies, in the order of their numbers."""
        raise NotImplementedError

    def facet_groups(self) -> tuple[str, ...]:
        """Names of the facet groups."""
        raise NotImplementedError

    def centre_lines(self) -> Mapping[str, Fiber]:
        """Centre line of each body that has one, by name, which axes of materials may follow; none in 2D."""
        return {}

    def size(self) -> float:
        """Least extent of the smallest body (um)."""
        raise NotImplementedError

    @property
    def area(self) -> float | None:
        """Area of the box seen from above (um2; in 2D its width, um); None where bodies do not fill a box."""
        return None

    def measure(self) -> float:
        """Area or volume (um2, um3) of all bodies, about: the number of cells is estimated from it."""
        return len(self.bodies()) * self.size() ** self.dimension

    def build(self, sizes: MeshSizes) -> None:
        """Draw and mesh into the current gmsh model, with the bodies and facet groups as physical groups."""
        raise NotImplementedError

    def __eq__(self, other: object) -> bool:
        """Equality of the keys alone: derived values that are cached are arrays."""
        return type(self) is type(other) and self.model_dump() == other.model_dump()

    def outcome(self) -> object | None:
        """Statistics of a shape of many fibers, printable; None for other shapes."""
        return None
