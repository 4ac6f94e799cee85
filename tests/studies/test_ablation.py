"""The ablation study: each tuned constant of the solver has a row, each switch does something, the table is right."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path

import pytest

from scripts.studies.ablation import COLUMNS, table
from scripts.studies.ablation_cases import CASES, SCALED, Switch, switches

ROOT = Path(__file__).parents[2]
PACKAGES = ("contact", "assembly", "solver")
# Constants that tune nothing: the answer and the effort are the same with any reasonable value.
NOT_TUNED = {
    "bounds that end what would go on for ever": (
        "MAX_ITERATIONS MAX_PARTS MAX_PREDICTIONS MAX_POOR_STEPS MAX_REFINEMENTS MAX_REPAIRS "
        "MAX_RENEWALS_IN_ALL MAX_SEGMENT_REPAIRS AUGMENTATIONS MAX_HALVINGS LONGEST_SEARCH SHORTEST_STEP "
        "LARGEST_CHANGE LEVELS WAIT FLOWN SMALLEST_REDUCTION LARGEST_REDUCTION MAX_RELEASES POWER_ITERATIONS"
    ),
    "rounding": "ROUNDING BALANCED EQUAL DEPENDENT FAR_GAP TINY COVERED PARALLEL",
    "accuracy of what is reported, not of the solution": "TOLERANCE ACCURACY CLOSE_TOLERANCE SNAPPED",
    "limits of memory and of what is listed": "CHUNK LISTED_BODIES",
    "a number that stands for a word": "OUT_OF_MEMORY",
    "words of a warning or of a reason": "FAR WANDERING DEEP DEEPER PULLED_IN CLOSE LEAST LEAST_SHARE FLAT SLIVER",
    "which solver: measured where they stand": (
        "DIRECT_LIMIT_3D LOOSE_LIMIT_3D CONDENSED_SHARE CONDENSED_ALWAYS CANDIDATE_LIMIT CONDENSED_LIMIT"
    ),
}


def constants() -> set[tuple[str, str]]:
    """Module, below `piezomat`, and name of each constant that is a number or a tuple of numbers."""
    found = set()
    for package in PACKAGES:
        for file in (ROOT / "app" / package).glob("*.py"):
            module = f"{package}.{file.stem}"
            for node in ast.parse(file.read_text(encoding="utf-8")).body:
                is_named = isinstance(node, ast.Assign) and "range(" not in ast.unparse(
                    node.value
                )  # not A, B = range(2)
                targets = node.targets if is_named else []
                for target in targets:
                    for name in target.elts if isinstance(target, ast.Tuple) else [target]:
                        value = getattr(importlib.import_module(f"piezomat.{module}"), name.id, None)
                        if name.id.isupper() and _is_number(value):
                            found.add((module, name.id))
    return found


def _is_number(value: object) -> bool:
    if isinstance(value, tuple):
        return bool(value) and all(_is_number(v) for v in value)
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def test_each_tuned_constant_has_a_row() -> None:
    tuned = {(switch.module, name) for switch in switches() for name in switch.values}
    others = {name for names in NOT_TUNED.values() for name in names.split()}
    assert {name for name in constants() if name[1] not in others} - tuned == set()
    assert others <= {name for _, name in constants()}  # nothing that is gone


@pytest.mark.parametrize("switch", switches()[1:], ids=lambda switch: switch.name)
def test_each_switch_changes_a_constant_for_a_while(switch: Switch) -> None:
    module = importlib.import_module(f"piezomat.{switch.module}")
    before = {name: getattr(module, name) for name in switch.values}
    with switch.applied():
        assert {name: getattr(module, name) for name in switch.values} == switch.values
    assert {name: getattr(module, name) for name in switch.values} == before
    assert all(before[name] != value for name, value in switch.values.items())


def test_a_switch_reaches_the_modules_that_import_a_constant() -> None:
    switch = next(s for s in switches() if "AHEAD" in s.values)
    importers = [importlib.import_module(f"piezomat.contact.{name}") for name in ("gap_exchange", "detection")]
    with switch.applied():
        assert {module.AHEAD for module in importers} == set(switch.values.values())


def test_names_are_unique_and_cases_are_scenes() -> None:
    names = [switch.name for switch in switches()]
    assert len(set(names)) == len(names)
    assert all(case().load.steps for case in CASES.values())
    assert {module for module, *_ in SCALED} <= {module for module, _ in constants()}


def test_table() -> None:
    def row(switch: str, case: str, **values: object) -> dict[str, str]:
        given = {"switch": switch, "case": case, "outcome": "done", "cutbacks": 0, "force": 5.0, **values}
        return {name: str(given.get(name, "")) for name in COLUMNS}

    lines = table(
        [
            row("as it is", "one", seconds=2.0, linear_solves=10, newton=4),
            row("as it is", "two", seconds=1.0, linear_solves=10, newton=4),
            row("no search", "one", seconds=3.0, linear_solves=15, newton=4, force=5.1),
            row("no search", "two", outcome="failed"),
        ]
    ).splitlines()
    assert lines[2] == "| as it is |  | 1.00 | 1.00 | 1.00 | 0 to 0 |  |  |  |"
    assert lines[3] == "| no search |  | 1.50 | 1.50 | 1.00 | 0 to 0 | two | one | one: 10 to 15 solves |"
