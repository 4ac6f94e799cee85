"""The electric contact of a scene fades out over a gap that suits its voltage: neither surfaces nor meshes matter."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.simulation import run
from tests.scenes import facing_halves, strongly_coupled


@pytest.mark.parametrize(
    ("voltage", "method", "size"), [(50.0, "point", 0.04), (-50.0, "segment", 0.04), (50.0, "node", 0.02)]
)
def test_electrodes_across_a_contact_do_not_pull_surfaces_together(voltage: float, method: str, size: float) -> None:
    """Over a tenth of a facet, as the electric contact faded out, they did: no step converged from 20 V on."""
    last = run(strongly_coupled(voltage, size, method=method), MPI.COMM_SELF).history[-1]
    # The top is 1 um wide.
    assert last["force_y@bottom"] == pytest.approx(40.0, rel=1e-6)
    assert last["contact_force_y@lower-upper"] == pytest.approx(-40.0, rel=1e-6)
    assert last["charge@bottom"] == pytest.approx(-last["charge@top"], rel=1e-6)
    assert last["charge@top"] * voltage > 0.0
    assert last["max_potential_jump@lower-upper"] < 0.02 * abs(voltage)


@pytest.mark.parametrize(("voltage", "size"), [(20.0, 0.03), (50.0, 0.06)])
def test_nor_do_they_across_gaps_of_air(voltage: float, size: float) -> None:
    """They hold each other like an adhesive whose zone no facet resolves: the closed contact is switched off slowly."""
    last = run(strongly_coupled(voltage, size, medium="air"), MPI.COMM_SELF).history[-1]
    assert last["force_y@bottom"] == pytest.approx(40.0, rel=5e-6)
    assert last["contact_force_y@lower-upper"] == pytest.approx(-40.0, rel=5e-6)
    assert last["charge@bottom"] == pytest.approx(-last["charge@top"], rel=1e-6)


def test_the_charge_of_a_contact_between_electrodes_does_not_hang_on_the_mesh() -> None:
    """The gap over which it fades out is the voltage's and not the facet's: 20 V leave 0.269 and 0.271 pC."""
    charges = [run(strongly_coupled(20.0, size), MPI.COMM_SELF).history[-1]["charge@top"] for size in (0.025, 0.014)]
    assert charges[0] == pytest.approx(charges[1], rel=0.02)


def test_the_voltage_does_not_scatter_with_the_mesh() -> None:
    """Where the electric contact ends abruptly it does, by 0.5 %; a charge that fades out leaves 0.1 %."""
    scatter = []
    for electric_range in (1e-8, None):
        voltages = []
        for size in (0.0194, 0.0197, 0.02, 0.0203, 0.0206):
            scene = facing_halves(1e5, steps=1, electric_range=electric_range)
            mesh = scene.mesh.model_copy(update={"size": 0.1, "contact_size": size})
            voltages.append(
                run(scene.model_copy(update={"mesh": mesh}), MPI.COMM_SELF).history[-1]["mean_potential@top"]
            )
        scatter.append(np.std(voltages) / np.mean(voltages))
    assert scatter[1] < 1e-3 and scatter[1] < 0.5 * scatter[0]
