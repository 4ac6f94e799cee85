"""End checks: what is repaired where the iterations have ended."""

from __future__ import annotations

import pytest
from mpi4py import MPI

from piezomat.contact import search
from piezomat.scene import Scene
from piezomat.simulation import run
from tests.scenes import facing_halves


def test_a_point_that_has_left_its_facet_is_looked_up_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Late in a solve points keep facets that they have left, and the end of the solve was taken for equilibrium."""
    monkeypatch.setattr(search, "PROJECTION_TOLERANCES", ((0, 5.0),))
    boundaries = [
        {"on": "bottom", "displacement": [0, 0], "potential": 0},
        {"on": "top", "displacement": [0.03, -0.02]},
    ]
    scene = facing_halves(1e5)
    scene = Scene(**{**scene.model_dump(exclude_unset=True), "boundaries": boundaries, "load": {}})
    for p in run(scene, MPI.COMM_SELF).problem.contact.surface_pairs:
        pressed = p.projection.gap < 0.0
        assert p.slave.kind.overshoot(p.projection.xi[pressed]).max(initial=-1.0) <= 0.101
