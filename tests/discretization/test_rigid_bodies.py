"""Connected parts: extents, rigid-body modes, and which of them boundaries constrain."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.discretization.rigid_bodies import rigid_modes
from tests.discretization.models import DEPTH, HEIGHT, WIDTH, blocks


@pytest.mark.parametrize("dimension", [2, 3])
def test_rigid_modes_have_no_strain(dimension: int) -> None:
    x = np.random.default_rng(1).standard_normal((dimension + 1, dimension))
    modes = rigid_modes(x)
    edges, moved = x[1:] - x[0], modes[1:] - modes[0]
    for mode in range(modes.shape[2]):
        gradient = np.linalg.solve(edges, moved[:, :, mode])
        np.testing.assert_allclose(gradient, -gradient.T, atol=1e-12)
    assert np.linalg.matrix_rank(modes.reshape(-1, modes.shape[2])) == (3 if dimension == 2 else 6)


@pytest.mark.mpi
@pytest.mark.parametrize("dimension", [2, 3])
def test_extents_of_two_blocks(dimension: int, comm: MPI.Comm) -> None:
    """Centre and volume exactly; size and thickness from the second moments of the cells' nodes, which are larger."""
    parts = blocks(comm, dimension).parts
    extent = np.array([WIDTH, DEPTH, HEIGHT] if dimension == 3 else [WIDTH, HEIGHT])
    assert len(parts) == 2
    assert parts.volume == pytest.approx(2 * extent.prod())
    for number in range(2):
        centre = extent / 2
        centre[-1] += number * HEIGHT
        np.testing.assert_allclose(parts.centre[number], centre, rtol=1e-12)
    radius = np.sqrt((extent**2).sum() / 12)
    assert (parts.size >= radius).all() and (parts.size < 1.5 * radius).all()
    assert (parts.thickness >= HEIGHT).all() and (parts.thickness < 1.5 * HEIGHT).all()


HELD = {"on": "bottom", "displacement": [0, 0], "potential": 0}
ROLLER: dict[str, Any] = {"on": "bottom", "displacement": ["free", 0]}


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("boundaries", "lower", "upper"),
    [
        ([HELD], (False, False), (True, False)),
        ([HELD, {"on": "top", "displacement": [0, 0]}], (False, False), (False, False)),
        ([ROLLER], (True, True), (True, False)),
        ([ROLLER, {"on": "left", "displacement": [0, "free"]}], (False, True), (True, False)),
        ([{"on": "lower_contact", "potential": 1.0}], (True, False), (True, False)),
    ],
)
def test_which_parts_no_boundary_constrains(
    boundaries: list[dict[str, Any]], lower: tuple[bool, bool], upper: tuple[bool, bool], comm: MPI.Comm
) -> None:
    """Of the lower block, which has a permittivity, and the upper one, which has no potential to constrain.

    The left side of the stack keeps both blocks from moving sideways, and the upper one may still move up.
    """
    model = blocks(comm, boundaries=boundaries)
    np.testing.assert_array_equal(model.unconstrained, [lower, upper])
    assert model.has_unconstrained_bodies == (lower[0] or upper[0])
