"""Numbers that look like those of other units are warned of, by the run and by the plan; the shipped scenes are not."""

from __future__ import annotations

from typing import Any

import pytest
from mpi4py import MPI

from piezomat.discretization.model import Model
from piezomat.meshes.body_mesh import create
from piezomat.scene import Scene
from piezomat.simulation import plan, run


def film(scale: float = 1.0, **material: Any) -> Scene:
    """A block of one material, of 1 um times `scale`, between electrodes."""
    constants = {"young": 2500.0, "poisson": 0.3, "permittivity": 1e-4} | material
    return Scene(
        geometry={"shape": "cantilever", "length": 2.0 * scale, "layers": [scale], "divisions": [2, 1]},
        materials={"film": constants},
        bodies={"*": "film"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0], "potential": 0},
            {"on": "top", "displacement": [0, -1e-3 * scale], "potential": 1e-3},
        ],
        output={"fields": "none", "picture": False},
    )


PIEZO = {"e31": 0.03, "e32": -0.005, "e33": -0.07}


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("scene", "words"),
    [
        (film(), []),
        (film(1e-6), ["the bodies together measure 2e-06 um: lengths are in um"]),
        (film(1e5), ["measure 2e+05 um"]),
        (film(young=2.5e9), ['the stiffness of material "film" is up to 3.37e+09 MPa']),
        (film(permittivity=1e-8), ['the permittivity of material "film" is 1e-08 pC/(V um), below that of vacuum']),
        (film(permittivity=8.8541878128e-6), []),
        (film(piezo=PIEZO), []),
        (film(piezo=PIEZO, poling=[0, 0, 1]), ['the poling of material "film" points out of the plane']),
        (film(piezo=PIEZO, poling=[0.9, 0.1, 0.05]), []),
    ],
)
def test_numbers_of_other_units(scene: Scene, words: list[str], comm: MPI.Comm) -> None:
    found = Model(scene, create(comm, scene.geometry, scene.sizes)).warnings
    assert len(found) == len(words) and all(word in text for word, text in zip(words, found, strict=True))
    if words:
        said = [line for line in plan(scene, comm).splitlines() if line.startswith("warning")]
        assert len(said) == len(words) and words[0] in said[0]
        assert run(scene, comm, quiet=True).summary["warnings"][: len(found)] == found
