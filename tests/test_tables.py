"""Tables in the READMEs are those of the code, and what they are made from is complete."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from piezomat.results.quantities import GROUPS
from piezomat.scene import schema
from piezomat.scene.tables import UNITS, keys_table, shapes_table
from tests.tables import ROOT, TABLES, with_tables


@pytest.mark.parametrize("readme", TABLES)
def test_readmes_show_what_the_code_prints(readme: str) -> None:
    shown = (ROOT / readme).read_text(encoding="utf-8")
    assert shown == with_tables(readme), "write the tables anew: .venv/bin/python -m tests.tables"


def keys() -> Iterator[tuple[str, dict[str, Any]]]:
    """Every key of the schema with its node."""
    for table in (schema(), *schema()["$defs"].values()):
        yield from table.get("properties", {}).items()


def test_every_key_is_in_a_table() -> None:
    text = keys_table() + shapes_table()
    sections = [name for name in schema()["properties"] if f"`[{name}]`" in text or f"`[[{name}]]`" in text]
    assert {"mesh", "boundaries", "planes", "contact", "load"} <= set(sections)
    missing = {name for name, _ in keys() if f"`{name}`" not in text and name not in sections}
    assert missing == {"materials", "piezo", "adhesion"}  # tables themselves
    assert all(f"[{title}]" in text for title in ("materials.NAME", "materials.NAME.piezo", "contact.adhesion"))


def test_every_key_says_what_it_means() -> None:
    silent = {name for name, key in keys() if not key.get("description")}
    assert silent <= {"shape", "arrangement", *schema()["properties"], "adhesion"}  # choices, and tables that say it
    assert all(table.get("description") for table in schema()["$defs"].values())


def test_units_of_the_columns_are_those_of_the_program() -> None:
    units = {unit for _, unit, _ in UNITS}
    assert {q.unit for group in GROUPS for q in group.quantities} <= units | {""}
    assert all(q.meaning and "\n" not in q.meaning for group in GROUPS for q in group.quantities)
