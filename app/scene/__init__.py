"""The scene file: its keys, their checks, their errors."""

from piezomat.scene.errors import SceneError
from piezomat.scene.scene import Scene, schema

__all__ = ["Scene", "SceneError", "schema"]
