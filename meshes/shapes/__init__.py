"""The catalogue of shapes: a class that is imported here, or defined before a scene is first used, is in it."""

from __future__ import annotations

from piezomat.meshes.builders.sizes import MeshSizes
from piezomat.meshes.shapes.base import Shape
from piezomat.meshes.shapes.blocks import Cantilever, StackedBlocks
from piezomat.meshes.shapes.fiber_array import FiberArray
from piezomat.meshes.shapes.fibers import CrossedFibers, FacingHalves, FiberOnBlock, ParallelFibers
from piezomat.meshes.shapes.mats import CrossPly, Fibers, Mat

__all__ = [
    "Cantilever",
    "CrossPly",
    "CrossedFibers",
    "FacingHalves",
    "FiberArray",
    "FiberOnBlock",
    "Fibers",
    "Mat",
    "MeshSizes",
    "ParallelFibers",
    "Shape",
    "StackedBlocks",
    "catalogue",
]


def catalogue(base: type[Shape] = Shape) -> list[type[Shape]]:
    """Every shape that has been defined so far, by its key `shape`, in the order of definition."""
    found = []
    for kind in base.__subclasses__():
        found += [kind] * ("shape" in kind.model_fields) + catalogue(kind)
    return found
