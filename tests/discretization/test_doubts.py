"""Doubts: joints that cannot be meant end a run or a plan; others, and elements that lock, are warnings in both."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from piezomat.discretization.model import Model
from piezomat.forms.material_library import BUILT_IN
from piezomat.forms.materials import Material
from piezomat.meshes.body_mesh import create
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
        "mesh": {"size": 0.3, "contact_size": 0.1},
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
    assert capsys.readouterr().out.count("warning: ") == 1
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
