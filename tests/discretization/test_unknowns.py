"""Unknowns: where displacements and potentials stand in distributed vectors."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.forms.arrays import Array
from tests.discretization.models import blocks

pytestmark = pytest.mark.mpi

MATERIALS = {2: {"lower": "pvdf", "upper": "elastic"}, 3: {"lower": "elastic", "upper": "elastic"}}


@pytest.mark.parametrize("dimension", [2, 3])
def test_each_unknown_is_owned_once(dimension: int, comm: MPI.Comm) -> None:
    model = blocks(comm, dimension, bodies=MATERIALS[dimension])
    unknowns = model.unknowns
    assert unknowns.electric == (dimension == 2) and unknowns.block == 3
    owned = unknowns.displacement_numbers()
    if unknowns.electric:
        owned = np.concatenate([owned, unknowns.potential_numbers()])
    everywhere = np.sort(np.concatenate(comm.allgather(owned)))
    np.testing.assert_array_equal(everywhere, np.arange(unknowns.total))
    first, last = model.new_vector().getOwnershipRange()
    np.testing.assert_array_equal(np.sort(owned), np.arange(first, last))
    nodes = np.arange(unknowns.first_node, unknowns.first_node + unknowns.owned)
    np.testing.assert_array_equal(unknowns.numbers(nodes), np.arange(first, last))


@pytest.mark.parametrize("dimension", [2, 3])
def test_parts_and_norms_of_a_vector(dimension: int, comm: MPI.Comm) -> None:
    """Against all values gathered on each rank."""
    unknowns = (model := blocks(comm, dimension, bodies=MATERIALS[dimension])).unknowns
    vector = model.new_vector()
    values = np.random.default_rng(3).standard_normal((unknowns.total // unknowns.block, unknowns.block))
    vector.array[:] = values[unknowns.first_node : unknowns.first_node + unknowns.owned].ravel()

    def gathered(local: Array) -> Array:
        return np.concatenate(comm.allgather(local))

    np.testing.assert_array_equal(gathered(unknowns.by_node(vector)), values)
    np.testing.assert_array_equal(gathered(unknowns.displacements(vector)), values[:, :dimension])
    expected = [np.linalg.norm(values[:, :dimension])]
    if unknowns.electric:
        np.testing.assert_array_equal(gathered(unknowns.potentials(vector)), values[:, dimension])
        expected.append(np.linalg.norm(values[:, dimension]))
    np.testing.assert_allclose(unknowns.norms(vector), expected, rtol=1e-13)


def test_coordinates_are_in_the_displacement_part(comm: MPI.Comm) -> None:
    model = blocks(comm)
    unknowns, vector = model.unknowns, model.coordinate_vector()
    np.testing.assert_array_equal(unknowns.displacements(vector), unknowns.coordinates[: unknowns.owned])
    assert not unknowns.potentials(vector).any()
