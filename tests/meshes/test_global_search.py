"""Contact of many bodies: the same pairs as a search through all, on any number of ranks, and their report."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.contact import closest_points
from piezomat.contact.setup import interfaces_of
from piezomat.contact.shared_points import SharedPoints
from piezomat.discretization.model import Model
from piezomat.forms.arrays import Array, Integers
from piezomat.forms.contact.facets import Facets
from piezomat.forms.contact.gap import point_normals, project
from piezomat.meshes.body_mesh import create
from piezomat.meshes.contact.global_search import ONE_TO_ONE, CandidatePairs, Clusters, PairingRule, overlapping
from piezomat.meshes.contact.local_search import brute_force_facets, closest_facets
from piezomat.meshes.contact.signed_distance import NearestFacets, projected_pairs
from piezomat.scene import Scene
from piezomat.simulation import run
from tests.histories import assert_equal

MAT: dict[str, Any] = {
    "geometry": {"shape": "mat", "count": 8, "width": 5.0, "depth": 5.0, "bend_radius": 4.0, "radius_spread": 0.2},
    "mesh": {"size": 0.8, "contact_size": 0.5, "cells": "tensor"},
    "bodies": {"*": "pvdf"},
    "boundaries": [{"on": "ends", "displacement": [0, 0, "free"]}],
    "contact": {"electric_range": 0.01},
    "solver": {"tolerance": 1e-10},
    "output": {"fields": "none", "picture": False},
}


def mat(**changes: Any) -> Scene:
    """Eight fibers of a mat."""
    return Scene(**{**MAT, **changes})


def pressed(**changes: Any) -> Scene:
    """Four plies of two fibers between a grounded floor and a lid that comes down."""
    planes = [
        {"name": "floor", "point": "bottom", "potential": 0},
        {"name": "lid", "point": "top", "motion": [0, 0, -0.5], "follows": "press"},
    ]
    load = {"steps": [2], "factors": {"press": [1.0]}}
    plies = {"shape": "cross_ply", "angles": [0, 90, 0, 90], "width": 4.0, "depth": 4.0}
    return mat(**{"geometry": plies, "planes": planes, "load": load} | changes)


def test_boxes_that_overlap_are_all_found(rng: np.random.Generator) -> None:
    for d in (2, 3):
        size = 10.0 ** rng.uniform(-2.0, 0.0, (2, 80, 1))
        low = rng.uniform(-1.0, 1.0, (2, 80, d))
        first, second = (np.stack([low[i], low[i] + size[i] * rng.uniform(0.0, 1.0, (80, d))], axis=1) for i in (0, 1))
        a, b = overlapping(first, second, 0.05)
        near = first[:, None, 0] <= second[:, 1] + 0.05
        near &= first[:, None, 1] >= second[:, 0] - 0.05
        expected = [tuple(pair) for pair in np.argwhere(near.all(axis=2)).tolist()]
        assert sorted(zip(a.tolist(), b.tolist(), strict=True)) == expected and 20 < len(expected) < 6000


def test_clusters_are_of_one_component_and_hold_everything_once(rng: np.random.Generator) -> None:
    low = rng.uniform(0.0, 1.0, (500, 3))
    component = rng.integers(0, 7, 500)
    found = Clusters.of(low, low + 0.1, component, 20)
    assert sorted(np.concatenate(found.members).tolist()) == list(range(500))
    for box, number, members in zip(found.boxes, found.component, found.members, strict=True):
        assert len(members) <= 20 and (component[members] == number).all()
        np.testing.assert_array_equal(box, [low[members].min(axis=0), low[members].max(axis=0) + 0.1])


def test_rules_say_who_may_meet() -> None:
    rule = PairingRule(parts=3)
    components = rule.component(np.array([0, 0, 1, 2]), np.array([0, 1, 1, 2]))
    allowed = rule.allows(components[:, None], components)
    # The body itself is out, and so is a body that shares a connected part.
    assert allowed.astype(int).tolist() == [[0, 0, 1, 1], [0, 0, 0, 1], [1, 0, 0, 1], [1, 1, 1, 0]]
    ordered = PairingRule(parts=3, ordered=True).allows(components[:, None], components)
    assert (ordered == np.triu(allowed)).all()
    itself = PairingRule(parts=3, ordered=True, self_contact=True).allows(components[:, None], components)
    assert (itself == np.triu(np.ones((4, 4)))).all()
    assert ONE_TO_ONE.allows(np.array([0]), np.array([3])).all()


def test_every_point_finds_what_a_search_through_all_bodies_finds(comm: MPI.Comm, rng: np.random.Generator) -> None:
    """Against each other fiber in turn, by the slow reference; the deepest or nearest of them is the one."""
    scene = mat(contact={"electric_range": 0.4})
    model = Model(scene, create(comm, scene.geometry, scene.sizes))
    contact = interfaces_of(model)
    state = model.coordinate_vector()
    state.array[:] = 0.02 * rng.standard_normal(len(state.array))
    margin = 0.3
    contact.detect(state, margin)
    contact.evaluate(state, tangent=False)
    (p,) = contact.surface_pairs
    position = model.unknowns.coordinates + state.array_r.reshape(-1, model.unknowns.block)[:, :3]
    facets, own = position[p.slave.nodes], p.points.facet
    points = np.einsum("mk,mkd->md", p.points.shape, facets[own])
    normals = point_normals(p.slave.kind, p.points.xi, facets[own], p.slave.orientation[own])
    body = p.rule.body(p.slave.component)
    met = np.full(len(points), -1)
    met[p.projected_points] = p.facets.master.key[p.master_facet]
    chosen = rng.choice(len(points), 250, replace=False)
    chosen = np.union1d(chosen, rng.choice(p.projected_points, 100, replace=False))
    least, partner = np.full(len(points), np.inf), np.full(len(points), -1)
    for other in range(8):
        theirs = np.flatnonzero(body == other)
        rows = chosen[body[own[chosen]] != other]
        masters = Facets(p.slave.kind, facets[theirs], p.slave.orientation[theirs], p.slave.key[theirs])
        found = brute_force_facets(points[rows], normals[rows], masters, p.depth)
        rows, found = rows[found >= 0], theirs[found[found >= 0]]
        seen = project(p.slave.kind, points[rows], facets[found], p.slave.orientation[found])
        gap = seen.gap
        # The closest point of a warped facet's plane may lie far from a facet that the point is not over.
        nearer = (gap < least[rows]) & (p.slave.kind.overshoot(seen.xi) < 0.2)
        least[rows[nearer]], partner[rows[nearer]] = gap[nearer], p.slave.key[found[nearer]]
    # Points beyond the interaction range need no master facet.
    near = chosen[(least[chosen] < p.law.interaction_range) & (partner[chosen] >= 0)]
    assert len(near) > 50
    np.testing.assert_array_equal(met[near], partner[near])


def exhaustive_gaps(p: Any, position: Array, most: float) -> tuple[Array, Array, Integers]:
    """Gap (m,), at most `most`, normal (m, d) and body (m,) that each point meets, out of all facets of all bodies.

    A point meets the body that it is deepest in or nearest to, by the signed distance. Where the nearest facet of a
    body does not face the point, the reference of the local search decides.
    """
    kind, facets, own = p.slave.kind, position[p.slave.nodes], p.points.facet
    points = np.einsum("mk,mkd->md", p.points.shape, facets[own])
    normals = point_normals(kind, p.points.xi, facets[own], p.slave.orientation[own])
    middles = np.einsum("k,mkd->md", kind.shape(kind.middle[None])[0], facets[own])
    body = p.rule.body(p.slave.component)
    gap, meets, normal = np.full(len(points), np.inf), np.full(len(points), -1), np.zeros_like(points)
    for other in np.unique(body):
        theirs = np.flatnonzero(body == other)
        masters = Facets(kind, facets[theirs], p.slave.orientation[theirs], p.slave.key[theirs])
        center = masters.nodes.mean(axis=1)
        radius = 1.2 * np.linalg.norm(masters.nodes - center[:, None], axis=2).max()
        away = np.linalg.norm(points[:, None] - center, axis=2).min(axis=1)
        rows = np.flatnonzero((body[own] != other) & (away < most + radius))
        each, facet = (index.ravel() for index in np.indices((len(rows), len(theirs))))
        seen = projected_pairs(points[rows], normals[rows], masters, each, facet)
        nearest = NearestFacets.of(kind, seen, len(rows))
        clear = nearest.faces & nearest.over & (nearest.gap > -p.depth)
        found, there = np.where(clear, nearest.gap, np.inf), nearest.normal.copy()
        some = np.flatnonzero(~clear)
        given = points[rows[some]], normals[rows[some]], masters, p.depth
        chosen = brute_force_facets(*given, middles=middles[rows[some]])
        some, chosen = some[chosen >= 0], chosen[chosen >= 0]
        closest = project(kind, points[rows[some]], masters.nodes[chosen], masters.orientation[chosen])
        found[some], there[some] = closest.gap, closest.normal
        nearer = (found < gap[rows]) & (found <= most)
        gap[rows[nearer]], normal[rows[nearer]], meets[rows[nearer]] = found[nearer], there[nearer], other
    return gap, normal, meets


@pytest.mark.slow
def test_contact_of_mats_is_that_of_an_exhaustive_search(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Gaps, bodies, and the forces of a penalty on every body, of fibers that are moved about.

    Each point has the one facet that the search finds: none is shared by several.
    """

    def unshared(self: Any, position: Array, points: Array, projected: Integers, projection: Any, within: float) -> Any:
        return SharedPoints.none(projection)

    monkeypatch.setattr(closest_points.ClosestPoints, "_share", unshared)
    contacts, most = 0, 0.01
    for seed in range(12):
        shape = {
            "shape": "mat",
            "count": 3,
            "width": 2.5,
            "depth": 2.5,
            "radius": 0.3,
            "bend_radius": 2.0,
            "seed": seed,
        }
        sizes = {"size": 0.5, "contact_size": 0.3, "cells": "tensor"}
        scene = mat(geometry=shape | {"seed": seed}, mesh=sizes, contact={"electric_range": most})
        model = Model(scene, create(MPI.COMM_SELF, scene.geometry, scene.sizes))
        contact = interfaces_of(model)
        part = model.parts.node_part
        motion = np.zeros((len(model.parts.size), model.unknowns.block))
        motion[:, :3] = 0.03 * rng.standard_normal((len(motion), 3))
        state = model.coordinate_vector()
        state.array[:] = (motion[part] + 0.003 * rng.standard_normal((len(part), 1))).ravel()
        contact.detect(state, 0.3)
        contact.evaluate(state, tangent=False)
        (p,) = contact.surface_pairs
        position = model.unknowns.coordinates + state.array_r.reshape(-1, model.unknowns.block)[:, :3]
        gap, normal, meets = exhaustive_gaps(p, position, most)
        found, there, near = np.full(len(gap), np.inf), np.zeros_like(normal), p.projection.gap <= most
        found[p.projected_points[near]] = p.projection.gap[near]
        there[p.projected_points[near]] = p.projection.normal[near]
        np.testing.assert_allclose(found, gap, rtol=0.0, atol=1e-10)
        pressure = [(p.points.weight * np.maximum(-g, 0.0))[:, None] * n for g, n in ((found, there), (gap, normal))]
        for body in range(3):
            ours, exhaustive = (each[meets == body].sum(axis=0) for each in pressure)
            np.testing.assert_allclose(ours, exhaustive, rtol=0.0, atol=1e-10 * max(np.abs(exhaustive).max(), 1e-6))
        contacts += int((gap < 0.0).sum())
    assert contacts > 50


@pytest.mark.mpi
def test_what_comes_near_is_found_without_a_search_of_all(
    comm: MPI.Comm, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fibers that move about: the points that may act are those of surfaces paired anew."""
    scene = mat(contact={"electric_range": 0.02, "smoothing": True})
    model = Model(scene, create(comm, scene.geometry, scene.sizes))
    contact, anew = interfaces_of(model), interfaces_of(model)
    looked = []
    monkeypatch.setattr(closest_points, "closest_facets", lambda *a: (looked.append(len(a[0])), closest_facets(*a))[1])
    state = model.coordinate_vector()
    motion, margin = np.zeros((len(model.parts.size), model.unknowns.block)), 1.2
    work, acting, new = np.zeros(2, int), [], 0
    for step in range(8):
        if step:
            motion[:, :3] = np.clip(motion[:, :3] + 0.02 * rng.standard_normal((len(motion), 3)), -0.15, 0.15)
        state.array[:] = motion[model.parts.node_part[: model.unknowns.owned]].ravel()
        found = []
        for i, c in enumerate((contact, anew)):
            if i or not step:
                c.detect(state, margin)
            looked.clear()
            c.evaluate(state, tangent=False)
            work[i] += sum(looked)
            (p,) = c.surface_pairs
            gap = np.full(len(p.points.weight), np.inf)
            gap[p.projected_points] = p.projection.gap
            found.append(gap)
        assert not contact.search_radius_exceeded
        acts = found[1] < p.law.interaction_range
        # At the edge of an end a point keeps a master facet that a new search would not choose: the gap is smaller.
        assert (found[0][acts] < p.law.interaction_range + 0.01).all()
        same = np.isclose(found[0][acts], found[1][acts], atol=1e-3)
        # A rank may have none of them: which cells are whose depends on the machine.
        agree, all_of_them = comm.allreduce(same.sum()), comm.allreduce(len(same))
        assert agree > 0.9 * all_of_them > 0
        acting.append(acts)
        new += int((acts & ~acting[0]).sum())
    assert comm.allreduce(new) > 200
    assert comm.allreduce(int(work[0])) < 0.6 * comm.allreduce(int(work[1]))


@pytest.mark.slow
@pytest.mark.mpi
def test_a_pressed_mat_is_the_same_on_any_ranks(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    """And every force on its way through the mat is balanced."""
    alone = comm.bcast(run(pressed(), MPI.COMM_SELF).history if comm.rank == 0 else None)
    history = run(pressed(), comm, shared_tmp_path).history
    # In the first step next to nothing is pressed yet, and weak springs alone say where the fibers are.
    assert_equal(history[1:], alone[1:])
    last = history[-1]
    assert last["force_z@lid"] < -0.1 and last["stabilization"] < 1e-3 * last["elastic"]
    assert not any("contact_area@ply" in name for name in last)
    with (shared_tmp_path / "pairs.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["step"] for row in rows} == {"1", "2"}
    touching = [row for row in rows if row["step"] == "2" and float(row["contact_area"]) > 0.0]
    assert len(touching) == 12
    assert all(float(row["max_pressure"]) > 0.0 for row in touching)
    total = {f"ply_{i}_fiber_{j}": 0.0 for i in range(1, 5) for j in (1, 2)}
    for row in touching:
        for name, sign in zip(row["pair"].split("-"), (1.0, -1.0), strict=True):
            total[name] += sign * float(row["contact_force_z"])
    # The plies in between are in balance, the first carries all and the last is pressed.
    for name, force in total.items():
        ply = int(name[4])
        expected = {1: last["force_z@lid"] / 2, 4: -last["force_z@lid"] / 2}.get(ply, 0.0)
        assert force == pytest.approx(expected, abs=2e-3 * abs(last["force_z@lid"]))


def test_nothing_meets_where_there_is_nothing() -> None:
    none, component = np.zeros((0, 4, 3)), np.zeros(0, np.int64)
    found = CandidatePairs.near(np.zeros((5, 3)), np.zeros(5, np.int64), none, component, 1.0, ONE_TO_ONE)
    assert not found.points and not len(found.component)
    some = np.zeros((2, 4, 3))
    assert not CandidatePairs.near(np.zeros((0, 3)), component, some, np.full(2, 3), 1.0, ONE_TO_ONE).points


def test_bodies_of_different_materials_and_one_pass(comm: MPI.Comm) -> None:
    """All are paired in one pass, whatever their materials; without the second one the lower body is the slave."""
    both = mat(bodies={"*": "pvdf", "fiber_2": "elastic", "fiber_5": "elastic"})
    contact = interfaces_of(Model(both, create(comm, both.geometry, both.sizes)))
    assert len(contact.surface_pairs) == 1
    once = mat(contact={"passes": 1})
    model = Model(once, create(comm, once.geometry, once.sizes))
    contact = interfaces_of(model)
    state = model.coordinate_vector()
    state.array[:] = 0.0
    contact.detect(state, 0.3)
    contact.evaluate(state, tangent=False)
    (p,) = contact.surface_pairs
    slave, master = (
        p.rule.body(p.slave.component[p.points.facet[p.projected_points]]),
        p.rule.body(p.master_component()),
    )
    assert len(p.master_facet) > 20 and (slave < master).all() and p.share == 1.0
