"""A material law that does not say that it is linear: the same bodies in contact, solved as nonlinear ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.forms.material_library import BUILT_IN
from piezomat.scene import Scene, SceneError
from piezomat.simulation import run
from tests.forms.test_constitutive import ByDensity
from tests.histories import assert_equal
from tests.scenes import pressed

EFFORT = ("newton", "krylov", "linear_solves")


@pytest.fixture
def by_density(monkeypatch: pytest.MonkeyPatch) -> None:
    """Materials `flat` and `upright`: pvdf poled up in 2D and in 3D, by its density alone."""
    for name, up in (("flat", [0, 1, 0]), ("upright", [0, 0, 1])):
        monkeypatch.setitem(BUILT_IN, name, ByDensity(BUILT_IN["pvdf"].rotated(up)))


@pytest.mark.mpi
@pytest.mark.parametrize(("dimension", "solver"), [(2, {}), (2, {"kind": "iterative"}), (3, {})])
@pytest.mark.usefixtures("by_density")
def test_bodies_in_contact(dimension: int, solver: dict[str, Any], comm: MPI.Comm) -> None:
    keys = {"solver": {"tolerance": 1e-10, **solver}}
    expected = run(pressed(dimension, **keys), comm, quiet=True)
    name = "flat" if dimension == 2 else "upright"
    for bodies in ({"lower": name, "upper": name}, {"lower": name, "upper": "pvdf"}):
        found = run(pressed(dimension, bodies=bodies, **keys), comm, quiet=True)
        assert not found.problem.is_constant and expected.problem.is_constant
        assert found.problem.is_symmetric
        assert_equal(found.history, expected.history, EFFORT)


@pytest.mark.mpi
@pytest.mark.usefixtures("by_density")
def test_a_single_body_is_solved_by_iterations(comm: MPI.Comm) -> None:
    keys = {
        "geometry": {"shape": "cantilever", "length": 2.0, "layers": [0.5, 0.5], "divisions": [4, 2]},
        "boundaries": [
            {"on": "root", "displacement": [0, 0]},
            {"on": "bottom", "potential": 0},
            {"on": "top", "traction": [0, -1.0], "potential": 3.0},
        ],
        "solver": {"tolerance": 1e-12},
    }
    expected = run(Scene(bodies={"layer_*": "pvdf"}, **keys), comm, quiet=True)
    found = run(Scene(bodies={"layer_1": "flat", "layer_2": "pvdf"}, **keys), comm, quiet=True)
    assert expected.problem.is_linear and not found.problem.is_linear
    assert_equal(found.history, expected.history, EFFORT)
    assert np.isfinite(found.history[-1]["elastic"]) and found.history[-1]["newton"] >= 1


@pytest.mark.usefixtures("by_density")
def test_plane_stress_is_refused_where_the_law_has_none() -> None:
    with pytest.raises(SceneError, match=r'model.plane: found "stress"; allowed: "strain": the law .* of upper'):
        pressed(2, bodies={"lower": "pvdf", "upper": "flat"}, model={"plane": "stress"})
    pressed(2, model={"plane": "stress"})
