"""Laws by the bodies that points meet: kept from step to step, restored and resumed, whatever was met in between."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.contact.interfaces import Interfaces
from piezomat.contact.setup import interfaces_of
from piezomat.discretization.model import Model
from piezomat.discretization.state import SavedHistory
from piezomat.forms.arrays import Array, Booleans, Integers
from piezomat.meshes.body_mesh import create
from piezomat.scene import Scene

RADIUS, RANGE, STRENGTH = 0.5, 0.02, 40.0
YOUNG = [100.0, 1000.0, 9000.0]


def stack(method: str) -> Scene:
    """Three discs on each other, softest below, whose bonds break at one opening, so that their energies differ."""
    return Scene(
        geometry={"shape": "parallel_fibers", "count": 3, "radius": RADIUS},
        mesh={"size": 0.2},
        materials={f"m{i}": {"young": young, "poisson": 0.3} for i, young in enumerate(YOUNG)},
        bodies={f"fiber_{i + 1}": f"m{i}" for i in range(3)},
        contact={"method": method, "adhesion": {"law": "cutoff", "strength": STRENGTH, "range": RANGE}},
        boundaries=[{"on": "bottom", "displacement": [0, 0]}],
    )


class At:
    """A contact, and what it has at given heights of the three discs."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.contact: Interfaces = interfaces_of(model)
        self.state: PETSc.Vec = model.new_vector()

    def evaluate(self, *heights: float) -> dict[str, float]:
        """Energies there."""
        model = self.model
        values = np.zeros((model.unknowns.owned, model.unknowns.block))
        values[:, 1] = np.array(heights)[model.parts.node_part[: model.unknowns.owned]]
        model.unknowns.set_by_node(self.state, values)
        self.contact.detect(self.state, 0.1)
        self.contact.evaluate(self.state, tangent=False)
        return self.contact.energies()


def reader(saved: SavedHistory) -> Any:
    """What a checkpoint reads of a history."""

    def read(name: str, keys: Integers, width: int) -> tuple[Array, Booleans]:
        known, values = saved.points[name]
        rows = {tuple(key): row for key, row in zip(known.tolist(), values, strict=True)}
        found = np.array([tuple(key) in rows for key in keys.tolist()], bool)
        none = np.zeros(width)
        return np.array([rows.get(tuple(key), none) for key in keys.tolist()]).reshape(len(keys), width), found

    return read


@pytest.mark.parametrize("method", ["point", "segment"])
def test_broken_bonds_keep_the_law_of_the_body_they_held(method: str) -> None:
    scene = stack(method)
    model = Model(scene, create(MPI.COMM_SELF, scene.geometry, scene.sizes))
    one = At(model)
    pressed, apart = (0.0, -0.02, -0.05), (0.0, 0.5, 1.0)
    one.evaluate(*pressed)
    (p,) = one.contact.surface_pairs
    rows = p.projected_points[p.gap < 0.0]
    # Up to the same opening the work depends on the penalty, thus on both bodies.
    work = STRENGTH * RANGE - 0.5 * STRENGTH**2 / p.law.penalties[0][rows]
    middle = p.slave.body[p.points.facet[rows]] == 1
    assert np.ptp(work[middle]) > 0.02 * work.max()
    torn = 0.5 * p.points.weight[rows] @ work
    one.contact.commit()
    found = one.evaluate(*apart)["dissipated"]
    # Segments are cut anew, and each takes the history of the nearest one that was.
    assert found == pytest.approx(torn, rel=1e-12 if method == "point" else 0.01)
    expected = pytest.approx(found, rel=1e-12)
    one.contact.commit()
    assert one.evaluate(*apart)["dissipated"] == expected
    # In a step that fails the softest disc comes to lie on the middle one; nothing is left of it.
    trial = (1.95, -0.02, 3.0)
    history, saved = one.contact.history(), one.contact.saved()
    one.evaluate(*trial)
    assert one.evaluate(*apart)["dissipated"] == expected
    one.evaluate(*trial)
    one.contact.restore(history)
    assert one.evaluate(*apart)["dissipated"] == expected
    other = At(model)
    other.contact.resume(reader(saved), saved.scalars)
    assert other.evaluate(*apart)["dissipated"] == expected
