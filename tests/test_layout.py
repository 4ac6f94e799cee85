"""The house: which package may import which, no circles, one file that knows DOLFINx's versions.

All of it is read from the sources: every import counts, also those inside functions and under TYPE_CHECKING.
"""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator
from fnmatch import fnmatch
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = {"piezomat.forms": "forms", "piezomat.meshes": "meshes", "piezomat": "app"}
# From below: packages, and modules directly in `app`. Each may import only those before it.
ORDER = (
    *(
        "environment",
        "piezomat",
        "forms",
        "meshes",
        "usage",
        "scene",
        "discretization",
        "contact",
        "assembly",
        "solver",
    ),
    *(
        "results",
        "pictures",
        "report",
        "plan_text",
        "progress",
        "interrupts",
        "simulation",
        "api",
        "converge",
        "cli_paths",
        "cli",
        "__main__",
    ),
)


@cache
def modules() -> dict[str, Path]:
    """The file of each module and package by its name."""
    found = {}
    for package, folder in FOLDERS.items():
        for file in (ROOT / folder).rglob("*.py"):
            parts = file.relative_to(ROOT / folder).with_suffix("").parts
            found[".".join([package, *(part for part in parts if part != "__init__")])] = file
    return found


@cache
def imports(name: str) -> tuple[str, ...]:
    """The modules of piezomat that a module names in an import anywhere in it."""
    found = []
    for target in _targets(ast.parse(modules()[name].read_text(encoding="utf-8"))):
        while target not in modules() and "." in target:  # a name that the module defines
            target = target.rpartition(".")[0]
        if target in modules():
            found.append(target)
    return tuple(dict.fromkeys(found))


def _targets(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "a relative import"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def owner(name: str) -> str:
    """The entry of ORDER that a module belongs to."""
    parts = name.split(".")
    return parts[1] if len(parts) > 1 else parts[0]


def test_every_package_has_its_place() -> None:
    assert {owner(name) for name in modules()} == set(ORDER)
    assert "piezomat.contact.interfaces" in modules() and "piezomat.forms.contact.gap" in modules()
    assert "piezomat.scene.data" in imports("piezomat.scene.scene")
    assert "piezomat.simulation" in imports("piezomat.cli")  # inside a function


@pytest.mark.parametrize("package", ORDER)
def test_a_package_imports_only_those_before_it(package: str) -> None:
    allowed = ORDER[: ORDER.index(package) + 1]
    wrong = [
        f"{name} imports {target}"
        for name in sorted(modules())
        if owner(name) == package
        for target in imports(name)
        if owner(target) not in allowed
    ]
    assert wrong == []


def test_no_circle() -> None:
    try:
        TopologicalSorter({name: imports(name) for name in modules()}).prepare()
    except CycleError as error:
        pytest.fail("imports in a circle: " + ", imported by ".join(error.args[1]))


def test_one_file_asks_for_a_version_of_dolfinx() -> None:
    """What fenicsx.py finds out of the version stays in it, but for the number that a run writes down."""
    home = modules()["piezomat.forms.fenicsx"]
    tree = ast.parse(home.read_text(encoding="utf-8"))
    answers = {"RELEASE", "NEW", "NEWEST"}
    assert answers <= {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    asked = []
    for name, file in modules().items():
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))) if file != home else ():
            if isinstance(node, ast.Attribute):
                word, of = node.attr, ast.unparse(node.value)
            elif isinstance(node, ast.ImportFrom):
                word, of = next((a.name for a in node.names if a.name in (*answers, "VERSION")), ""), node.module or ""
            else:
                continue
            about_fenicsx = of.endswith("fenicsx") and word in (*answers, "VERSION")
            if about_fenicsx or (of in ("dolfinx", "ufl", "basix", "ffcx") and word == "__version__"):
                asked.append(f"{name}: {of}.{word}")
    assert asked == ["piezomat.results.summary: fenicsx.VERSION"]


# Objects of libraries whose attributes have names that classes of piezomat have too.
OTHERS = {
    "piezomat.pictures.render": {"camera", "edges"},
    "piezomat.cli": {"options"},
    "piezomat.discretization.loads": {"constant"},
}


@cache
def attributes() -> dict[str, set[str]]:
    """The modules with a class that has an attribute of this name, from its body or from its own methods."""
    found: dict[str, set[str]] = {}
    for name, file in modules().items():
        for kind in (n for n in ast.walk(ast.parse(file.read_text(encoding="utf-8"))) if isinstance(n, ast.ClassDef)):
            own = [n.target.id for n in kind.body if isinstance(n, ast.AnnAssign) and isinstance(n.target, ast.Name)]
            own += [of.attr for of in _written(kind) if ast.unparse(of.value) == "self"]
            for attribute in own:
                found.setdefault(attribute, set()).add(name)
    return found


def _written(tree: ast.AST) -> Iterator[ast.Attribute]:
    """The attributes that are assigned or deleted anywhere in a tree."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, (ast.Store, ast.Del)):
            yield node


def _set_from_outside(name: str, tree: ast.AST) -> list[str]:
    """What a module assigns to attributes of objects whose class is in another one."""
    own = {"self", "cls", *OTHERS.get(name, ()), *(n.name for n in ast.walk(tree) if isinstance(n, ast.ClassDef))}
    found = []
    for of in _written(tree):
        owner, classes = ast.unparse(of.value), attributes().get(of.attr, set())
        if owner not in own and classes and name not in classes:
            found.append(f"{name}:{of.lineno}: {owner}.{of.attr}")
    return found


def test_classes_own_their_attributes() -> None:
    """No module assigns to an attribute of an object whose class is in another one."""
    outside = ast.parse("problem.converged_state = x\nself.search.radius, other.z = 1, 2\ndel problem.factors")
    found = {text.rpartition(" ")[2] for text in _set_from_outside("piezomat.simulation", outside)}
    assert found == {"problem.converged_state", "self.search.radius", "problem.factors"}
    wrong = [
        text
        for name, file in modules().items()
        for text in _set_from_outside(name, ast.parse(file.read_text(encoding="utf-8")))
    ]
    assert wrong == []


def test_the_bare_names_are_banned() -> None:
    """From the root `app`, `forms` and `meshes` would import a second time, as copies of what `piezomat` holds."""
    lint = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["ruff"]["lint"]
    assert "TID251" in lint["select"] and "per-file-ignores" not in lint
    assert set(FOLDERS.values()) <= set(lint["flake8-tidy-imports"]["banned-api"])
    for folder in (*FOLDERS.values(), "scripts", "tests"):
        for file in (ROOT / folder).rglob("*.py"):
            names = {target.split(".")[0] for target in _targets(ast.parse(file.read_text(encoding="utf-8")))}
            assert not names & set(FOLDERS.values()), file


def test_every_package_is_installed() -> None:
    """`packages` lists each folder that has an `__init__`, and each folder with a module has one."""
    tool = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    packages = sorted(name for name, file in modules().items() if file.name == "__init__.py")
    assert sorted(tool["packages"]) == packages
    assert tool["package-dir"] == FOLDERS
    for file in modules().values():
        assert (file.parent / "__init__.py").is_file(), file


def test_the_top_level_holds_nothing_else() -> None:
    ignored = (ROOT / ".gitignore").read_text(encoding="utf-8").split()
    there = {path.name for path in ROOT.iterdir() if not path.name.startswith(".")}
    there = {name for name in there if not any(fnmatch(name, pattern.strip("/")) for pattern in ignored)}
    assert there == {"LICENSE", "README.md", "pyproject.toml", *FOLDERS.values(), "scripts", "tests"}


@pytest.mark.parametrize("folder", [*FOLDERS.values(), "scripts", "tests"])
def test_modules_are_short(folder: str) -> None:
    long = {}
    for file in (ROOT / folder).rglob("*.py"):
        lines = len(file.read_text(encoding="utf-8").splitlines())
        if lines > (400 if folder != "tests" else 500):
            long[str(file.relative_to(ROOT))] = lines
    assert long == {}
