"""Multigrid: the fields that its preconditioner is split into, and what is said where PETSc gives up."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.cli import FAILED, main
from piezomat.scene import Scene
from piezomat.simulation import run
from piezomat.solver import linear_solve, start_value
from piezomat.solver.multigrid import Multigrid
from piezomat.solver.outcome import LibraryError
from tests.scenes import press


def plates() -> Scene:
    """Two blocks on each other, with an open electrode on the upper one."""
    geometry = {"shape": "stacked_blocks", "height": [0.2, 0.2], "depth": 1.0, "divisions": [[7, 7, 1], [7, 7, 1]]}
    return press(
        geometry,
        mesh={"cells": "tensor"},
        bodies={"*": "pvdf"},
        boundaries=[
            {"on": "bottom", "displacement": [0, 0, 0], "potential": 0},
            {"on": "top", "displacement": [0, 0, -0.01]},
        ],
        electrodes=[{"name": "lid", "on": ["top"]}],
        contact={},
        solver={"kind": "iterative"},
    )


def test_displacements_have_no_row_as_long_as_an_electrode(monkeypatch: pytest.MonkeyPatch) -> None:
    """PETSc 3.18 takes 4,096 neighbours of a node at most: beside 6,300 nodes of an electrode a run ended with it."""
    longest = []

    def solve(*given: Any, **more: Any) -> None:
        linear_solve.solve(*given, **more)
        solver, snes = given[1:3]
        assert isinstance(solver, Multigrid)
        matrix = snes.getKSP().getPC().getFieldSplitSubKSP()[0].getOperators()[1]
        longest.append(np.diff(matrix.getValuesCSR()[0]).max() // 3)

    monkeypatch.setattr(start_value, "solve", solve)
    run(plates(), MPI.COMM_SELF, quiet=True)
    on_the_electrode = 64
    assert longest
    assert max(longest) < on_the_electrode


def test_where_petsc_gives_up_it_is_said_in_words(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Any
) -> None:
    def solve(*given: Any, **more: Any) -> None:
        raise PETSc.Error(83)

    monkeypatch.setattr(start_value, "solve", solve)
    with pytest.raises(LibraryError, match=r"PETSc gave up \(its error 83.*solver.kind"):
        run(plates(), MPI.COMM_SELF, quiet=True)
    assert main(["run", "blocks", "--out", str(tmp_path / "blocks")]) == FAILED
    said = capfd.readouterr().err.strip().splitlines()
    assert "PETSc gave up" in said[-1]
    assert not [line for line in said if "Traceback" in line]
