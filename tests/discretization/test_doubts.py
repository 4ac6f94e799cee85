"""Doubts: joints that cannot be meant end a run or a plan; others, and elements that lock, are warnings in both."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gmsh
import numpy as np
import pytest
from mpi4py import MPI

from piezomat.discretization.model import Model
from piezomat.forms.material_library import BUILT_IN
from piezomat.forms.materials import Material
from piezomat.meshes.body_mesh import create
from piezomat.meshes.gmsh_io import model as gmsh_model
from piezomat.scene import Scene, SceneError
from piezomat.simulation import plan, run
from tests.meshes.test_joints import boxes

QUIET = {"fields": "none", "picture": False}


def pressed_boxes(path: Path, bodies: int, **changes: Any) -> Scene:
    """Two boxes on each other from a file without facet groups, under a plane."""
    keys: dict[str, Any] = {
        "geometry": {"file": str(path)},
        "bodies": {"*": "elastic"},
        "planes": [
            {"name": "floor", "point": "bottom"},
            {"name": "lid", "point": "top", "motion": [0, 0, -0.02]},
        ],
        "contact": {},
        "output": QUIET,
    }
    return Scene(**{**keys, **changes})


@pytest.mark.mpi
def test_separate_parts_of_a_body_that_lie_on_each_other(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    path = shared_tmp_path / "boxes.msh"
    if comm.rank == 0:
        boxes(path, "double", 0.4)
    comm.barrier()
    for contact in ({"contact": {}}, {"contact": None}):
        scene = pressed_boxes(path, 1, **contact)
        for use in (plan, run):
            with pytest.raises(
                SceneError, match=r'body "body_0" in separate parts .* nodes, at \(.*, 0\.5\)'
            ) as caught:
                use(scene, comm)
            assert caught.value.key == "geometry.file"
    meant = pressed_boxes(path, 1, contact={"self_contact": True})
    assert Model(meant, create(comm, meant.geometry, meant.sizes)).warnings == []


@pytest.mark.parametrize(("joint", "bodies"), [("shared", 1), ("double", 2)])
def test_boxes_that_are_merged_or_meet_carry_the_same_load(tmp_path: Path, joint: str, bodies: int) -> None:
    boxes(tmp_path / "boxes.msh", joint, 0.4, bodies)
    finished = run(pressed_boxes(tmp_path / "boxes.msh", bodies), MPI.COMM_SELF)
    assert finished.model.warnings == []
    young = 2500.0
    # Free sides: the stress of the approach, less what the contact of planes and boxes gives.
    assert -finished.history[-1]["force_z@lid"] == pytest.approx(0.02 * young, rel=0.06)


@pytest.mark.mpi
def test_bodies_that_share_nodes_alone(comm: MPI.Comm, shared_tmp_path: Path) -> None:
    path = shared_tmp_path / "boxes.msh"
    if comm.rank == 0:
        boxes(path, "edge", 0.4, 2)
    comm.barrier()
    with pytest.raises(SceneError, match=r'bodies "body_0" and "body_1" that share \d+ nodes but no facet, at \(1, '):
        plan(pressed_boxes(path, 2), comm)
    (warning,) = Model(
        scene := pressed_boxes(path, 2, contact=None), create(comm, scene.geometry, scene.sizes)
    ).warnings
    assert 'bodies "body_0" and "body_1" share nodes around which no facet' in warning and "hinges" in warning


def rubber(ratio: float, **changes: Any) -> Scene:
    keys: dict[str, Any] = {
        "geometry": {"shape": "fiber_on_block", "radius": 0.5, "width": 2.0, "height": 1.0},
        "mesh": {"size": 0.3, "contact_size": 0.09},
        "materials": {"rubber": {"young": 2.0, "poisson": ratio}},
        "bodies": {"fiber": "elastic", "block": "rubber"},
        "boundaries": [{"on": "bottom", "displacement": [0, 0]}, {"on": "top", "displacement": [0, -0.05]}],
        "contact": {},
        "output": QUIET,
    }
    return Scene(**{**keys, **changes})


@pytest.mark.mpi
def test_elements_that_lock_are_a_warning(comm: MPI.Comm) -> None:
    words = 'body "block" with Poisson\'s ratio 0.4999 is too stiff in linear elements, which lock: take mesh.order = 2'
    lines = plan(rubber(0.4999), comm).splitlines()
    assert [line.split(None, 1) for line in lines if line.startswith("warning")] == [["warning", words]]
    for scene in (
        rubber(0.45),
        rubber(0.4999, mesh={"size": 0.3, "contact_size": 0.1, "order": 2}),
        rubber(0.4999, model={"plane": "stress"}),
    ):
        assert "warning" not in plan(scene, comm)


def test_the_run_says_so_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(rubber(0.49), MPI.COMM_SELF, tmp_path / "out")
    assert capsys.readouterr().out.count("which lock") == 1
    log = (tmp_path / "out" / "log.txt").read_text().splitlines()
    assert [line.split(" ", 3)[2] for line in log if "mesh.order = 2" in line] == ["WARNING"]


def test_order_2_does_not_lock() -> None:
    """A half disc pressed on rubber: 0.0865 uN on a finer mesh, of which order 1 makes twice as much."""
    found = {}
    for order in (1, 2):
        scene = rubber(
            0.4999,
            mesh={"size": 0.15, "contact_size": 0.05, "order": order},
            boundaries=[
                {"on": "bottom", "displacement": [0, 0]},
                {"on": "top", "displacement": [0, -0.05], "follows": "press"},
            ],
            load={"steps": [4], "factors": {"press": [1.0]}},
        )
        finished = run(scene, MPI.COMM_SELF)
        found[order] = -finished.history[-1]["force_y@top"]
        assert len(finished.model.warnings) == (order == 1)
    assert found[2] == pytest.approx(0.0865, rel=0.005)
    assert found[1] > 1.5 * found[2]


@pytest.mark.parametrize("ratio", [-0.5, 0.0, 0.3, 0.4999])
def test_the_ratio_of_a_material_in_any_axes(ratio: float) -> None:
    assert Material.isotropic(2.0, ratio).rotated([1, 2, 3]).poisson_ratio == pytest.approx(ratio, abs=1e-11)


def test_built_in_materials_do_not_lock() -> None:
    assert all(0.2 < material.poisson_ratio < 0.45 for material in BUILT_IN.values())
    np.testing.assert_allclose(BUILT_IN["pvdf"].poisson_ratio, 0.3)


def electrodes(*rows: dict[str, Any], lower: str = "elastic") -> Scene:
    """A layer under one of pvdf, held below, with more boundaries."""
    return Scene(
        geometry={"shape": "cantilever", "layers": [0.5, 0.5], "divisions": [4, 1]},
        bodies={"layer_1": lower, "layer_2": "pvdf"},
        boundaries=[{"on": "root", "displacement": [0, 0]}, *rows],
        load={"steps": [1], "factors": {"press": [1.0]}} if any("follows" in row for row in rows) else {},
        output=QUIET,
    )


@pytest.mark.mpi
@pytest.mark.parametrize("key", ["potential", "charge_density"])
def test_electrodes_need_a_permittivity(comm: MPI.Comm, key: str) -> None:
    """Of the body that they are on: a bonded neighbour's at their edge is not enough."""
    with pytest.raises(SceneError, match='on "bottom", where no body has a permittivity') as caught:
        plan(electrodes({"on": "top", "potential": 0}, {"on": "bottom", key: 1.0}), comm)
    assert caught.value.key == f"boundaries[2].{key}"
    assert plan(electrodes({"on": "top", key: 1.0}), comm)
    if key == "potential":
        assert plan(electrodes({"on": "interface_1", key: 1.0}), comm)
    assert plan(electrodes({"on": "bottom", key: 1.0}, lower="dielectric"), comm)
    assert plan(electrodes({"on": "tip", key: 1.0}), comm)  # of both layers


def overlapping(path: Path) -> None:
    """A unit square with the groups bottom, sides (all of its outline but the top) and top."""
    with gmsh_model.session():
        surface = gmsh.model.occ.addRectangle(0, 0, 0, 1, 1)
        gmsh.model.occ.synchronize()
        curves = [tag for _, tag in gmsh.model.getBoundary([(2, surface)], oriented=False)]
        gmsh.model.addPhysicalGroup(2, [surface], name="body")
        for name, members in {
            "bottom": curves[:1],
            "sides": [curves[i] for i in (0, 1, 3)],
            "top": curves[2:3],
        }.items():
            gmsh.model.addPhysicalGroup(1, members, name=name)
        gmsh.model.mesh.generate(2)
        gmsh.write(str(path))


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("bottom", "sides", "wrong"),
    [
        ({"displacement": [0, 0]}, {"displacement": [0, 0.1]}, "displacement y"),
        ({"potential": 0}, {"potential": 5}, "potential"),
        ({"potential": 5}, {"potential": 5, "follows": "press"}, "potential"),
        ({"potential": 0}, {"potential": 0, "follows": "press", "displacement": [0.1, 0]}, None),
        ({"displacement": [0, "free"]}, {"displacement": ["free", 0.1]}, None),
        ({"displacement": [0, 0]}, {"potential": 0}, None),
    ],
)
def test_boundaries_do_not_contradict_each_other_on_a_facet(
    comm: MPI.Comm, shared_tmp_path: Path, bottom: dict, sides: dict, wrong: str | None
) -> None:
    path = shared_tmp_path / "square.msh"
    if comm.rank == 0:
        overlapping(path)
    comm.barrier()
    scene = Scene(
        geometry={"file": str(path)},
        bodies={"body": "pvdf"},
        boundaries=[{"on": "bottom", **bottom}, {"on": "sides", **sides}, {"on": "top", "charge_density": 1.0}],
        load={"steps": [1], "factors": {"press": [1.0]}} if "follows" in sides else {},
    )
    if wrong is None:
        assert plan(scene, comm)
        return
    with pytest.raises(SceneError, match=f'another {wrong} on "sides" than boundaries.0. on "bottom"') as caught:
        plan(scene, comm)
    assert caught.value.key == f"boundaries[1].{wrong.split()[0]}"
