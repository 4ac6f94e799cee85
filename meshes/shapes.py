"""Every shape that can be built, as one type chosen by its key `shape`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from meshes.base import Shape
from meshes.blocks import Cantilever, StackedBlocks
from meshes.fiber_array import FiberArray
from meshes.fibers import CrossedFibers, FacingHalves, FiberOnBlock, ParallelFibers
from meshes.recipes import CrossPly, Fibers, Mat
from meshes.sizes import MeshSizes

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
