"""The report of a run as text, HTML and JSON."""

from __future__ import annotations

import base64
import csv
import html
import json
from pathlib import Path
from typing import Any

from piezomat.pictures.data import RunData
from piezomat.pictures.picture import view
from piezomat.report.numbers import Number, Numbers, Section, model_lines
from piezomat.results.atomic import write_text
from piezomat.results.files import read_history
from piezomat.results.run_scene import of_run
from piezomat.results.units import symbols
from piezomat.results.vtk import ResultsError

_STYLE = """body{font:15px/1.4 sans-serif;max-width:62em;margin:2em auto;padding:0 1em}
table{border-collapse:collapse}td{padding:.1em .8em .1em 0;vertical-align:top}td.v{text-align:right;white-space:nowrap}
td.h{color:#666}h1{font-size:1.4em}h2{font-size:1.05em;margin:1.2em 0 .3em}img{max-width:100%}.w{color:#a33b00}
@media print{body{font-size:11px;margin:0}}"""


def report(directory: Path) -> str:
    """Write DIR/report.txt, report.html and report.json; the text. Not collective. ResultsError: there are no results.

    The picture in the page is the run's, or is drawn if there is none.
    """
    directory = Path(directory)
    history = read_history(directory / "history.csv")
    if not history:
        raise ResultsError(f"{directory} holds no step of a run yet: there is nothing to report")
    summary = _summary(directory)
    scene = of_run(directory)
    tables = scene.model_dump(mode="json", exclude_none=True)
    names = (summary.get("bodies", []), [plane.name for plane in scene.planes])
    run = RunData(scene.title, history, None, None, None, names, tables)
    sections = Numbers(run, summary, scene, _largest_of_pairs(directory)).sections()
    lines, state = model_lines(scene), _state(summary)
    warnings = list(summary.get("warnings") or [])
    text = _text(scene.title, state, lines, sections, warnings)
    write_text(directory / "report.txt", text)
    write_text(directory / "report.html", _html(scene.title, state, lines, sections, warnings, _picture(directory)))
    write_text(directory / "report.json", _json(scene.title, summary, lines, sections, warnings))
    return text


def _summary(directory: Path) -> dict[str, Any]:
    """The summary; empty of a run that has not ended. ResultsError: it is damaged."""
    path = directory / "summary.json"
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise ResultsError(f"cannot read {path}: {error}") from error


def _largest_of_pairs(directory: Path) -> dict[str, float]:
    """The largest value of each column of pairs.csv; none where there is no such file."""
    path = directory / "pairs.csv"
    if not path.is_file():
        return {}
    largest: dict[str, float] = {}
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            for name, value in row.items():
                if name in ("max_pressure", "max_penetration", "max_potential_jump", "max_field"):
                    largest[name] = max(largest.get(name, 0.0), float(value))
    return largest


def _state(summary: dict[str, Any]) -> str:
    if not summary:
        return "the run has not ended"
    return "all load steps converged" if summary["converged"] else f"NOT converged: {summary['reason']}"


def shown_value(number: Number) -> str:
    """The value with four digits."""
    value = number.value
    if isinstance(value, str):
        return value
    return f"{value:,}" if isinstance(value, int) else f"{float(value) + 0.0:.4g}"


def _text(title: str, state: str, lines: list[str], sections: list[Section], warnings: list[str]) -> str:
    width = max(len(n.name) for section in sections for n in section.numbers)
    out = [title, "=" * len(title), "", state, *lines]
    for section in sections:
        out += ["", section.title, "-" * len(section.title)]
        for n in section.numbers:
            value = f"{shown_value(n)} {n.unit}".strip()
            out.append(f"{n.name:<{width}}  {value:<22}{n.how}".rstrip())
    out += ["", "Warnings", "--------", *([f"- {text}" for text in warnings] or ["none"])]
    return "\n".join(out) + "\n"


def _html(
    title: str, state: str, lines: list[str], sections: list[Section], warnings: list[str], picture: Path | None
) -> str:
    def escaped(text: str) -> str:
        return html.escape(text)

    rows = []
    for section in sections:
        rows.append(f"<h2>{escaped(section.title)}</h2><table>")
        for n in section.numbers:
            value = f"{escaped(shown_value(n))} {escaped(symbols(n.unit))}"
            rows.append(f'<tr><td>{escaped(n.name)}<td class="v">{value}<td class="h">{escaped(n.how)}')
        rows.append("</table>")
    said = "".join(f'<li class="w">{escaped(text)}' for text in warnings) or "<li>none"
    image = ""
    if picture is not None:
        data = base64.b64encode(picture.read_bytes()).decode()
        image = f'<img alt="picture of the run" src="data:image/png;base64,{data}">'
    facts = "".join(f"<br>{escaped(line)}" for line in lines)
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{escaped(title)}</title><style>{_STYLE}</style>\n"
        f"<h1>{escaped(title)}</h1><p>{escaped(state)}{facts}</p>\n" + "\n".join(rows) +
        f"\n<h2>Warnings</h2><ul>{said}</ul>\n{image}\n</html>\n"
    )  # fmt: skip


def _json(title: str, summary: dict[str, Any], lines: list[str], sections: list[Section], warnings: list[str]) -> str:
    numbers = {
        n.key: {"value": n.value if isinstance(n.value, int | str) else float(n.value), "unit": n.unit, "name": n.name}
        for section in sections
        for n in section.numbers
    }
    content = {"title": title, "converged": summary.get("converged"), "model": lines, "numbers": numbers}
    return json.dumps(content | {"warnings": warnings}, indent=2, ensure_ascii=False) + "\n"


def _picture(directory: Path) -> Path | None:
    """The picture of the run, drawn if there is none; None where nothing can be drawn."""
    path = directory / "picture.png"
    if not path.is_file():
        try:
            view(directory)
        except ResultsError:
            return None
    return path
