"""What a map of scripts/stability is: its axes, and for each cell a scene and the error of its answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from piezomat.scene import Scene
from piezomat.simulation import Run
from scripts.studies.stability_methods import METHODS, Method

UNSMOOTHED = tuple(method.name for method in METHODS if "smoothed" not in method.name)


@dataclass(frozen=True)
class Map:
    """A map: its axes, the tolerance of the error, the scene of a cell and its error.

    scene(method, x, y); error(run, x, y): relative error of the answer against `reference`.
    """

    name: str
    title: str
    reference: str
    x: tuple[str, list[float]]
    y: tuple[str, list[float]]
    tolerance: float
    scene: Callable[[Method, Any, Any], Scene]
    error: Callable[[Run, Any, Any], float]
    methods: tuple[str, ...] = UNSMOOTHED
