"""The scene's data model: what is accepted, what the defaults are, overrides, and writing it out again."""

from __future__ import annotations

import pickle
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from piezomat.forms.material_library import BUILT_IN
from piezomat.forms.materials import Material
from piezomat.meshes.shapes import FacingHalves
from piezomat.scene import Scene, SceneError, schema
from piezomat.scene import toml as scene_file

# A scene with most of the sections and keys.
CONTRACT = """
title = "Two crossed PVDF fibers, pressed and pulled apart"

[geometry]
shape = "crossed_fibers"
radius = 0.5
length = 2.0

[mesh]
size = 0.1
contact_size = 0.02
order = 1
cells = "simplex"

[model]
plane = "strain"
kinematics = "small"

[materials.pvdf]
young = 2500.0
poisson = 0.3
piezo = { e31 = 0.0307692, e32 = -0.0057692, e33 = -0.075 }
permittivity = 1.0625e-4
poling = [0, 0, 1]

[bodies]
lower = "pvdf"
upper = "pvdf"

[[boundaries]]
on = "bottom"
displacement = [0, 0, 0]
potential = 0

[[boundaries]]
on = "top"
displacement = [0, "free", -0.05]
follows = "press"

[contact]
pairs = "auto"
method = "point"
passes = 2
normal_penalty = 1e5
electric_penalty = 1e-1

[contact.adhesion]
law = "bilinear"
strength = 5.0
energy = 0.05
starts = "touch"

[load]
steps = [10, 20]
[load.factors]
press = [1.0, -0.2]

[solver]
tolerance = 1e-8
petsc = { "ksp_monitor" = "" }

[output]
fields = "end"
picture = true
"""

# Two triangles, one body each, without names; the curves are groups of unnamed facets. MSH 2.2.
TWO_TRIANGLES = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
3
1 3 "floor"
2 1 "left part"
2 2 "right"
$EndPhysicalNames
$Nodes
4
1 0 0 0
2 1 0 0
3 1 1 0
4 0 1 0
$EndNodes
$Elements
4
1 1 2 3 1 1 2
2 1 2 4 2 3 4
3 2 2 1 1 1 3 4
4 2 2 2 2 1 2 3
$EndElements
"""


def halves(**changes: Any) -> Scene:
    """A small scene built in Python."""
    sections: dict[str, Any] = {
        "geometry": {"shape": "facing_halves"},
        "mesh": {"size": 0.2},
        "bodies": {"lower": "pvdf", "upper": "elastic"},
        "boundaries": [{"on": "bottom", "displacement": [0, 0], "potential": 0.0}],
    }
    return Scene(**{**sections, **changes})


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def contract(tmp_path: Path) -> Path:
    return write(tmp_path / "crossed.toml", CONTRACT)


def test_the_example_of_the_contract(contract: Path) -> None:
    scene = Scene.load(contract)
    assert (scene.dimension, scene.electric, scene.body_names) == (3, True, ("lower", "upper"))
    assert scene.geometry.length == 2.0
    assert scene.boundaries[1].displacement == [0.0, None, -0.05]
    assert scene.boundaries[1].follows == "press" and scene.boundaries[0].follows is None
    assert (scene.load.steps, scene.load.factors) == ([10, 20], {"press": [1.0, -0.2]})
    assert scene.contact is not None and scene.contact.adhesion is not None
    assert (scene.contact.normal_penalty, scene.contact.normal_penalty_factor) == (1e5, None)
    assert scene.contact.adhesion.range is None
    assert scene.solver.petsc == {"ksp_monitor": ""}
    np.testing.assert_allclose(scene.material("lower").piezo[2, :3], [0.0307692, -0.0057692, -0.075])


def test_defaults() -> None:
    scene = halves(contact={})
    assert scene.mesh.contact_size == pytest.approx(0.05)
    assert (scene.mesh.order, scene.mesh.cells, scene.mesh.size_factors) == (1, "simplex", {})
    assert (scene.model.plane, scene.model.kinematics) == ("strain", "small")
    assert (scene.load.steps, scene.load.factors) == ([1], {})
    assert (scene.solver.tolerance, scene.solver.max_iterations, scene.solver.max_cutbacks) == (1e-8, 25, 8)
    assert (scene.solver.kind, scene.solver.petsc) == ("auto", {})
    assert (scene.output.fields, scene.output.picture) == ("end", True)
    contact = scene.contact
    assert contact is not None
    assert (contact.pairs, contact.method, contact.passes) == ("auto", "point", 2)
    assert (contact.normal_penalty, contact.normal_penalty_factor) == (None, 10.0)
    assert (contact.medium, contact.medium_gap, contact.medium_range) == ("air", None, None)
    assert (contact.electric_penalty, contact.electric_penalty_factor) == (None, None)
    assert halves(contact={"medium": "none"}).contact.electric_penalty_factor == 10.0
    assert halves(contact={"electric_range": 0.1}).contact.medium == "none"
    assert (contact.nodal_weight, contact.electric_range, contact.adhesion) == (None, None, None)
    assert halves(contact={"method": "node"}).contact.nodal_weight == "area"
    assert halves().contact is None


@pytest.mark.parametrize(
    ("contact", "key", "words"),
    [
        ({"medium": "air", "electric_range": 0.1}, "electric_range", "electric_range with medium"),
        ({"medium": 1e-5, "electric_penalty": 0.1}, "electric_penalty", "electric_penalty with medium"),
        ({"medium": "none", "medium_gap": 0.1}, "medium_gap", "medium_gap with medium"),
        ({"method": "node", "nodal_weight": "unit", "medium": "air"}, "medium", 'nodal_weight = "unit"'),
    ],
)
def test_keys_of_another_law_than_that_of_the_medium_are_errors(contact: dict, key: str, words: str) -> None:
    with pytest.raises(SceneError, match=words) as caught:
        halves(contact=contact)
    assert caught.value.key == f"contact.{key}"


def test_title_is_the_name_of_the_file(tmp_path: Path) -> None:
    text = CONTRACT.replace('title = "Two crossed PVDF fibers, pressed and pulled apart"', "")
    assert Scene.load(write(tmp_path / "pressed.toml", text)).title == "pressed"


def test_written_out_and_read_again_it_is_the_same(contract: Path, tmp_path: Path) -> None:
    scene = Scene.load(contract)
    text = scene.to_toml()
    again = Scene.load(write(tmp_path / "again.toml", text))
    assert again == scene and again.to_toml() == text
    assert "kinematics" in text and "max_cutbacks = 8" in text and 'displacement = [0.0, "free", -0.05]' in text


@pytest.mark.parametrize(
    ("geometry", "bodies", "on"),
    [
        ({"shape": "facing_halves"}, ["lower", "upper"], "bottom"),
        ({"shape": "crossed_fibers", "whole": True}, ["lower", "upper"], "top"),
        ({"shape": "stacked_blocks", "divisions": [[3, 1], [2, 1]]}, ["lower", "upper"], "upper_left"),
        (
            {"shape": "stacked_blocks", "depth": 1.0, "height": [1, 1, 1]},
            ["block_1", "block_2", "block_3"],
            "front",
        ),
        ({"shape": "parallel_fibers", "count": 3}, ["fiber_1", "fiber_2", "fiber_3"], "fiber_2_contact"),
        ({"shape": "fiber_on_block", "length": 2}, ["fiber", "block"], "block_contact"),
        ({"shape": "cantilever"}, ["layer_1", "layer_2"], "interface_1"),
    ],
)
def test_every_shape_survives_writing(geometry: dict[str, Any], bodies: list[str], on: str, tmp_path: Path) -> None:
    scene = Scene(
        geometry=geometry,
        mesh={} if "divisions" in geometry else {"size": 0.25},
        bodies=dict.fromkeys(bodies, "elastic"),
        boundaries=[{"on": on, "pressure": 1}],
    )
    assert Scene.load(write(tmp_path / "scene.toml", scene.to_toml()), ["title=scene"]) == scene


def test_strings_survive_writing() -> None:
    for title in ('say "so"', "back\\slash", "tab\tand\nline", "\x7f", "Φ µm"):
        assert tomllib.loads(scene_file.to_toml({"title": title})) == {"title": title}
    table = {"a key": {"with.dot": [1, 2.5, True, "x"]}, "rows": [{"a": 1}, {"b": {"c": -0.0}}], "empty": {}}
    assert tomllib.loads(scene_file.to_toml(table)) == {key: table[key] for key in ("a key", "rows")}


def test_a_scene_built_in_python_passes_the_same_checks() -> None:
    scene = halves(
        geometry=FacingHalves(radius=0.4),
        boundaries=({"on": "top", "displacement": (np.float64(0), None), "pressure": np.float64(2)},),
    )
    assert scene.geometry == FacingHalves(radius=0.4)
    assert scene.boundaries[0].displacement == [0.0, None]
    assert halves(contact=halves(contact={"normal_penalty": 3}).contact).contact.normal_penalty == 3.0
    with pytest.raises(SceneError, match=r'^mesh\.sise: found an unknown key.*did you mean "size"'):
        halves(mesh={"sise": 0.1})
    with pytest.raises(SceneError, match=r"^mesh\.size: found inf"):
        halves(mesh={"size": np.inf})
    with pytest.raises(SceneError, match=r"^boundaries\[0\]\.traction: found \[1\.0, 2\.0, 3\.0\]; allowed: 2"):
        halves(boundaries=[{"on": "top", "traction": np.array([1.0, 2.0, 3.0])}])


def test_integers_are_numbers_and_nothing_else_is() -> None:
    assert halves(mesh={"size": 1}).mesh.size == 1.0
    for wrong in ("1", True, [1], {"a": 1}):
        with pytest.raises(SceneError, match=r"^mesh\.size: found .*; allowed: a number > 0$"):
            halves(mesh={"size": wrong})
    for wrong in (1.0, True, "1", 3):
        with pytest.raises(SceneError, match=r"^mesh\.order: found .*; allowed: 1 or 2$"):
            halves(mesh={"size": 1, "order": wrong})


def test_overrides(contract: Path) -> None:
    overrides = [
        "contact.method=node",
        "boundaries.1.potential=2",
        "boundaries[0].potential = -1.5",
        "load.steps=[3, 4]",
        'materials.soft={like = "elastic", young = 10.0}',
        "bodies.upper=soft",
        "output.picture=false",
        "contact.normal_penalty_factor=50",
        "mesh.size_factors.upper=2",
    ]
    scene = Scene.load(contract, overrides)
    assert scene.contact is not None
    assert (scene.contact.method, scene.load.steps, scene.output.picture) == ("node", [3, 4], False)
    assert [row.potential for row in scene.boundaries] == [-1.5, 2.0]
    assert (scene.contact.normal_penalty, scene.contact.normal_penalty_factor) == (None, 50.0)
    assert scene.sizes.factors == {"upper": 2.0}
    np.testing.assert_allclose(scene.material("upper").stiffness, Material.isotropic(10.0, 0.3).stiffness)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("contact.method", '--set: found "contact.method"; allowed: KEY=VALUE'),
        ("=3", "--set: found"),
        ("a..b=3", "--set: found"),
        (
            "boundaries.7.potential=1",
            "boundaries[7]: found an index outside the list; allowed: indices 0 to 1",
        ),
        ("boundaries.top.potential=1", 'boundaries: found "top"'),
        ("title.x=1", "title: found"),
        ("contact.metod=node", "contact.metod: found an unknown key"),
        ("mesh.size=0.1\nmesh.order=2", "mesh.size: found"),
    ],
)
def test_wrong_overrides(contract: Path, override: str, message: str) -> None:
    with pytest.raises(SceneError) as error:
        Scene.load(contract, [override])
    assert message in str(error.value)


def test_materials_start_from_built_in_ones() -> None:
    def material(**keys: Any) -> Material:
        return halves(
            materials={"m": keys},
            bodies={"lower": "m", "upper": "m"},
            boundaries=[{"on": "top", "pressure": 1.0}],
        ).material("lower")

    np.testing.assert_allclose(material(like="pvdf", poisson=0.2).stiffness, Material.isotropic(2500, 0.2).stiffness)
    softer = material(like="pzt4", young=1.0, poisson=0.0, poling=[0, 0, 1])
    np.testing.assert_allclose(softer.stiffness, np.diag([1, 1, 1, 0.5, 0.5, 0.5]))
    np.testing.assert_allclose(softer.piezo, BUILT_IN["pzt4"].piezo)
    by_matrix = material(stiffness=np.eye(6), permittivity=[1, 2, 3], piezo=np.ones((3, 6)), poling=[0, 0, 1])
    np.testing.assert_allclose(by_matrix.permittivity, np.diag([1, 2, 3]))
    np.testing.assert_allclose(by_matrix.piezo, np.ones((3, 6)))
    constants = material(
        like="elastic",
        permittivity=1,
        piezo={"e31": 1, "e32": 2, "e33": 3, "e15": 4, "e24": 5},
        poling=[0, 0, 1],
    )
    np.testing.assert_allclose(constants.piezo, [[0, 0, 0, 0, 4, 0], [0, 0, 0, 5, 0, 0], [1, 2, 3, 0, 0, 0]])


@pytest.mark.parametrize("value", [1e-300, 1e-15, [1e-4, 1e-4, 1e-12]])
def test_a_permittivity_far_below_that_of_vacuum_is_another_unit(value: Any) -> None:
    with pytest.raises(SceneError, match=r"permittivity: found .*; allowed: 1e-09 or more.*vacuum is 8\.854e-6"):
        halves(materials={"m": {"like": "elastic", "permittivity": value}}, bodies={"lower": "m", "upper": "m"})


def test_a_byte_order_mark_is_no_part_of_a_scene(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(halves().to_toml(), encoding="utf-8-sig")
    assert path.read_bytes().startswith(b"\xef\xbb\xbf")
    assert Scene.load(path) == halves()


def test_poling() -> None:
    up = halves().material("lower")
    np.testing.assert_allclose(up.piezo, BUILT_IN["pvdf"].rotated([0, 1, 0]).piezo)
    assert halves().material("upper") is BUILT_IN["elastic"]
    assert "poling = [0.0, 1.0]" in halves(materials={"m": {"like": "pvdf"}}).to_toml()
    assert "poling" not in halves(materials={"m": {"like": "elastic"}}).to_toml()
    turned = halves(
        materials={"m": {"like": "pvdf", "poling": [1, 1], "axis1": [0, 0, 1]}},
        bodies={"lower": "m", "upper": "m"},
    )
    expected = BUILT_IN["pvdf"].rotated([1, 1, 0], [0, 0, 1])
    np.testing.assert_allclose(turned.material("upper").piezo, expected.piezo)


def test_axes_that_follow_fibers() -> None:
    def fibers(**material: object) -> Scene:
        return Scene(
            geometry={"shape": "crossed_fibers"},
            mesh={"size": 0.3},
            materials={"m": {"like": "pvdf", **material}},
            bodies={"lower": "m", "upper": "elastic"},
            boundaries=[{"on": "bottom", "displacement": [0, 0, 0]}],
        )

    across = fibers(poling="across")
    assert across.follows_line("m") and not across.follows_line("elastic")
    np.testing.assert_array_equal(across.material("lower").piezo, BUILT_IN["pvdf"].piezo)
    written = tomllib.loads(across.to_toml())["materials"]["m"]
    assert (written["poling"], written["axis1"]) == ("across", "along")
    again = Scene(**tomllib.loads(across.to_toml())).to_toml()
    assert tomllib.loads(again) == tomllib.loads(across.to_toml())
    upward = fibers(axis1="along")
    assert upward.poling("m") == [0.0, 0.0, 1.0] and upward.follows_line("m")
    with pytest.raises(SceneError, match=r"^materials\.m\.poling: found \[1.0, 0.02, 0.03\]; .*of lower .*\(1, 0, 0\)"):
        fibers(poling=[1, 0.02, 0.03], axis1="along")
    assert fibers(poling=[1, 0.2, 0], axis1="along").follows_line("m")
    with pytest.raises(SceneError, match=r'^materials\.m\.poling: found "acros"; allowed: .*"across"'):
        fibers(poling="acros")
    with pytest.raises(SceneError, match=r'^materials\.m\.axis1: .*"along", or nothing'):
        fibers(poling="across", axis1=[1, 0, 0])


@pytest.mark.parametrize(
    ("geometry", "body", "why"),
    [
        ({"shape": "stacked_blocks", "depth": 1.0}, "lower", "body lower has no centre line"),
        ({"shape": "fiber_on_block", "length": 1.0}, "block", "body block has no centre line"),
        ({"shape": "fiber_array", "columns": 2, "rows": 1}, "fiber_1", "in two dimensions"),
    ],
)
@pytest.mark.parametrize("axis", ["poling", "axis1"])
def test_axes_cannot_follow_what_has_no_centre_line(geometry: dict[str, Any], body: str, why: str, axis: str) -> None:
    dimension = 2 if geometry["shape"] == "fiber_array" else 3
    with pytest.raises(SceneError, match=rf"^materials\.m\.{axis}: found .*allowed: a vector.*: .*{why}"):
        Scene(
            geometry=geometry,
            mesh={"size": 0.3},
            materials={"m": {"like": "pvdf", axis: "across" if axis == "poling" else "along"}},
            bodies={"*": "elastic", body: "m"},
            boundaries=[{"on": "surfaces" if dimension == 2 else "bottom", "displacement": [0] * dimension}],
        )


def test_potential_only_where_there_is_permittivity() -> None:
    assert halves().electric
    with pytest.raises(SceneError, match=r"^boundaries\[0\]\.potential: found 0"):
        halves(bodies={"lower": "elastic", "upper": "elastic"})


def test_sizes() -> None:
    sizes = halves(mesh={"size": 0.2, "order": 2, "size_factors": {"upper": 3}}).sizes
    assert (sizes.size, sizes.contact_size, sizes.order, sizes.cells) == (0.2, 0.05, 2, "simplex")
    assert sizes.of("upper") == pytest.approx((0.15, 0.6))


def test_mesh_files_give_the_names(tmp_path: Path) -> None:
    write(tmp_path / "two.msh", TWO_TRIANGLES)
    text = """
        geometry.file = "two.msh"
        bodies = { "left part" = "elastic", right = "elastic" }
        boundaries = [{ on = "floor", displacement = [0, 0] }, { on = "4", pressure = 1.0 }]
        contact.pairs = [["left part", "right"]]
    """
    scene = Scene.load(write(tmp_path / "scene.toml", text))
    assert (scene.dimension, scene.body_names, scene.facet_groups) == (
        2,
        ("left part", "right"),
        ("floor", "4"),
    )
    assert scene.geometry.file == tmp_path / "two.msh"
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    assert Scene.load(write(elsewhere / "scene.toml", scene.to_toml())) == scene


def test_scenes_and_errors_travel_between_ranks(contract: Path) -> None:
    scene = Scene.load(contract)
    copy = pickle.loads(pickle.dumps(scene))
    assert copy == scene and copy.dimension == 3 and copy.to_toml() == scene.to_toml()
    error = pickle.loads(pickle.dumps(SceneError("a.b", 3, "less").in_file("s.toml")))
    assert str(error) == "s.toml: a.b: found 3; allowed: less" and error.key == "a.b"


def test_a_scene_does_not_change() -> None:
    with pytest.raises(ValueError, match="frozen"):
        halves().mesh.size = 1.0  # type: ignore[misc]


def test_the_schema_lists_what_is_allowed_and_no_more() -> None:
    definitions = schema()["$defs"]
    assert definitions["Contact"]["properties"]["method"]["enum"] == ["node", "point", "segment"]
    assert definitions["Adhesion"]["properties"]["law"]["enum"] == ["cutoff", "bilinear", "lennard_jones"]
    assert definitions["Boundary"]["additionalProperties"] is False
    assert {"geometry", "bodies"} == set(schema()["required"])


@pytest.mark.parametrize("name", scene_file.examples())
def test_shipped_examples(name: str) -> None:
    scene = Scene.load(name)
    assert scene.title
    assert Scene.load(scene_file.EXAMPLES / f"{name}.toml") == scene
