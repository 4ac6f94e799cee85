"""Load balance: every slave facet on one rank, as much contact for every rank, neighbours together."""

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.contact.interfaces import Interfaces
from piezomat.contact.setup import interfaces_of
from piezomat.discretization.model import Model
from piezomat.meshes.body_mesh import create
from piezomat.meshes.contact import load_balance as sharing
from piezomat.meshes.contact.load_balance import bisected
from piezomat.simulation import run
from tests.scenes import pressed
from tests.verification.test_ranks import a_body_a_rank


@pytest.mark.parametrize("count", [1, 2, 3, 7])
@pytest.mark.parametrize("dimension", [2, 3])
def test_halves_have_equal_work_and_boxes_that_do_not_overlap(count: int, dimension: int) -> None:
    rng = np.random.default_rng(count)
    places, work = rng.random((2000, dimension)), rng.choice([0.01, 1.0], 2000)
    group = bisected(places, work, count)
    assert np.abs(np.bincount(group, work, count) - work.sum() / count).max() <= count
    assert len(np.unique(group)) == count
    for first in range(count):
        for second in range(first):
            a, b = places[group == first], places[group == second]
            common = np.minimum(a.max(axis=0), b.max(axis=0)) - np.maximum(a.min(axis=0), b.min(axis=0))
            assert common.min() <= 0.0


def test_fewer_places_than_groups_and_none_at_all() -> None:
    assert len(np.unique(bisected(np.array([[0.0, 0.0], [1.0, 0.0]]), np.ones(2), 4))) == 2
    assert len(bisected(np.zeros((0, 3)), np.zeros(0), 3)) == 0


def paired(pairs: object, comm: MPI.Comm) -> tuple[Interfaces, Model]:
    """Crossed half fibers, a rank each, whose contact is at one place: with one rank alone, if cells decide."""
    contact = {"pairs": pairs, "passes": 1}
    scene = pressed(3, mesh={"size": 0.3, "contact_size": 0.05}, contact=contact)
    model = Model(scene, create(comm, scene.geometry, scene.sizes, partition=a_body_a_rank))
    contact = interfaces_of(model)
    state = model.coordinate_vector()
    state.set(0.0)
    contact.detect(state, 0.05)
    return contact, model


@pytest.mark.mpi
@pytest.mark.parametrize("pairs", ["auto", [["upper_contact", "lower_contact"]]], ids=str)
def test_every_rank_evaluates_its_share_of_the_points_that_are_near(pairs: object, comm: MPI.Comm) -> None:
    contact, model = paired(pairs, comm)
    (p,) = contact.surface_pairs
    (alone,) = paired(pairs, MPI.COMM_SELF)[0].surface_pairs
    near = np.array(comm.allgather(len(p.near_points)))
    assert near.max() <= 1.5 * near.mean()
    keys = np.concatenate(comm.allgather(p.slave.key))
    assert np.array_equal(np.sort(keys), np.sort(alone.slave.key))
    state = model.coordinate_vector()
    nodes = contact.nodes.gather(state)[p.slave_nodes][..., : model.dim]
    assert np.abs(nodes - p.slave.reference).max(initial=0.0) < 1e-14


@pytest.mark.mpi
def test_what_is_even_stays_where_its_cells_are(comm: MPI.Comm, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sharing, "UNEVEN", np.inf)
    contact, model = paired([["upper_contact", "lower_contact"]], comm)
    (p,) = contact.surface_pairs
    assert (len(p.slave) > 0) == (comm.rank == model.bodies.bodies.index("upper") % comm.size)


@pytest.mark.mpi
def test_bodies_touch_wherever_their_points_are_evaluated(comm: MPI.Comm) -> None:
    """Also the master, of which the rank that evaluates the points may hold no cell."""
    scene = pressed(2, contact={"pairs": [["upper_contact", "lower_contact"]], "passes": 1})
    result = run(scene, comm, partition=a_body_a_rank)
    assert result.contact.touching_bodies() == {0, 1}
