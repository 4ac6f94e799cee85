"""The READMEs: links, pictures, file names and commands in them exist, and README.md is short."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

import piezomat
from piezomat import cli
from piezomat.scene import toml as scene_file

ROOT = Path(__file__).parents[1]
READMES = sorted(
    path.relative_to(ROOT).as_posix()
    for folder in (".", "app", "forms", "meshes", "scripts", "tests")
    for path in (ROOT.glob("README.md") if folder == "." else (ROOT / folder).rglob("README.md"))
)
LONGEST = 180  # lines of README.md
MADE_BY_THE_READER = {"study.py", "mat", "short"}
FOLDERS = ("app/", "forms/", "meshes/", "scripts/", "tests/")
SCENES = {*scene_file.examples(), "mine.toml", "SCENE"}

LINK = re.compile(r"\]\(([^)\s]+)\)|src=\"([^\"]+)\"")
CODE = re.compile(r"`([^`\n]+)`")
PATH = re.compile(r"[\w.-]+(/[\w.-]+)*/?")


@cache
def text(readme: str) -> str:
    return (ROOT / readme).read_text(encoding="utf-8")


@cache
def prose(readme: str) -> str:
    """The text without blocks of code."""
    return re.sub(r"^```.*?^```$", "", text(readme), flags=re.M | re.S)


def anchors(path: Path) -> set[str]:
    """Anchors of the headings of a Markdown file, as forges make them."""
    headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.M)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def commands(readme: str) -> list[str]:
    """Lines of code and code in a sentence that call a program of the project."""
    indented = re.findall(r"^    (\S.*)$", text(readme), re.M)
    return [line for line in [*indented, *CODE.findall(prose(readme))] if re.search(r"scripts[/.]|\bpiezomat\b", line)]


def is_there(name: str, readme: str) -> bool:
    """Whether a file name means a file: from the root, beside the README, or below it."""
    folder = (ROOT / readme).parent
    return any((where / name).exists() for where in (ROOT, folder)) or any(folder.rglob(name))


def modules() -> list[str]:
    """Every module of the program."""
    return [
        path.relative_to(ROOT).as_posix()
        for folder in ("app", "forms", "meshes")
        for path in sorted((ROOT / folder).rglob("*.py"))
        if not path.name.startswith("__")
    ]


def test_readmes_stand_where_people_look() -> None:
    wanted = {"README.md", *(f"{folder}README.md" for folder in FOLDERS)}
    wanted |= {f"{folder}/README.md" for folder in ("app/scenes", "app/results", "forms/contact", "scripts/studies")}
    assert wanted <= set(READMES)


def test_the_first_page_is_short() -> None:
    assert len(text("README.md").splitlines()) <= LONGEST


@pytest.mark.parametrize("readme", READMES)
def test_links_and_pictures(readme: str) -> None:
    for link in ("".join(found) for found in LINK.findall(prose(readme))):
        if re.match(r"[a-z]+:", link):
            continue
        target, _, anchor = link.partition("#")
        path = (ROOT / readme).parent / target if target else ROOT / readme
        assert path.exists(), link
        if anchor:
            page = path / "README.md" if path.is_dir() else path
            assert anchor in anchors(page), link


@pytest.mark.parametrize("readme", READMES)
def test_file_names(readme: str) -> None:
    for name in CODE.findall(prose(readme)):
        if not PATH.fullmatch(name) or name in MADE_BY_THE_READER:
            continue
        if name.endswith(".py") or name.startswith(FOLDERS):
            assert is_there(name, readme), name


@pytest.mark.parametrize("readme", READMES)
def test_commands(readme: str) -> None:
    for command in commands(readme):
        for script in re.findall(r"(?<![\w/.])scripts/[\w./-]*\w", command):
            assert (ROOT / script).is_file() or (ROOT / script / "README.md").is_file(), command
        for module in re.findall(r"-m (scripts[\w.]+)", command):
            assert (ROOT / f"{module.replace('.', '/')}.py").is_file(), command
        for test in re.findall(r"(?<![\w/.])tests/[\w./]+\.py", command):
            assert (ROOT / test).is_file(), command
        run = re.match(r"scripts/run(?: -n \w+)? (\w\S*)", command)
        assert run is None or run[1] in SCENES or (ROOT / run[1]).is_file(), command
        called = re.match(r"(?:\S*/)?piezomat (\w+)(?: (?!-)(\S+))?", command)
        if called:
            assert called[1] in cli._COMMANDS, command
            assert called[2] is None or called[2] in SCENES | {"DIR"} | MADE_BY_THE_READER, command


def test_the_commands_of_the_program() -> None:
    said = {found[1] for found in re.finditer(r"^\| `piezomat (\w+)", text("README.md"), re.M)}
    assert said == set(cli._COMMANDS)


def test_every_shipped_scene_is_on_the_first_page() -> None:
    called = set(re.findall(r"^    scripts/run (\w+)", text("README.md"), re.M))
    assert called == set(scene_file.examples()) - {"crossed_fibers"}  # the default


@pytest.mark.parametrize("module", modules())
def test_every_module_is_on_a_map(module: str) -> None:
    """The first column of a table in the README of its folder, or of the next one above, has it or its folder."""
    path = ROOT / module
    page = next(folder / "README.md" for folder in path.parents if (folder / "README.md").is_file())
    cells = re.findall(r"^\| (`[^|]*) \|", page.read_text(encoding="utf-8"), re.M)
    said = {name for cell in cells for name in CODE.findall(cell)}
    here = path.relative_to(page.parent)
    wanted = {here.as_posix(), *(f"{folder.as_posix()}/" for folder in here.parents)}
    assert said & wanted, f"{module} is not in {page.relative_to(ROOT)}"


def test_no_whole_scene_of_a_readme_is_out_of_date(tmp_path: Path) -> None:
    from piezomat.scene import Scene

    (whole,) = re.findall(r"^```toml\n(.*?)^```$", text("README.md"), re.M | re.S)
    file = tmp_path / "mine.toml"
    file.write_text(whole, encoding="utf-8")
    assert Scene.load(file).title == "A fiber pressed on a block"


@pytest.mark.parametrize("readme", READMES)
def test_python_in_readmes_uses_public_names(readme: str) -> None:
    for block in re.findall(r"^```python\n(.*?)^```$", text(readme), re.M | re.S):
        compile(block, readme, "exec")
        for name in re.findall(r"(?<!^from )\b(?:piezomat|pz)\.(\w+)", block, re.M):
            assert name in piezomat.__all__, name
