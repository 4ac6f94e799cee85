"""What a run says of its own results: large strains, yield stresses, bodies that drift, voltages that are zero."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.results.run_doubts import largest_strain, rounded_down
from piezomat.scene import Scene
from piezomat.simulation import run
from tests.scenes import pressed


def warnings(scene: Scene, comm: MPI.Comm) -> list[str]:
    return run(scene, comm, quiet=True).summary["warnings"]


def bar(stretch: float, kinematics: str = "small", **material: Any) -> Scene:
    """A bar of 4 um, pulled along x in two steps."""
    return Scene(
        geometry={"shape": "cantilever", "length": 4.0, "layers": [1.0], "divisions": [4, 1]},
        model={"kinematics": kinematics},
        materials={"rubber": {"young": 10.0, "poisson": 0.0} | material},
        bodies={"layer_1": "rubber"},
        boundaries=[
            {"on": "root", "displacement": [0, 0]},
            {"on": "tip", "displacement": [4.0 * stretch, 0], "follows": "pull"},
        ],
        load={"steps": [2], "factors": {"pull": [1.0]}},
    )


@pytest.mark.mpi
def test_large_strains_with_small_kinematics(comm: MPI.Comm) -> None:
    (found,) = warnings(bar(0.16), comm)
    assert found.startswith('strains reach 0.16 in body "layer_1" in step 2')
    assert warnings(bar(0.09), comm) == [] == warnings(bar(0.16, "finite"), comm)


@pytest.mark.mpi
def test_strains_at_a_contact(comm: MPI.Comm) -> None:
    """The pair's number once stood in the place of the step's."""
    found = warnings(pressed(2, load={"steps": [1], "factors": {"press": [2.0]}}), comm)
    (strains,) = [text for text in found if text.startswith("strains reach")]
    assert strains.endswith('er" in step 1, where model.kinematics = "small" is no longer accurate')


@pytest.mark.mpi
@pytest.mark.parametrize(("value", "text"), [(0.0559, "0.055"), (0.06, "0.06"), (1.29e-3, "0.0012"), (12.7, "12")])
def test_sizes_to_take_arerounded_down(value: float, text: str) -> None:
    assert rounded_down(value) == text


@pytest.mark.mpi
def test_stresses_beyond_yield(comm: MPI.Comm) -> None:
    (found,) = warnings(bar(0.08, **{"yield": 0.3}), comm)
    assert found.startswith('stresses reach 0.4 MPa in body "layer_1" in step 1, beyond the yield stress of 0.3 MPa')
    assert warnings(bar(0.08, **{"yield": 0.9}), comm) == []
    assert getattr(Scene.load(bar(0.08, **{"yield": 0.9})).materials["rubber"], "yield") == 0.9
    assert "yield = 0.9" in bar(0.08, **{"yield": 0.9}).to_toml()


def test_the_largest_principal_strain_is_that_of_the_tensor() -> None:
    strain = np.random.default_rng(1).normal(size=(50, 6))
    tensors = [[[s[0], s[5] / 2, s[4] / 2], [s[5] / 2, s[1], s[3] / 2], [s[4] / 2, s[3] / 2, s[2]]] for s in strain]
    np.testing.assert_allclose(largest_strain(strain), np.abs(np.linalg.eigvalsh(np.array(tensors))).max(axis=1))


@pytest.mark.mpi
@pytest.mark.parametrize("lower", ["held", "loose"])
def test_a_body_that_drifts_with_what_it_touches(lower: str, comm: MPI.Comm) -> None:
    """The lower half disc has a potential, but nothing holds it: the upper one pushes it away, at no force."""
    bottom = {"on": "bottom", "potential": 0} | ({"displacement": [0, 0]} if lower == "held" else {})
    top = {"on": "top", "displacement": [0, -0.02], "follows": "press"}
    found = warnings(pressed(2, boundaries=[bottom, top]), comm)
    said = [text for text in found if text.startswith('nothing but weak springs holds body "lower"')]
    assert len(said) == (lower == "loose")


@pytest.mark.mpi
@pytest.mark.parametrize(("poling", "zero"), [([1, 0], True), ([0, 1], False)])
def test_a_voltage_that_is_zero_by_symmetry(poling: list[int], zero: bool, comm: MPI.Comm) -> None:
    """A block pressed along y and poled along x: its potential varies along x, and its mean on top is zero."""
    scene = Scene(
        geometry={"shape": "cantilever", "length": 2.0, "layers": [1.0], "divisions": [4, 2]},
        mesh={"cells": "tensor"},
        materials={"film": {"like": "pvdf", "poling": poling}},
        bodies={"layer_1": "film"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0], "potential": 0},
            {"on": "top", "displacement": [0, -0.02]},
        ],
    )
    found = [text for text in warnings(scene, comm) if 'the voltage of "top" is zero but for rounding' in text]
    assert len(found) == zero
