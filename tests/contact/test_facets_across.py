"""How many facets lie across a contact: in closed forms, on any number of ranks, and what a run says of too few."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.scene import Scene
from piezomat.simulation import run
from tests.scenes import blocks, press, pressed

SIZE = 0.02


def width(dimension: int, area: float) -> float:
    """Across a contact of this area, um: in 2D its length, in 3D the diameter of a circle."""
    return area if dimension == 2 else 2.0 * float(np.sqrt(area / np.pi))


@pytest.mark.mpi
@pytest.mark.parametrize("dimension", [2, 3])
def test_facets_across_a_round_contact(dimension: int) -> None:
    """The width over the size of facets, within one facet; the same on all ranks."""
    size = SIZE if dimension == 2 else 0.08
    scene = pressed(dimension, mesh={"size": 0.2, "contact_size": size})
    history = run(scene, MPI.COMM_WORLD).history
    for row in history:
        expected = width(dimension, row["contact_area@lower-upper"]) / size
        assert row["facets_across@lower-upper"] == pytest.approx(expected, abs=1.0)
    assert history[1]["facets_across@lower-upper"] > history[0]["facets_across@lower-upper"] > 0.0
    alone = run(scene, MPI.COMM_SELF).history
    for row, other in zip(history, alone, strict=True):
        assert row["facets_across@lower-upper"] == pytest.approx(other["facets_across@lower-upper"], rel=1e-6)


def test_a_flat_contact_needs_no_facets() -> None:
    row = run(blocks(), MPI.COMM_SELF).history[-1]
    assert row["contact_area@lower-upper"] == pytest.approx(1.0)
    assert row["facets_across@lower-upper"] == 0.0


def fibers_on_a_plane(*spread: float, **changes: Any) -> Scene:
    """Fibers side by side between planes."""
    keys: dict[str, Any] = {
        "mesh": {"size": 0.25, "contact_size": 0.05},
        "bodies": {"*": "elastic"},
        "planes": [
            {"name": "floor", "point": "bottom"},
            {"name": "lid", "point": "top", "motion": [0, -0.05], "follows": "press"},
        ],
        "load": {"steps": [1], "factors": {"press": [1.0]}},
    }
    return press({"shape": "fiber_array", "columns": 2, "rows": 1, "gap": 0.5}, **{**keys, **changes})


def test_places_on_a_plane_are_counted_apart() -> None:
    """Two fibers on one plane: the width of one contact, not of both and what lies between them."""
    row = run(fibers_on_a_plane(), MPI.COMM_SELF).history[-1]
    each = 0.5 * row["contact_area@lid"] / 0.05
    assert row["facets_across@lid"] == pytest.approx(each, abs=1.0)


def test_too_few_facets_are_named_with_the_key(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, logger="piezomat")
    row = run(fibers_on_a_plane(), MPI.COMM_SELF).history[-1]
    few = [record.getMessage() for record in caplog.records if "facets wide" in record.getMessage()]
    assert row["facets_across@lid"] < 6.0
    assert len(few) == 1
    assert '"floor"' in few[0] or '"lid"' in few[0]
    assert "lower mesh.contact_size to 0.0" in few[0]
    caplog.clear()
    run(fibers_on_a_plane(mesh={"size": 0.25, "contact_size": 0.01}), MPI.COMM_SELF)
    assert not [record for record in caplog.records if "facets wide" in record.getMessage()]
