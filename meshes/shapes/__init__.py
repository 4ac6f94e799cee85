"""Every shape that can be built, as one type chosen by its key `shape`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from piezomat.meshes.builders.sizes import MeshSizes
from piezomat.meshes.shapes.base import Shape
from piezomat.meshes.shapes.blocks import Cantilever, StackedBlocks
from piezomat.meshes.shapes.fiber_array import FiberArray
from piezomat.meshes.shapes.fibers import CrossedFibers, FacingHalves, FiberOnBlock, ParallelFibers
from piezomat.meshes.shapes.mats import CrossPly, Fibers, Mat

Shapes = Annotated[
    FacingHalves
    | CrossedFibers
    | ParallelFibers
    | FiberOnBlock
    | StackedBlocks
    | Cantilever
    | FiberArray
    | CrossPly
    | Mat
    | Fibers,
    Field(discriminator="shape"),
]

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
    "Shapes",
    "StackedBlocks",
]
