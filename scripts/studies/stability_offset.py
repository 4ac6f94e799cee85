"""The map `offset` of scripts/stability: blocks that stand out over each other, all sides searched."""

from __future__ import annotations

from mpi4py import MPI

from piezomat.scene import Scene
from piezomat.simulation import Run, run
from scripts.studies.stability_map import Map
from scripts.studies.stability_methods import METHODS, Method

YOUNG, POISSON = 2500.0, 0.3
APART, PRESSED = 0.02, 0.005  # gap while a block slides above the other, and how far it is pressed in then, um


def offset(method: Method, share: float, ratio: float) -> Scene:
    """A block slid above another one by a share of its width, and pressed: all sides may touch.

    The upper block has `ratio` times as many facets a side as the lower one; the coarser one has ten.
    """
    fine = round(10 * max(ratio, 1.0 / ratio))
    below, above = (10, fine) if ratio >= 1.0 else (fine, 10)
    shape = {"shape": "stacked_blocks", "height": [0.5, 0.5], "divisions": [[below, 2], [above, 2]], "gap": APART}
    return method.scene(
        geometry=shape,
        mesh={"cells": "tensor"},
        materials={"soft": {"young": YOUNG, "poisson": POISSON}},
        bodies={"lower": "soft", "upper": "soft"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": [share, "free"], "follows": "slide"},
            {"on": "top", "displacement": ["free", -APART - PRESSED], "follows": "press"},
        ],
        load={"steps": [1, 1], "factors": {"slide": [1.0, 1.0], "press": [0.0, 1.0]}},
    )


def offset_error(finished: Run, share: float) -> float:
    """Largest force where the blocks are apart, and difference of the force from that of the two faces alone.

    Over the force on blocks that lie on each other with their whole faces, nearly. Where a block is off the other,
    there is no force; the two faces alone give the nodes at the edges one.
    """
    scene = finished.model.scene
    faces = scene.contact.model_copy(update={"pairs": [["lower_contact", "upper_contact"]]})
    alone = run(scene.model_copy(update={"contact": faces}), MPI.COMM_SELF).history[-1] if share < 1.0 else {}
    apart, pressed = finished.history
    columns = "force_x@top", "force_y@top"
    largest = max(max(abs(apart[name]), abs(pressed[name] - alone.get(name, 0.0))) for name in columns)
    return largest / (YOUNG * PRESSED)


OFFSET = Map(
    "offset",
    "A block on another one, all sides searched: offset against ratio of facets",
    "no force apart, that of the two faces alone in contact",
    ("offset / width", [0.0, 0.02, 0.25, 0.45, 0.8, 1.01]),
    ("facets above / below", [1 / 20, 1 / 4, 2 / 3, 1, 3 / 2, 4, 20]),
    0.05,
    offset,
    lambda run, x, y: offset_error(run, x),
    tuple(method.name for method in METHODS),
)
