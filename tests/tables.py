"""Tables in the READMEs that are printed from the code, each between `<!-- NAME -->` and `<!-- end -->`.

.venv/bin/python -m tests.tables        writes them anew, after a change of keys, shapes, columns or units
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from piezomat.results.quantities import columns_table
from piezomat.scene.tables import keys_table, shapes_table, units_table

ROOT = Path(__file__).parents[1]
TABLES: dict[str, dict[str, Callable[[], str]]] = {
    "app/scenes/README.md": {"keys": keys_table, "shapes": shapes_table, "units": units_table},
    "app/results/README.md": {"columns": columns_table},
}


def with_tables(readme: str) -> str:
    """The text of a README with its tables as the code prints them. ValueError: not one pair of marks for a table."""
    text = (ROOT / readme).read_text(encoding="utf-8")
    for name, table in TABLES[readme].items():
        marks = re.compile(rf"(^<!-- {name} -->\n).*?(^<!-- end -->$)", re.M | re.S)
        if len(marks.findall(text)) != 1:
            raise ValueError(f"{readme} needs one pair of marks <!-- {name} --> and <!-- end -->")
        content = table()
        text = marks.sub(lambda found, content=content: f"{found[1]}{content}\n{found[2]}", text)
    return text


if __name__ == "__main__":
    for readme in TABLES:
        (ROOT / readme).write_text(with_tables(readme), encoding="utf-8")
