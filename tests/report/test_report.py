"""The report: its numbers against closed forms, zeros that are rounding, its three files, runs that have not ended."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from mpi4py import MPI

import piezomat as pz
from piezomat import cli
from piezomat.report.page import report
from tests.verification import references

QUIET = {"fields": "none", "picture": False}


def film(out: Path, circuit: str, force: float = -2.0) -> dict[str, Any]:
    """Numbers of a film of PVDF, 2 x 1 um wide and 0.5 um high, pressed along its poling in two steps."""
    top: dict[str, Any] = {"on": "top", "traction": [0, 0, force], "follows": "press"}
    rows = [{"on": "bottom", "potential": 0}, top | ({"potential": 0} if circuit == "short" else {})]
    rows += [{"on": "root", "displacement": [0, "free", "free"]}, {"on": "bottom", "displacement": ["free", "free", 0]}]
    scene = pz.Scene(
        title='A film <of> PVDF & "more"',
        geometry={"shape": "cantilever", "length": 2.0, "width": 1.0, "layers": [0.5], "divisions": [2, 1, 1]},
        mesh={"cells": "tensor"},
        materials={"film": {"like": "pvdf", "yield": 50.0}},
        bodies={"layer_1": "film"},
        boundaries=rows,
        load={"steps": [2], "factors": {"press": [1.0]}},
        output=QUIET,
        electrodes=[{"name": "plate", "on": ["top"]}] if circuit == "open" else [],
    )
    pz.run(scene, comm=MPI.COMM_SELF, out=out, quiet=True)
    report(out)
    return json.loads((out / "report.json").read_text(encoding="utf-8"))


def test_short_and_open_circuit_against_closed_forms(tmp_path: Path) -> None:
    """d33 = D3/T3 with no field, the sensitivity E h / T3 with no charge, of the uniform state."""
    stress = -2.0
    short = references.uniform_state(references.PVDF, "free", "short", stress)
    numbers = film(tmp_path / "short", "short")["numbers"]
    assert numbers["force"]["value"] == pytest.approx(stress * 2.0, rel=1e-9) and numbers["force"]["unit"] == "uN"
    d33 = abs(short.displacement[2] / stress) * 1e6
    assert numbers["d33"]["value"] == pytest.approx(d33, rel=1e-6) and numbers["d33"]["unit"] == "pC/N"
    assert numbers["travel"]["value"] == pytest.approx(short.strain[2] * 0.5, rel=1e-6)
    open_circuit = references.uniform_state(references.PVDF, "free", "open", stress)
    numbers = film(tmp_path / "open", "open")["numbers"]
    voltage = -open_circuit.field[2] * 0.5
    assert numbers["voltage@plate"]["value"] == pytest.approx(voltage, rel=1e-6)
    assert "d33" not in numbers and numbers["imbalance"]["value"] < 1e-8
    # An open electrode has no charge: what is there is rounding, and is not shown.
    assert "charge@plate" not in numbers


def test_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    film(tmp_path / "out", "short")
    assert cli.main(["report", str(tmp_path / "out")]) == 0
    text = capsys.readouterr().out
    assert text.strip() == (tmp_path / "out" / "report.txt").read_text(encoding="utf-8").strip()
    lines = text.splitlines()
    assert lines[0] == 'A film <of> PVDF & "more"' and "all load steps converged" in lines
    assert any(line.startswith("effective d33") and "pC/N" in line for line in lines) and lines[-1] == "none"
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "A film &lt;of&gt; PVDF &amp;" in page and "<of>" not in page and "µN" in page
    assert "data:image/png;base64," in page  # the curves alone, drawn for the page


def test_a_mat_has_strain_modulus_and_recipe(tmp_path: Path) -> None:
    over = {"geometry.columns": 2, "geometry.rows": 2, "mesh.size": 0.3, "mesh.contact_size": 0.15, "load.steps": [2]}
    r = pz.run("fiber_array", over | {"output": QUIET}, comm=MPI.COMM_SELF, out=tmp_path / "out", quiet=True)
    text = report(tmp_path / "out")
    numbers = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))["numbers"]
    first, last = r.history
    assert numbers["modulus"]["value"] == pytest.approx(last["stress"] / last["strain"])
    tangent = (last["stress"] - first["stress"]) / (last["strain"] - first["strain"])
    assert numbers["tangent_modulus"]["value"] == pytest.approx(tangent)
    kilopascal = -1e3 * last["stress"]
    assert numbers["sensitivity@lid"]["value"] == pytest.approx(last["voltage@lid"] / kilopascal)
    assert numbers["porosity"]["value"] == r.summary["recipe"]["porosity"]
    assert numbers["max_pressure"]["value"] == max(
        row[name] for row in r.history for name in row if name.startswith("max_pressure")
    )
    assert "Recipe" in text and "secant modulus" in text


def test_a_run_that_has_not_ended(tmp_path: Path) -> None:
    film(tmp_path / "out", "short")
    (tmp_path / "out" / "summary.json").unlink()
    assert "the run has not ended" in report(tmp_path / "out")


def test_a_new_run_removes_the_report_of_the_old_one(tmp_path: Path) -> None:
    film(tmp_path / "out", "short")
    pz.run(
        "stack",
        {"output": QUIET, "load": {"steps": [1], "factors": {"press": [1], "voltage": [1]}}},
        out=tmp_path / "out",
        quiet=True,
    )
    assert not list((tmp_path / "out").glob("report.*"))


def test_a_file_of_the_user_stays(tmp_path: Path) -> None:
    (tmp_path / "history.csv").write_text("step\n1\n", encoding="utf-8")
    (tmp_path / "report.txt").write_text("mine", encoding="utf-8")
    assert cli.main(["report", str(tmp_path)]) == 2
    assert (tmp_path / "report.txt").read_text(encoding="utf-8") == "mine"
