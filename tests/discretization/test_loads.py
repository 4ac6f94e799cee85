"""Loads: the nodal forces and charges of the form are those that the loads apply."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.assembly.nodal_loads import NodalLoads
from piezomat.meshes import parallel
from piezomat.scene import SceneError
from tests.discretization.models import HEIGHT, WIDTH, blocks

LOAD = {"steps": [1], "factors": {"pull": [1.0]}}


@pytest.mark.mpi
def test_nodal_loads_sum_to_what_is_applied(comm: MPI.Comm) -> None:
    """Three loads of two factors, two of them on facets that they share: right holds the right side of lower."""
    rows: list[dict[str, Any]] = [
        {"on": "right", "traction": [3.0, -1.0], "follows": "pull"},
        {"on": "bottom", "displacement": [0, 0]},
        {"on": "lower_right", "pressure": 2.0, "charge_density": 0.5},
    ]
    model = blocks(comm, boundaries=rows, load=LOAD)
    nodal = NodalLoads(model)
    nodal.set_loads({"pull": 0.5})
    assert nodal.exist and nodal.is_constant and nodal.is_symmetric
    found = parallel.total(comm, -model.unknowns.by_node(nodal.vector).sum(axis=0))
    found[2] *= -1.0 / model.potential_scale
    forces = np.array([0.5 * 3.0 * 2 * HEIGHT - 2.0 * HEIGHT, -0.5 * 2 * HEIGHT])
    np.testing.assert_allclose(found, [*forces, 0.5 * HEIGHT], rtol=1e-12)
    applied = sum(model.loads.applied(c, {"pull": 0.5}) for c in model.constraints.conditions)
    np.testing.assert_allclose(found, applied, rtol=1e-12)


@pytest.mark.mpi
def test_pressure_of_finite_kinematics_follows_the_state(comm: MPI.Comm) -> None:
    rows = [{"on": "bottom", "displacement": [0, 0]}, {"on": "top", "pressure": 2.0}]
    model = blocks(
        comm, boundaries=rows, model={"kinematics": "finite"}, bodies={"lower": "elastic", "upper": "elastic"}
    )
    nodal = NodalLoads(model)
    assert not (nodal.is_constant or nodal.is_symmetric)
    stretched = model.new_vector()
    values = np.zeros((model.unknowns.owned, 2))
    values[:, 0] = 0.1 * model.unknowns.coordinates[: model.unknowns.owned, 0]
    stretched.array[:] = values.ravel()
    for state, width in ((model.new_vector(), WIDTH), (stretched, 1.1 * WIDTH)):
        model.set_trial_state(state)
        nodal.set_loads({})
        force = parallel.total(comm, -model.unknowns.displacements(nodal.vector).sum(axis=0))
        np.testing.assert_allclose(force, [0.0, -2.0 * width], atol=1e-12)


@pytest.mark.mpi
def test_without_loads_there_is_no_form(comm: MPI.Comm) -> None:
    nodal = NodalLoads(blocks(comm, boundaries=[{"on": "bottom", "displacement": [0, 0]}]))
    nodal.set_loads({})
    assert not nodal.exist and nodal.is_constant and nodal.is_symmetric and not nodal.vector.array_r.any()


def test_a_load_inside_a_body_names_the_row_that_has_it() -> None:
    rows = [
        {"on": "root", "displacement": [0, 0]},
        {"on": "interface_1", "displacement": ["free", 0]},
        {"on": "interface_1", "traction": [0, -1.0]},
    ]
    geometry = {"shape": "cantilever", "length": 2.0, "layers": [0.5, 0.5], "divisions": [4, 2]}
    bodies = {"layer_1": "elastic", "layer_2": "elastic"}
    with pytest.raises(SceneError, match=r"boundaries\[2\].on: .*inside a body"):
        blocks(MPI.COMM_SELF, geometry=geometry, bodies=bodies, contact=None, boundaries=rows)
