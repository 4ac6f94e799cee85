"""From the scene to surface pairs: default penalties and kinds of bodies do not depend on how axes are turned."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.contact.setup import interfaces_of
from piezomat.discretization.model import Model
from piezomat.forms.arrays import Array
from piezomat.meshes.body_mesh import create
from piezomat.scene import Scene, SceneError
from piezomat.simulation import Run, run

TILT = 37.0  # degrees
DEFINITE = np.arange(36.0).reshape(6, 6) % 7.0 - 3.0
TRICLINIC = {
    "stiffness": (400.0 * (DEFINITE + DEFINITE.T) + 11000.0 * np.diag([1, 1.2, 0.8, 0.5, 0.6, 0.4])).tolist(),
    "piezo": (np.cos(np.arange(18.0)).reshape(3, 6) / 2.0).tolist(),
    "permittivity": [[4e-4, 1e-5, 1e-5], [1e-5, 9e-4, 3e-4], [1e-5, 3e-4, 7e-4]],
}


def turned(vector: list[float], degrees: float, dimension: int) -> list[float]:
    """A vector turned as the tilt of stacked blocks turns them, x towards up."""
    up = dimension - 1 if len(vector) == dimension else 1
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    result = list(vector)
    result[0], result[up] = c * vector[0] - s * vector[up], s * vector[0] + c * vector[up]
    return result


def tilted(degrees: float, dimension: int) -> Scene:
    """Two blocks of a triclinic piezoelectric material, pressed and sheared, with everything turned together."""
    depth = {} if dimension == 2 else {"depth": 1.0}
    cells = [[3, 2], [2, 2]] if dimension == 2 else [[2, 2, 2], [3, 2, 1]]
    axes = {"poling": [0.3, 0.4, 0.9], "axis1": [1.0, 0.2, 0.4]}
    if dimension == 2:
        axes = {"poling": [0.3, 0.9, 0.4], "axis1": [1.0, 0.4, 0.2]}
    shift = [0.01, -0.03] if dimension == 2 else [0.01, 0.005, -0.03]
    return Scene(
        geometry={"shape": "stacked_blocks", "divisions": cells, "tilt": degrees, **depth},
        mesh={"cells": "tensor"},
        materials={"m": TRICLINIC | {name: turned(axis, degrees, dimension) for name, axis in axes.items()}},
        bodies={"lower": "m", "upper": "m"},
        boundaries=[
            {"on": "bottom", "displacement": [0.0] * dimension, "potential": 0},
            {"on": "top", "displacement": turned(shift, degrees, dimension), "potential": 2.0},
        ],
        contact={},
        output={"fields": "none", "picture": False},
    )


def force(finished: Run, dimension: int, degrees: float) -> Array:
    """The force on `top`, turned back."""
    row = finished.history[-1]
    return np.array(turned([row[f"force_{axis}@top"] for axis in "xyz"[:dimension]], -degrees, dimension))


@pytest.mark.parametrize("dimension", [2, 3])
def test_default_penalties_do_not_depend_on_the_axes(dimension: int) -> None:
    straight, turned_round = (run(tilted(angle, dimension), MPI.COMM_SELF) for angle in (0.0, TILT))
    expected = force(straight, dimension, 0.0)
    assert np.abs(expected).max() > 100.0
    np.testing.assert_allclose(force(turned_round, dimension, TILT), expected, atol=1e-9 * np.abs(expected).max())
    for name in ("charge@top", "max_pressure@lower-upper", "elastic"):
        assert turned_round.history[-1][name] == pytest.approx(straight.history[-1][name], rel=1e-9), name


def fibers(rng: np.random.Generator, material: str, **changes: Any) -> Scene:
    """Nine fibers with a poling each."""
    directions = rng.normal(size=(9, 2)).tolist()
    return Scene(
        geometry={"shape": "fiber_array", "columns": 3, "rows": 3},
        mesh={"size": 0.5},
        materials={f"m{i}": {"like": material, "poling": d} for i, d in enumerate(directions)},
        bodies={f"fiber_{i + 1}": f"m{i}" for i in range(9)} | changes,
        contact={},
        planes=[{"name": "floor", "point": "bottom", "potential": 0}],
        output={"fields": "none", "picture": False},
    )


@pytest.mark.parametrize("material", ["pvdf", "pzt5h"])
def test_fibers_of_any_poling_are_one_surface_pair(material: str, rng: np.random.Generator) -> None:
    scene = fibers(rng, material)
    bodies = create(MPI.COMM_SELF, scene.geometry, scene.sizes)
    assert len(interfaces_of(Model(scene, bodies)).surface_pairs) == 1
    other = fibers(rng, material, fiber_5="elastic")
    assert len(interfaces_of(Model(other, bodies)).surface_pairs) == 1


@pytest.mark.mpi
@pytest.mark.parametrize("method", ["point", "segment"])
def test_fibers_of_any_moduli_are_one_surface_pair(comm: MPI.Comm, method: str) -> None:
    """A point takes the smaller stiffness and permittivity of its two bodies; without one of these no charge passes."""
    moduli = {f"m{i}": {"young": 1000.0 * (i + 1), "poisson": 0.3, "permittivity": 1e-4 * (9 - i)} for i in range(9)}
    scene = Scene(
        geometry={"shape": "fiber_array", "columns": 3, "rows": 3},
        mesh={"size": 0.3},
        materials=moduli,
        bodies={f"fiber_{i + 1}": "elastic" if i == 4 else f"m{i}" for i in range(9)},
        contact={"medium": "none", "method": method},
        planes=[{"name": "floor", "point": "bottom", "potential": 0}],
    )
    model = Model(scene, create(comm, scene.geometry, scene.sizes))
    contact = interfaces_of(model)
    (p,) = contact.surface_pairs
    state = model.new_vector()
    part = model.parts.node_part[: model.unknowns.owned]
    values = np.zeros((model.unknowns.owned, model.unknowns.block))
    values[:, :2], values[:, 2] = -0.02 * (model.parts.centre[part] - 1.5), part + 1.0
    model.unknowns.set_by_node(state, values)
    contact.detect(state, 0.3)
    contact.evaluate(state, tangent=True)
    rows = p.projected_points
    ours, theirs = p.slave.body[p.points.facet[rows]], p.rule.body(p.master_component())
    stiffness = np.array([m.mean_stiffness for m in model.materials])
    permittivity = np.array([m.mean_permittivity if m.electric else 0.0 for m in model.materials])
    least = [np.minimum(of[ours], of[theirs]) for of in (stiffness, permittivity)]
    np.testing.assert_allclose(p.law.penalties[0][rows], 10.0 * least[0] / p.facet_size[rows])
    np.testing.assert_allclose(p.law.penalties[1][rows], 10.0 * least[1] / p.facet_size[rows])
    passes = least[1] > 0.0
    assert (p.jump[~passes] == 0.0).all() and (p.response.charge[~passes] == 0.0).all()
    assert (np.abs(p.jump[passes]) > 0.5).all()
    counts = [int((p.gap < 0.0).sum()), int((~passes).sum()), len(np.unique(np.stack([ours, theirs]), axis=1).T)]
    pressed, insulated, meetings = (comm.allreduce(count) for count in counts)
    assert pressed > 20 and insulated > 40 and meetings >= 24


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("pairs", "words"),
    [
        ([["lower_contact", "upper_contact"], ["lower", "upper"]], "4 and 6 facets in common with contact.pairs"),
        ([["lower_contact", "upper_contact"], ["upper", "lower_top"]], "6 and 4 facets in common with contact.pairs"),
        ([["lower", "lower_contact"]], "4 facets in common"),
    ],
)
def test_two_facets_meet_in_one_pair_alone(comm: MPI.Comm, pairs: list[list[str]], words: str) -> None:
    scene = Scene(
        geometry={"shape": "stacked_blocks", "divisions": [[4, 2], [6, 3]]},
        bodies={"lower": "elastic", "upper": "elastic"},
        boundaries=[{"on": "bottom", "displacement": [0, 0]}],
        contact={"pairs": pairs},
    )
    bodies = create(comm, scene.geometry, scene.sizes)
    with pytest.raises(SceneError, match=words) as caught:
        interfaces_of(Model(scene, bodies))
    assert caught.value.key == f"contact.pairs[{len(pairs) - 1}]"


def test_a_surface_may_meet_several_others() -> None:
    scene = Scene(
        geometry={"shape": "stacked_blocks", "height": [0.5] * 3, "divisions": [[2, 1]] * 3},
        bodies={"*": "elastic"},
        boundaries=[{"on": "bottom", "displacement": [0, 0]}],
        contact={"pairs": [["block_1", "block_2"], ["block_3", "block_2"], ["block_1_top", "block_3_bottom"]]},
    )
    interfaces = interfaces_of(Model(scene, create(MPI.COMM_SELF, scene.geometry, scene.sizes)))
    assert len(interfaces.surface_pairs) == 6


def test_bodies_that_are_bonded_are_named() -> None:
    scene = Scene(
        geometry={"shape": "cantilever", "divisions": [4, 1]},
        bodies={"layer_1": "elastic", "layer_2": "elastic"},
        boundaries=[{"on": "root", "displacement": [0, 0]}],
        contact={},
    )
    with pytest.raises(SceneError, match="apart from each other: layer_1, layer_2 share nodes, which bonds them"):
        interfaces_of(Model(scene, create(MPI.COMM_SELF, scene.geometry, scene.sizes)))
