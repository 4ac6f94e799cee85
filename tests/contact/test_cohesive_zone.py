"""The zone in which bonds soften, against its closed form, in facets."""

from __future__ import annotations

from typing import Any

import pytest
from mpi4py import MPI

from piezomat.contact.cohesive_zone import coarse_cohesive_zone
from piezomat.contact.setup import interfaces_of
from piezomat.discretization.model import Model
from piezomat.meshes.body_mesh import create
from piezomat.scene import Scene
from piezomat.simulation import plan
from tests.scenes import blocks


def warning(scene: Scene, comm: MPI.Comm) -> str | None:
    model = Model(scene, create(comm, scene.geometry, scene.sizes))
    return coarse_cohesive_zone(model, interfaces_of(model))


def glued(**adhesion: Any) -> Scene:
    """Blocks of E = 1000 MPa and nu = 0.3 with facets of 1/3 and 1/4 um, 1/6 and 1/8 on the sides."""
    return blocks(contact={"adhesion": {"law": "bilinear", **adhesion}})


@pytest.mark.mpi
def test_the_zone_is_counted_in_facets(comm: MPI.Comm) -> None:
    modulus = 0.5 * 1000.0 / (1 - 0.3**2)  # E* of two equal bodies
    length = 2.0 * 0.125  # two of the smaller facets
    energy = length * 10.0**2 / modulus
    found = warning(glued(strength=10.0, energy=energy), comm)
    assert found is not None and "within 0.25 um (E* energy / strength^2), which is 2.0 facets" in found
    assert warning(glued(strength=10.0, energy=1.6 * energy), comm) is None
    assert warning(blocks(), comm) is None
    assert "which is 2.0 facets" in plan(glued(strength=10.0, energy=energy), comm)
