"""scripts/benchmark: the cases that its command line lists."""

from __future__ import annotations

from pathlib import Path

import pytest

from piezomat.cli import main as piezomat
from piezomat.meshes.gmsh_io.model import MeshError
from scripts.studies.benchmark import LAW, SIZES, SURFACES, cases_of, parser
from scripts.studies.two_fibers import measured, run_command, scene_of_shape


def test_two_cases_are_the_default() -> None:
    cases = cases_of(parser().parse_args([]))
    assert list(cases) == ["2d-15k", "3d-20k"]
    assert cases["3d-20k"] == (scene_of_shape(*SIZES["3d-20k"], LAW), list(SURFACES))


def test_an_unknown_case_is_an_error_that_lists_the_known_ones() -> None:
    with pytest.raises(ValueError, match="no case 2d-16k; there are 2d-4k, 2d-15k"):
        cases_of(parser().parse_args(["2d-16k"]))


@pytest.fixture
def mesh(tmp_path: Path) -> Path:
    """A mesh file of two half discs."""
    scene, mesh = tmp_path / "scene.toml", tmp_path / "halves.msh"
    scene.write_text(scene_of_shape("facing_halves", 0.1, 0.2, LAW).to_toml(), encoding="utf-8")
    piezomat(["mesh", str(scene), "--out", str(mesh)])
    return mesh


def test_a_mesh_file_is_the_same_problem_as_its_shape(mesh: Path) -> None:
    cases = cases_of(parser().parse_args(["--mesh", str(mesh), "--surfaces", "upper_contact", "lower_contact"]))
    scene, surfaces = cases["halves.msh"]
    assert list(cases) == ["halves.msh"] and surfaces == ["upper_contact", "lower_contact"]
    shape = scene_of_shape("facing_halves", 0.1, 0.2, LAW)
    assert scene.boundaries == shape.boundaries and scene.bodies == shape.bodies and scene.load == shape.load
    assert scene.contact == shape.contact.model_copy(update={"pairs": [surfaces]})


def test_a_group_that_the_mesh_lacks_is_named(mesh: Path) -> None:
    with pytest.raises(MeshError, match=r"has no group contact_lower; it has .*lower_contact"):
        cases_of(parser().parse_args(["--mesh", str(mesh), "--surfaces", "contact_lower", "upper_contact"]))


def test_a_mesh_file_has_the_force_of_its_shape(mesh: Path, tmp_path: Path) -> None:
    ((scene, _),) = cases_of(parser().parse_args(["--mesh", str(mesh)])).values()
    costs = []
    for case in (scene, scene_of_shape("facing_halves", 0.1, 0.2, LAW)):
        (tmp_path / "case.toml").write_text(case.to_toml(), encoding="utf-8")
        costs.append(measured(run_command(tmp_path / "case.toml")).answer)
    assert costs[0]["force"] == pytest.approx(costs[1]["force"], rel=1e-6)
    assert costs[0]["pressure"] == pytest.approx(costs[1]["pressure"], rel=1e-6)
