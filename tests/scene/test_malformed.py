"""Wrong scenes: exit status 2, one line on standard error that names file and key, fast, nothing left."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from piezomat import cli
from piezomat.results.folder import MARK

ROOT = Path(__file__).parents[2]
LIMIT = 10.0  # s of the processor: what else the machine does is not the program's fault

SCENE = """
[geometry]
shape = "facing_halves"
radius = 0.5

[mesh]
size = 0.25

[model]
plane = "strain"

[materials.soft]
like = "pvdf"

[materials.own]
young = 1000.0
poisson = 0.3
piezo = { e31 = 0.03, e32 = 0.0, e33 = -0.07 }
permittivity = 1e-4
poling = [0, 1]

[bodies]
lower = "soft"
upper = "own"

[[boundaries]]
on = "bottom"
displacement = [0, 0]
potential = 0

[[boundaries]]
on = "top"
displacement = ["free", -0.01]
follows = "press"

[contact]
pairs = [["lower", "upper"]]

[contact.adhesion]
law = "bilinear"
strength = 5.0
energy = 0.05

[load]
steps = [2, 2]
[load.factors]
press = [1.0, 0.0]
"""

SQUARE = """$MeshFormat
2.2 0 8
$EndMeshFormat
$Nodes
4
1 0 0 0
2 1 0 0
3 1 1 0
4 0 1 0
$EndNodes
$Elements
3
1 1 2 3 1 1 2
2 2 2 1 1 1 2 3
3 2 2 1 1 1 3 4
$EndElements
"""
TRIANGLES = "2 2 2 1 1 1 2 3\n3 2 2 1 1 1 3 4\n"
SQUARE_SCENE = """
geometry.file = "square.msh"
bodies.1 = "elastic"
boundaries = [{ on = "3", displacement = [0, 0] }]
"""


# Two squares of one cell; the upper one reaches 0.15 into the lower one.
OVERLAPPING = """$MeshFormat
2.2 0 8
$EndMeshFormat
$Nodes
8
1 0 0 0
2 1 0 0
3 1 1 0
4 0 1 0
5 0.1 0.85 0
6 0.9 0.85 0
7 0.9 1.65 0
8 0.1 1.65 0
$EndNodes
$Elements
4
1 1 2 3 1 1 2
2 1 2 4 2 7 8
3 3 2 1 1 1 2 3 4
4 3 2 2 2 5 6 7 8
$EndElements
"""
OVERLAPPING_SCENE = """
geometry.file = "overlapping.msh"
bodies = { 1 = "elastic", 2 = "elastic" }
boundaries = [{ on = "3", displacement = [0, 0] }, { on = "4", displacement = [0, 0] }]
contact = {}
"""


@dataclass(frozen=True)
class Wrong:
    """The scene above with `old` replaced by `new`: the key that is to be named, and words of the message."""

    old: str
    new: str
    key: str
    words: str = ""


def matrix(last: float) -> str:
    rows = [[0.0] * i + [last if i == 5 else 1.0] + [0.0] * (5 - i) for i in range(6)]
    return f"stiffness = {rows}"


OWN = "young = 1000.0\npoisson = 0.3"
ASYMMETRIC = matrix(1.0).replace("[[1.0, 0.0", "[[1.0, 0.5")
PERMITTIVITY = "permittivity = 1e-4"
PIEZO = "piezo = { e31 = 0.03, e32 = 0.0, e33 = -0.07 }"
STUCK = 'displacement = ["free", -0.01]\ntraction'
PLANE = SCENE[SCENE.index("shape =") : SCENE.index("[materials.soft]")]
SOLID = 'shape = "crossed_fibers"\n[mesh]\nsize = 0.25\n[model]\nplane = "stress"\n'

WRONG = {
    "unknown section": Wrong("[contact]", "[contakt]\n[contact]", "contakt", '"contact"'),
    "unknown key": Wrong("size = 0.25", "size = 0.25\ncontact_sise = 0.1", "mesh.contact_sise", '"contact_size"'),
    "unknown key in a list": Wrong("potential = 0", "potental = 0", "boundaries[0].potental", '"potential"'),
    "unknown key of a shape": Wrong("radius = 0.5", "radios = 0.5", "geometry.radios", '"radius"'),
    "key of another section": Wrong("size = 0.25", "size = 0.25\nplane = 1", "mesh.plane", '"model.plane"'),
    "missing section": Wrong("[bodies]", "[solver.petsc]", "bodies", "nothing"),
    "missing key": Wrong('on = "bottom"', "", "boundaries[0].on", "nothing"),
    "missing size": Wrong("size = 0.25", "", "mesh.size", "nothing"),
    "missing shape": Wrong('shape = "facing_halves"', "", "geometry.shape", "facing_halves"),
    "unknown shape": Wrong('"facing_halves"', '"facing_halfs"', "geometry.shape", '"facing_halves"'),
    "shape and file": Wrong("radius = 0.5", 'file = "a.msh"', "geometry.file", "either"),
    "string for a number": Wrong("radius = 0.5", 'radius = "0.5"', "geometry.radius", '"0.5"'),
    "boolean for a number": Wrong("size = 0.25", "size = true", "mesh.size", "true"),
    "number for a boolean": Wrong("[contact]", "[output]\npicture = 1\n[contact]", "output.picture", "true or false"),
    "number for an integer": Wrong("steps = [2, 2]", "steps = [2, 2.0]", "load.steps[1]", "2.0"),
    "not a number": Wrong("size = 0.25", "size = nan", "mesh.size", "finite"),
    "infinite": Wrong("strength = 5.0", "strength = inf", "contact.adhesion.strength", "finite"),
    "table for a number": Wrong("size = 0.25", "size = { far = 1 }", "mesh.size", "a number > 0"),
    "negative size": Wrong("size = 0.25", "size = -0.25", "mesh.size", "-0.25"),
    "contact size too large": Wrong("size = 0.25", "size = 0.25\ncontact_size = 1", "mesh.contact_size", "0.25"),
    "order": Wrong("size = 0.25", "size = 0.25\norder = 3", "mesh.order", "1 or 2"),
    "size factor": Wrong("size = 0.25", "size = 1\nsize_factors = { uper = 2 }", "mesh.size_factors.uper", "upper"),
    "overlap": Wrong("radius = 0.5", "radius = 0.5\ngap = -0.06", "geometry.gap", "-0.05"),
    "plane": Wrong('plane = "strain"', 'plane = "strian"', "model.plane", '"strain" or "stress"'),
    "plane stress in 3D": Wrong(PLANE, SOLID, "model.plane", "three dimensions"),
    "negative modulus": Wrong("young = 1000.0", "young = -1000.0", "materials.own.young", "> 0"),
    "incompressible": Wrong("poisson = 0.3", "poisson = 0.5", "materials.own.poisson", "< 0.5"),
    "no elasticity": Wrong(OWN, "", "materials.own.young", "stiffness"),
    "half an elasticity": Wrong("poisson = 0.3", "", "materials.own.poisson", "young"),
    "two elasticities": Wrong(OWN, f"{OWN}\n{matrix(1.0)}", "materials.own.stiffness", "either"),
    "indefinite stiffness": Wrong(OWN, matrix(-2.0), "materials.own.stiffness", "eigenvalue is -2"),
    "asymmetric stiffness": Wrong(OWN, ASYMMETRIC, "materials.own.stiffness", "entry 1,2"),
    "too small a stiffness": Wrong(OWN, "stiffness = [[1, 0, 0, 0, 0, 0]]", "materials.own.stiffness", "6"),
    "negative permittivity": Wrong(PERMITTIVITY, "permittivity = -1e-4", "materials.own.permittivity", "> 0"),
    "indefinite permittivity": Wrong(
        PERMITTIVITY, "permittivity = [1e-4, 1e-4, -1e-4]", "materials.own.permittivity", "eigenvalue"
    ),
    "piezo without permittivity": Wrong(PERMITTIVITY, "", "materials.own.permittivity", "piezo"),
    "piezo constant": Wrong("e31 = 0.03", "e13 = 0.03", "materials.own.piezo.e13", "e31"),
    "piezo matrix": Wrong(PIEZO, "piezo = [[1, 2, 3]]", "materials.own.piezo", "3"),
    "zero poling": Wrong("poling = [0, 1]", "poling = [0, 0]", "materials.own.poling", "zero"),
    "parallel axes": Wrong("poling = [0, 1]", "poling = [0, 1]\naxis1 = [0, 2]", "materials.own.axis1", "parallel"),
    "built-in material": Wrong('like = "pvdf"', 'like = "pzt5"', "materials.soft.like", '"pzt5h"'),
    "unknown material": Wrong('lower = "soft"', 'lower = "sotf"', "bodies.lower", '"soft"'),
    "unknown body": Wrong('lower = "soft"', 'lowr = "soft"', "bodies.lowr", '"lower"'),
    "body without material": Wrong('lower = "soft"', "", "bodies.lower", "nothing"),
    "unknown group": Wrong('on = "bottom"', 'on = "botom"', "boundaries[0].on", '"bottom"'),
    "group twice": Wrong('on = "top"', 'on = "bottom"', "boundaries[1].displacement", "boundaries[0]"),
    "no condition": Wrong("displacement = [0, 0]\npotential = 0", "", "boundaries[0]", "displacement"),
    "too many components": Wrong("= [0, 0]", "= [0, 0, 0]", "boundaries[0].displacement", "2 components"),
    "component": Wrong('["free", -0.01]', '["fre", -0.01]', "boundaries[1].displacement[0]", '"free"'),
    "held and loaded": Wrong(STUCK[:30], f"{STUCK} = [0, 1]", "boundaries[1].traction[1]", '"free"'),
    "potential and charge": Wrong(
        "potential = 0", "potential = 0\ncharge_density = 1", "boundaries[0].charge_density", "either"
    ),
    "potential without permittivity": Wrong(
        'lower = "soft"\nupper = "own"',
        'lower = "elastic"\nupper = "elastic"',
        "boundaries[0].potential",
        "permittivity",
    ),
    "unknown factor": Wrong('follows = "press"', 'follows = "pres"', "boundaries[1].follows", '"press"'),
    "unused factor": Wrong("press = [1.0", "pull = [1, 1]\npress = [1.0", "load.factors.pull", "press"),
    "values of a factor": Wrong("[1.0, 0.0]", "[1.0]", "load.factors.press", "2"),
    "no steps": Wrong("steps = [2, 2]", "steps = []", "load.steps", "1 or more"),
    "zero steps": Wrong("steps = [2, 2]", "steps = [2, 0]", "load.steps[1]", ">= 1"),
    "pair of nothing": Wrong('["lower", "upper"]', '["lower", "uper"]', "contact.pairs[0][1]", '"upper"'),
    "pair with itself": Wrong('["lower", "upper"]', '["lower", "lower"]', "contact.pairs[0]", "different"),
    "pair twice": Wrong(
        '["lower", "upper"]', '["lower", "upper"], ["upper", "lower"]', "contact.pairs[1]", "contact.pairs[0]"
    ),
    "pair of three": Wrong('["lower", "upper"]', '["lower", "upper", "top"]', "contact.pairs", "2"),
    "no pairs": Wrong('[["lower", "upper"]]', "[]", "contact.pairs", "auto"),
    "contact method": Wrong("[contact]", '[contact]\nmethod = "mortar"', "contact.method", '"point" or "segment"'),
    "self-contact of named pairs": Wrong(
        "[contact]", "[contact]\nself_contact = true", "contact.self_contact", 'false, or pairs = "auto"'
    ),
    "self-contact": Wrong("[contact]", "[contact]\nself_contact = 1", "contact.self_contact", "true or false"),
    "passes": Wrong("[contact]", "[contact]\npasses = 3", "contact.passes", "1 or 2"),
    "penalty and factor": Wrong(
        "[contact]",
        "[contact]\nnormal_penalty = 1\nnormal_penalty_factor = 1",
        "contact.normal_penalty",
        "either",
    ),
    "nodal weight of points": Wrong("[contact]", '[contact]\nnodal_weight = "unit"', "contact.nodal_weight", "node"),
    "adhesion law": Wrong('"bilinear"', '"linear"', "contact.adhesion.law", "lennard_jones"),
    "lennard_jones at touch": Wrong(
        '"bilinear"', '"lennard_jones"\nstarts = "touch"', "contact.adhesion.starts", "attracts whatever comes near"
    ),
    "range of lennard_jones": Wrong(
        '"bilinear"\nstrength = 5.0\nenergy',
        '"lennard_jones"\nstrength = 5.0\nrange',
        "contact.adhesion.range",
        "cutoff",
    ),
    "range of a bilinear law": Wrong("energy = 0.05", "range = 0.05", "contact.adhesion.range", "cutoff"),
    "adhesion without energy": Wrong("energy = 0.05", "", "contact.adhesion.energy", "nothing"),
    "tolerance": Wrong("[contact]", "[solver]\ntolerance = 0.1\n[contact]", "solver.tolerance", "< 0.01"),
    "petsc option": Wrong("[contact]", "[solver.petsc]\nksp = [1]\n[contact]", "solver.petsc.ksp", "[1]"),
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def contents(folder: Path) -> set[Path]:
    return set(folder.rglob("*"))


def processor_time() -> float:
    """What this process and the children that it waited for have used so far (s)."""
    return sum(os.times()[:4])


def refused(capsys: pytest.CaptureFixture[str], folder: Path, key: str, words: str = "", command: str = "run") -> None:
    """Run the scene of the folder in this process: it is refused as the contract says."""
    before, start = contents(folder), processor_time()
    assert cli.main([command, "wrong.toml"]) == 2
    assert processor_time() - start < LIMIT
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1
    prefix = f"wrong.toml: {key}: found " if key else "wrong.toml: found "
    assert err.startswith(prefix) and "; allowed: " in err and words in err
    assert contents(folder) == before


@pytest.mark.parametrize("name", WRONG)
def test_wrong_scenes(name: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = WRONG[name]
    assert wrong.old in SCENE
    (folder / "wrong.toml").write_text(SCENE.replace(wrong.old, wrong.new, 1), encoding="utf-8")
    refused(capsys, folder, wrong.key, wrong.words)


@pytest.mark.parametrize("command", ["run", "plan"])
def test_every_command_checks_the_scene(command: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "wrong.toml").write_text(SCENE.replace("size = 0.25", "size = 0"), encoding="utf-8")
    refused(capsys, folder, "mesh.size", "> 0", command)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"title = \n", "line 1"),
        (b"[mesh]\nsize = 1\n[mesh]\n", "no TOML"),
        (b"title = '\xff\xfe'\n", "UTF-8"),
        (b"\x7fELF\x00\x01", "no TOML"),
        (b"a = " + 5000 * b"[", "TOML"),
    ],
)
def test_files_that_are_no_scene(content: bytes, words: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "wrong.toml").write_bytes(content)
    refused(capsys, folder, "", words)


def test_an_empty_file(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "wrong.toml").touch()
    refused(capsys, folder, "geometry", "nothing")


@pytest.mark.parametrize(
    ("mesh", "words"),
    [
        (None, "no such file"),
        (b"", "square.msh"),
        (b"solid cube\nfacet normal 0 0 1\n", "square.msh"),
        (SQUARE.replace("2.2 0 8", "1.0 0 8").encode(), "square.msh"),
        (SQUARE[:135].encode(), ""),
        (SQUARE.replace(TRIANGLES, "").replace("\n3\n1 1 2", "\n1\n1 1 2").encode(), "no cells"),
    ],
    ids=["missing", "empty", "no mesh", "version", "truncated", "no cells"],
)
def test_broken_mesh_files(mesh: bytes | None, words: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if mesh is not None:
        (folder / "square.msh").write_bytes(mesh)
    (folder / "wrong.toml").write_text(SQUARE_SCENE, encoding="utf-8")
    refused(capsys, folder, "geometry.file", words)


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        ('bodies.1 = "elastic"', 'bodies.2 = "elastic"', "bodies.2", "1"),
        ('on = "3"', 'on = "2"', "boundaries[0].on", "3"),
        ("boundaries =", "contact = {}\nboundaries =", "contact.pairs", "two bodies"),
        ("[0, 0]", "[0, 0, 0]", "boundaries[0].displacement", "2 components"),
    ],
)
def test_names_that_a_mesh_file_does_not_have(
    old: str, new: str, key: str, words: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "square.msh").write_text(SQUARE, encoding="utf-8")
    (folder / "wrong.toml").write_text(SQUARE_SCENE.replace(old, new), encoding="utf-8")
    refused(capsys, folder, key, words)


def test_bodies_of_a_mesh_file_that_overlap(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "overlapping.msh").write_text(OVERLAPPING, encoding="utf-8")
    (folder / "wrong.toml").write_text(OVERLAPPING_SCENE, encoding="utf-8")
    refused(capsys, folder, "geometry", "overlap")


CUBE = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))


def cubes(overlap: float) -> str:
    """Two cubes of one cell, 1 and 0.8 wide; the upper one reaches into the lower one. Groups 3 (below), 4 (above)."""
    upper = [(0.1 + 0.8 * x, 0.1 + 0.8 * y, 1.0 - overlap + z) for x, y, z in CUBE]
    nodes = [f"{i} {x} {y} {z}" for i, (x, y, z) in enumerate([*CUBE, *upper], start=1)]
    elements = ["1 3 2 3 3 1 4 3 2", "2 3 2 4 4 13 14 15 16", "3 5 2 1 1 1 2 3 4 5 6 7 8"]
    elements += ["4 5 2 2 2 9 10 11 12 13 14 15 16"]
    head = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$Nodes", "16"]
    return "\n".join([*head, *nodes, "$EndNodes", "$Elements", "4", *elements, "$EndElements", ""])


@pytest.mark.parametrize("overlap", [0.2, 0.4])
def test_cubes_of_a_mesh_file_that_overlap(overlap: float, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "overlapping.msh").write_text(cubes(overlap), encoding="utf-8")
    (folder / "wrong.toml").write_text(OVERLAPPING_SCENE.replace("[0, 0]", "[0, 0, 0]"), encoding="utf-8")
    refused(capsys, folder, "geometry", f"overlap by {overlap:g}")


@pytest.mark.parametrize("gap", [0.05, 0.0, -0.2])
def test_cubes_that_overlap_a_little_or_not_at_all(gap: float, folder: Path) -> None:
    (folder / "overlapping.msh").write_text(cubes(gap), encoding="utf-8")
    (folder / "scene.toml").write_text(OVERLAPPING_SCENE.replace("[0, 0]", "[0, 0, 0]"), encoding="utf-8")
    quiet = ["--set", "output.fields=none", "output.picture=false"]
    assert cli.main(["run", "scene.toml", *quiet]) == 0


@pytest.mark.parametrize(
    ("shape", "least"),
    [
        ('shape = "crossed_fibers"\ngap = -0.051', "-0.05"),
        ('shape = "crossed_fibers"\nwhole = true\ngap = -0.11', "-0.1"),
        ('shape = "stacked_blocks"\nheight = [0.4, 1.0]\ngap = -0.041', "-0.04"),
        ('shape = "fiber_on_block"\ngap = -0.2', "-0.05"),
        ('shape = "parallel_fibers"\ncount = 3\ngap = -0.5', "-0.1"),
    ],
)
def test_shapes_that_overlap(shape: str, least: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bodies = {"fiber_on_block": ("block", "fiber"), "parallel_fibers": ("fiber_1", "fiber_2", "fiber_3")}
    names = next((names for key, names in bodies.items() if key in shape), ("lower", "upper"))
    held = '[[boundaries]]\non = "bottom"\ndisplacement = [0, 0, 0]'
    sections = [f"[geometry]\n{shape}", "[mesh]\nsize = 0.3", "[contact]", held, "[bodies]"]
    materials = [f'{name} = "elastic"' for name in names]
    (folder / "wrong.toml").write_text("\n".join([*sections, *materials]), encoding="utf-8")
    refused(capsys, folder, "geometry.gap", least)


@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.9, 0.999])
def test_mesh_files_that_break_off(share: float, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Binary, as the program itself writes them."""
    (folder / "scene.toml").write_text(SCENE, encoding="utf-8")
    assert cli.main(["mesh", "scene.toml", "--out", "whole.msh"]) == 0
    capsys.readouterr()
    whole = (folder / "whole.msh").read_bytes()
    (folder / "broken.msh").write_bytes(whole[: int(share * len(whole))])
    text = SCENE.replace('shape = "facing_halves"\nradius = 0.5', 'file = "broken.msh"').replace("size = 0.25", "")
    (folder / "wrong.toml").write_text(text, encoding="utf-8")
    refused(capsys, folder, "geometry.file", "broken.msh")


def test_a_mesh_file_with_a_cell_turned_over(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "square.msh").write_text(SQUARE.replace("3 1 1 0", "3 0.3 -0.1 0"), encoding="utf-8")
    (folder / "wrong.toml").write_text(SQUARE_SCENE, encoding="utf-8")
    refused(capsys, folder, "geometry.file", "inverted or degenerate")


def test_a_facet_group_of_a_mesh_file_without_facets(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = '$PhysicalNames\n1\n1 7 "rim"\n$EndPhysicalNames\n$Nodes'
    (folder / "square.msh").write_text(SQUARE.replace("$Nodes", names, 1), encoding="utf-8")
    (folder / "wrong.toml").write_text(SQUARE_SCENE.replace('on = "3"', 'on = "rim"'), encoding="utf-8")
    refused(capsys, folder, "boundaries[0].on", '"rim"')


INSIDE = """
geometry = { shape = "cantilever", length = 4.0, divisions = [4, 1] }
bodies = { layer_1 = "elastic", layer_2 = "elastic" }
boundaries = [{ on = "root", displacement = [0, 0] }]
contact.pairs = [["tip", "interface_1"]]
"""


def test_a_contact_pair_without_facets_outside(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "wrong.toml").write_text(INSIDE, encoding="utf-8")
    refused(capsys, folder, "contact.pairs[0]", '"interface_1", which has no facets on the outside')


def test_contact_of_bodies_that_are_one(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "wrong.toml").write_text(INSIDE.replace('[["tip", "interface_1"]]', '"auto"'), encoding="utf-8")
    refused(capsys, folder, "contact.pairs", "no two bodies")


@pytest.mark.parametrize(
    ("law", "key", "words"),
    [
        ('law = "bilinear"\nenergy = 1e-6', "energy", "strength^2 / (2 normal_penalty)"),
        ('law = "cutoff"\nenergy = 1e-6', "energy", "larger penalty"),
        ('law = "cutoff"\nrange = 1e-9', "range", "strength / normal_penalty"),
        ('law = "lennard_jones"\nenergy = 1e-6', "strength", "softer than the law at rest"),
    ],
)
def test_adhesion_that_ends_before_its_strength(
    law: str, key: str, words: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = SCENE.replace('law = "bilinear"\nstrength = 5.0\nenergy = 0.05', f"{law}\nstrength = 5.0")
    text = text.replace("[contact]", "[contact]\nnormal_penalty = 1e4")
    (folder / "wrong.toml").write_text(text, encoding="utf-8")
    refused(capsys, folder, f"contact.adhesion.{key}", words)


def test_a_refused_scene_leaves_the_results_of_an_older_run(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also where the mistake shows only once the mesh is there."""
    older = folder / "results" / "wrong"
    older.mkdir(parents=True)
    for name in (MARK, "history.csv", "summary.json", "scene.toml"):
        (older / name).write_text("older", encoding="utf-8")
    (folder / "wrong.toml").write_text(INSIDE, encoding="utf-8")
    refused(capsys, folder, "contact.pairs[0]")
    left = {path.name: path.read_text(encoding="utf-8") for path in older.iterdir() if path.name != MARK}
    assert left == dict.fromkeys(("history.csv", "summary.json", "scene.toml"), "older")


@pytest.mark.parametrize("name", ["unknown key", "unknown group"])
def test_the_command_itself(name: str, folder: Path) -> None:
    wrong = WRONG[name]
    (folder / "wrong.toml").write_text(SCENE.replace(wrong.old, wrong.new, 1), encoding="utf-8")
    before, start = contents(folder), processor_time()
    done = subprocess.run(
        [sys.executable, "-m", "app", "run", "wrong.toml"],
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert processor_time() - start < LIMIT
    assert done.returncode == 2 and done.stdout == "" and done.stderr.count("\n") == 1
    assert done.stderr.startswith(f"wrong.toml: {wrong.key}: found ") and wrong.words in done.stderr
    assert contents(folder) == before
