"""Self-contact: a body that is bent or pressed onto itself meets itself, and nothing else does."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gmsh
import numpy as np
import pytest
from mpi4py import MPI

from piezomat.contact.interfaces import Interfaces
from piezomat.contact.setup import interfaces_of
from piezomat.discretization.model import Model
from piezomat.forms.arrays import Array
from piezomat.forms.contact.facets import Facets
from piezomat.forms.contact.gap import point_normals, project
from piezomat.meshes.body_mesh import create
from piezomat.meshes.contact.geodesic import geodesic_distance
from piezomat.meshes.contact.local_search import brute_force_facets
from piezomat.scene import Scene
from piezomat.simulation import run
from tests.histories import assert_equal

YOUNG, HEIGHT, GAP, PRESS, THIN = 1000.0, 1.0, 0.02, 0.05, 0.02
PENALTY = 1e5
QUIET = {"fields": "none", "picture": False}
RADIUS, LEGS_APART, LEG = 0.5, 0.2, 2.0
METHODS = ["point", "node", "segment"]


def clasp(path: Path, *, bodies: tuple[str, str] = ("a", "a")) -> Path:
    """Two blocks of 1 by 1/2 um, GAP apart, that a thin strip on their left joins to one part.

    Bodies as named, below and above the middle of the strip. Groups bottom, top, under, over: faces of the blocks.
    """
    middle, reach = 0.5 * GAP, 0.3
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        occ = gmsh.model.occ
        halves = []
        for sign in (-1.0, 1.0):
            strips = [(-reach, 0.25, reach, THIN), (-reach, 0.0, THIN, 0.25 + THIN), (0.0, middle, 1.0, 0.5 * HEIGHT)]
            made = []
            for x, y, width, height in strips:
                low = middle + (y if sign > 0.0 else -y - height)
                made.append((2, occ.addRectangle(x, low, 0.0, width, height)))
            fused, _ = occ.fuse(made[:1], made[1:])
            halves += fused
        occ.fragment(halves[:1], halves[1:])
        occ.synchronize()
        for name in dict.fromkeys(bodies):
            members = [tag for (_, tag), body in zip(halves, bodies, strict=True) if body == name]
            gmsh.model.addPhysicalGroup(2, members, name=name)
        ends = 0.5 * HEIGHT
        for name, y in (("bottom", -ends), ("under", 0.0), ("over", GAP), ("top", GAP + ends)):
            near = gmsh.model.getEntitiesInBoundingBox(-1e-6, y - 1e-6, -1e-6, 1.0 + 1e-6, y + 1e-6, 1e-6, 1)
            gmsh.model.addPhysicalGroup(1, [tag for _, tag in near], name=name)
        size = gmsh.model.mesh.field.add("MathEval")
        gmsh.model.mesh.field.setString(size, "F", f"{THIN} + 0.12 * Max(0, x)")
        gmsh.model.mesh.field.setAsBackgroundMesh(size)
        for option in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
            gmsh.option.setNumber(f"Mesh.MeshSize{option}", 0)
        gmsh.model.mesh.generate(2)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()
    return path


def closed(
    path: Path, bodies: tuple[str, str] = ("a", "a"), kinematics: str = "small", **contact: Any
) -> dict[str, Any]:
    """The last row of a clasp that is pressed by more than the gap between its blocks."""
    keys = {"normal_penalty": PENALTY, "self_contact": True, **contact}
    scene = Scene(
        geometry={"file": str(clasp(path, bodies=bodies))},
        model={"kinematics": kinematics},
        materials={"m": {"young": YOUNG, "poisson": 0.0}},
        bodies={"*": "m"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0]},
            {"on": "top", "displacement": [0, -PRESS], "follows": "press"},
        ],
        load={"steps": [2], "factors": {"press": [1.0]}},
        output=QUIET,
        **({"contact": keys} if keys["self_contact"] or "pairs" in keys else {}),
    )
    return run(scene, MPI.COMM_SELF).history[-1]


@pytest.mark.parametrize("passes", [1, 2])
@pytest.mark.parametrize("method", METHODS)
def test_a_clasp_that_is_pressed_shut(tmp_path: Path, method: str, passes: int) -> None:
    """Blocks in series: their pressure is young times strain; all of it goes from one to the other."""
    last = closed(tmp_path / "clasp.msh", method=method, passes=passes)
    pressure = YOUNG * (PRESS - GAP) / (HEIGHT + YOUNG / PENALTY)
    assert abs(last["contact_force_y@a-a"]) == pytest.approx(pressure, rel=2e-3)
    assert abs(last["contact_force_y@a-a"]) == pytest.approx(-last["force_y@top"], rel=2e-3)
    assert last["contact_area@a-a"] == pytest.approx(1.0, rel=1e-2)
    assert last["max_penetration@a-a"] == pytest.approx(pressure / PENALTY, rel=0.1)


def test_a_clasp_without_self_contact_goes_through_itself(tmp_path: Path) -> None:
    last = closed(tmp_path / "clasp.msh", self_contact=False)
    assert abs(last["force_y@top"]) < 1e-2 * YOUNG * (PRESS - GAP) / HEIGHT


@pytest.mark.parametrize(("method", "kinematics"), [*((method, "small") for method in METHODS), ("point", "finite")])
def test_it_is_the_contact_of_the_faces_that_meet(tmp_path: Path, method: str, kinematics: str) -> None:
    """The faces named as a pair, and a clasp of two bodies that share nodes, give the same."""
    path = tmp_path / "clasp.msh"
    given = {"method": method, "kinematics": kinematics}
    found = closed(path, **given)
    faces = closed(path, **given, self_contact=False, pairs=[["under", "over"]])
    halves = closed(path, ("a", "b"), **given)
    assert abs(halves["contact_force_y@a-a"]) == abs(halves["contact_force_y@b-b"]) == 0.0
    for name in ("contact_area", "max_pressure", "max_penetration"):
        expected = faces[f"{name}@under-over"]
        assert found[f"{name}@a-a"] == pytest.approx(expected, rel=1e-8)
        assert halves[f"{name}@a-b"] == pytest.approx(expected, rel=1e-8)
    assert faces["contact_force_y@under-over"] < 0.0
    for other in (abs(found["contact_force_y@a-a"]), -halves["contact_force_y@a-b"]):
        assert other == pytest.approx(-faces["contact_force_y@under-over"], rel=1e-8)


def hairpin(path: Path) -> Path:
    """The table of a fiber whose two legs lie above each other."""
    r = RADIUS + 0.5 * LEGS_APART
    bend = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 13)
    leg = np.linspace(-LEG, 0.0, 6)[:-1]
    x = np.concatenate([leg, r * np.cos(bend), leg[::-1]])
    z = np.concatenate([np.full(5, -r), r * np.sin(bend), np.full(5, r)])
    rows = [f"a,{u:.12g},0,{v:.12g},{RADIUS}" for u, v in zip(x, z, strict=True)]
    path.write_text("\n".join(["fiber,x,y,z,radius", *rows]), encoding="utf-8")
    return path


def pressed_hairpin(path: Path, cells: str = "tensor", bodies: str = "a", **contact: Any) -> Scene:
    """A hairpin between two planes."""
    return Scene(
        geometry={"shape": "fibers", "file": str(path)},
        mesh={"size": 0.5, "contact_size": 0.4, "cells": cells},
        bodies={bodies: "pvdf"},
        planes=[
            {"name": "floor", "point": "bottom", "potential": 0},
            {"name": "lid", "point": "top", "motion": [0, 0, -0.4], "follows": "press"},
        ],
        contact={"smoothing": True, "self_contact": True, **contact},
        load={"steps": [4], "factors": {"press": [1.0]}},
        solver={"tolerance": 1e-11},
        output=QUIET,
    )


@pytest.mark.mpi
@pytest.mark.parametrize("passes", [1, 2])
def test_a_hairpin_is_the_same_on_any_ranks(comm: MPI.Comm, shared_tmp_path: Path, passes: int) -> None:
    """Its legs carry the lid's force as far as its bend does not."""
    path = shared_tmp_path / "hairpin.csv"
    if comm.rank == 0:
        hairpin(path)
    comm.barrier()
    # With air, which side of the pair a far pair of facets at the bend counts for is rounding: 1e-7 of the force.
    scene = pressed_hairpin(path, passes=passes, medium="none")
    alone = comm.bcast(run(scene, MPI.COMM_SELF).history if comm.rank == 0 else None)
    last = alone[-1]
    assert 0.2 < abs(last["contact_force_z@a-a"] / last["force_z@lid"]) < 0.9
    assert abs(last["contact_force_x@a-a"]) < 1e-2 * abs(last["contact_force_z@a-a"])
    assert 0.0 < last["max_penetration@a-a"] < 0.05
    if comm.size > 1:
        assert_equal(run(scene, comm).history, alone)


def moved(scene: Scene, motion: Callable[[Array], Array]) -> tuple[Interfaces, Array]:
    """A hairpin whose nodes (n, 3) have moved, its contact there, and where that has them."""
    model = Model(scene, create(MPI.COMM_SELF, scene.geometry, scene.sizes))
    contact = interfaces_of(model)
    x, local = model.unknowns.coordinates, np.zeros((len(model.unknowns.coordinates), model.unknowns.block))
    local[:, :3] = motion(x)
    state = model.coordinate_vector()
    state.array[:] = local.ravel()
    contact.detect(state, 0.5)
    contact.evaluate(state, tangent=False)
    return contact, (x + local[:, :3])[contact.nodes.number]


def closing(x: Array) -> Array:
    """Motion of legs whose ends come together until they lie in each other."""
    up = -(0.5 * LEGS_APART + 0.03) * np.sign(x[:, 2]) * np.maximum(-x[:, 0], 0.0) / LEG
    return np.column_stack([0.0 * up, 0.01 * np.sin(5.0 * x[:, 0]), up])


@pytest.mark.parametrize("passes", [1, 2])
@pytest.mark.parametrize("cells", ["tensor", "simplex"])
def test_points_meet_what_a_search_through_all_facets_finds(
    tmp_path: Path, cells: str, passes: int, rng: np.random.Generator
) -> None:
    """And that is always on the other leg, across the open space between them."""
    scene = pressed_hairpin(hairpin(tmp_path / "hairpin.csv"), cells, electric_range=0.2, passes=passes)
    contact, position = moved(scene, closing)
    (p,) = contact.surface_pairs
    rows, partner = p.projected_points, p.master_facet
    surfaces = p.facets.self_contact
    here, there = surfaces.slave.middle[p.points.facet[rows], 2], surfaces.master.middle[partner, 2]
    assert (here * there < 0.0).all() and (np.abs([here, there]) < RADIUS + 0.5 * LEGS_APART).all()
    kind, own = p.slave.kind, p.points.facet
    slave, master = p.facets.slave_at(position), p.facets.master_at(position)
    points = np.einsum("mk,mkd->md", p.points.shape, slave[own])
    normals = point_normals(kind, p.points.xi, slave[own], p.slave.orientation[own])
    some = np.union1d(rng.choice(len(points), 150, replace=False), rows[p.projection.gap < p.law.interaction_range])
    pairs = np.meshgrid(own[some], np.arange(len(master)), indexing="ij")
    may = p.facets.may_meet(*(index.ravel() for index in pairs)).reshape(pairs[0].shape)
    masters = Facets(kind, master, p.facets.master.orientation, p.facets.master.key)
    found = brute_force_facets(points[some], normals[some], masters, p.depth, may)
    gap = np.full(len(some), np.inf)
    hit = found >= 0
    gap[hit] = project(kind, points[some][hit], master[found[hit]], p.facets.master.orientation[found[hit]]).gap
    met = np.full(len(points), -1)
    met[rows] = partner
    near = gap < p.law.interaction_range
    assert near.sum() > 20
    np.testing.assert_array_equal(met[some][near], found[near])
    assert (p.projection.gap < 0.0).any() and not contact.touching_bodies()


def test_what_did_not_face_each_other_may_meet_if_it_is_far_along(tmp_path: Path) -> None:
    """The upper leg is brought under the lower one: its top meets what was the outside of the hairpin."""
    scene = pressed_hairpin(hairpin(tmp_path / "hairpin.csv"), smoothing=False)

    def under(x: Array) -> Array:
        return np.where((x[:, 2] > 0.0) & (x[:, 0] < 0.0), 0.2 - 4.0 * RADIUS - LEGS_APART, 0.0)[:, None] * [
            0,
            0,
            1,
        ]

    contact, _ = moved(scene, under)
    (p,) = contact.surface_pairs
    deep = np.flatnonzero(p.projection.gap < 0.0)
    here, there = p.points.facet[p.projected_points[deep]], p.master_facet[deep]
    slave, master = p.facets.self_contact.slave, p.facets.self_contact.master
    end = slave.middle[here, 0] < -0.5 * LEG
    assert end.sum() > 10
    away = master.middle[there] - slave.middle[here]
    behind = np.einsum("md,md->m", away, slave.normal[here]) < 0.0
    assert behind[end].all() and (np.abs(slave.geodesic[here] - master.geodesic[there])[behind] > 1.0).all()


@pytest.mark.mpi
def test_distance_along_a_fiber_is_that_from_its_end(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    """As far as edges of cells go straight, and to the last digit on any ranks."""
    path = shared_tmp_path / "fibers.csv"
    if comm.rank == 0:
        path.write_text(f"fiber,x,y,z,radius\na,0,0,0,{RADIUS}\na,6,0,0,{RADIUS}\nb,1,3,0,0.2\nb,3,3,0,0.2\n")
    comm.barrier()
    found = []
    for on in (comm, MPI.COMM_SELF):
        scene = pressed_hairpin(path, bodies="*")
        model = Model(scene, create(on, scene.geometry, scene.sizes))
        x, distance = model.unknowns.coordinates, geodesic_distance(model.unknowns.space, model.parts.node_part, 2)
        found.append(dict(zip(map(bytes, np.ascontiguousarray(x)), distance, strict=True)))
        for start, end, y, radius in ((0.0, 6.0, 0.0, RADIUS), (1.0, 3.0, 3.0, 0.2)):
            of = np.abs(x[:, 1] - y) < 1.0
            beyond = [distance[of] - np.abs(x[of, 0] - root) for root in (start, end)]
            assert any((d > -1e-12).all() and (d < 2.2 * radius).all() for d in beyond)
    here, alone = found
    assert all(alone[place] == distance for place, distance in here.items())


STRAIGHT: dict[str, dict[str, Any]] = {
    "points": {"method": "point"},
    "nodes": {"method": "node"},
    "segments": {"method": "segment"},
    "smooth": {"smoothing": True},
}


@pytest.mark.parametrize(("kind", "order"), [*((kind, 1) for kind in STRAIGHT), ("points", 2), ("nodes", 2)])
def test_what_is_not_bent_does_not_meet_itself(kind: str, order: int) -> None:
    """Two discs that are flattened give the same to the last digit, whether they may meet themselves or not."""
    rows = []
    for itself in (False, True):
        scene = Scene(
            geometry={"shape": "parallel_fibers"},
            mesh={"size": 0.2, "contact_size": 0.1, "order": order},
            bodies={"*": "pvdf"},
            boundaries=[{"on": "bottom", "displacement": [0, 0]}, {"on": "top", "displacement": [0, -0.3]}],
            contact={**STRAIGHT[kind], "self_contact": itself},
            load={"steps": [2]},
            output=QUIET,
        )
        rows.append(run(scene, MPI.COMM_SELF).history[-1])
    without, alike = rows
    assert alike["contact_area@fiber_1-fiber_2"] > 0.1
    assert alike["contact_area@fiber_1-fiber_1"] == alike["contact_area@fiber_2-fiber_2"] == 0.0
    for name in without:
        if name != "seconds":
            assert alike[name] == pytest.approx(without[name], rel=1e-10, abs=1e-12), name


@pytest.mark.parametrize(("cells", "order"), [("tensor", 1), ("simplex", 1), ("tensor", 2)])
def test_nothing_of_straight_fibers_is_tried_against_themselves(cells: str, order: int) -> None:
    """Not even within a diameter of a point."""
    scene = Scene(
        geometry={"shape": "cross_ply", "angles": [0, 90], "width": 4.0, "depth": 4.0},
        mesh={"size": 0.7, "contact_size": 0.5, "cells": cells, "order": order},
        bodies={"*": "elastic"},
        boundaries=[{"on": "ends", "displacement": [0, 0, 0]}],
        contact={"self_contact": True},
        output=QUIET,
    )
    model = Model(scene, create(MPI.COMM_SELF, scene.geometry, scene.sizes))
    contact = interfaces_of(model)
    state = model.coordinate_vector()
    state.set(0.0)
    contact.detect(state, 1.0)
    (p,) = contact.surface_pairs
    own = [c for c in p.closest.self_candidates if c is not None]
    assert len(own) == len(scene.body_names) < len(p.closest.self_candidates)
    assert all(len(c.facet) == 0 for c in own)
