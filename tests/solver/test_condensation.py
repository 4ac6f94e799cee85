"""Condensed tangents: MUMPS's Schur complement, and the same changes as the factorized whole."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.simulation import run
from piezomat.solver import linear
from piezomat.solver.condensation import Condensation
from piezomat.solver.mumps_schur import SchurFactors
from piezomat.solver.newton import Newton
from piezomat.solver.outcome import NewtonReport, SolveError
from tests.histories import assert_equal
from tests.scenes import pressed

EFFORT = ("newton", "krylov")  # less where it is condensed: see `piezomat.contact.active_set`
WHOLE = {"petsc": {"mat_mumps_icntl_14": 60}}  # a word on the factorization asks for that of the whole


def test_schur_complements_and_solution() -> None:
    """Of symmetric indefinite matrices, against dense algebra; also where nothing is kept, or there is no matrix."""
    rng = np.random.default_rng(1)
    factors, solution, complements = SchurFactors(), [], []
    right = rng.normal(size=36)
    for number, kept in enumerate(([7, 2, 11], [], [4])):
        dense = rng.normal(size=(12, 12))
        dense = dense + dense.T + np.diag(np.repeat([20.0, -20.0], 6))
        rows = np.arange(0, 145, 12, dtype=np.int32), np.tile(np.arange(12, dtype=np.int32), 12)
        factors.add(PETSc.Mat().createAIJ((12, 12), csr=(*rows, dense.ravel())), np.array(kept, np.int32))
        rest = [i for i in range(12) if i not in kept]
        inner = np.linalg.solve(dense[np.ix_(rest, rest)], dense[np.ix_(rest, kept)])
        complements.append(dense[np.ix_(kept, kept)] - dense[np.ix_(kept, rest)] @ inner)
        solution.append(np.linalg.solve(dense, right[12 * number : 12 * number + 12]))
    expected = scipy.linalg.block_diag(complements[0], complements[2])
    assert factors.complement() == pytest.approx(expected, abs=1e-12)
    assert factors.reduced(right[:4]) == pytest.approx(expected @ right[:4], abs=1e-12)
    assert factors.solve(right) == pytest.approx(np.concatenate(solution), abs=1e-12)
    nothing = SchurFactors()
    assert nothing.complement().shape == (0, 0)
    assert len(nothing.solve(right[:0])) == len(nothing.reduced(right[:0])) == 0


@pytest.mark.mpi
@pytest.mark.parametrize("dimension", [2, 3])
def test_the_same_history_as_with_the_whole_tangent(dimension: int, comm: MPI.Comm) -> None:
    condensed = run(pressed(dimension), comm).history
    whole = run(pressed(dimension, solver={"tolerance": 1e-11, **WHOLE}), comm).history
    assert_equal(condensed, whole, EFFORT)


@pytest.mark.mpi
def test_candidates_grow_with_the_contact(comm: MPI.Comm, monkeypatch: pytest.MonkeyPatch) -> None:
    """A load gives no hint how far the contact will spread: it is condensed again as it does."""
    counts = []
    condense = Condensation._condense

    def counted(self: Condensation, candidates: np.ndarray) -> None:
        counts.append(len(candidates))
        condense(self, candidates)

    monkeypatch.setattr(Condensation, "_condense", counted)
    boundaries = [
        {"on": "bottom", "displacement": [0, 0], "potential": 0},
        {"on": "top", "displacement": [0, "free"], "traction": [0, -240.0], "follows": "press"},
    ]
    run(pressed(2, mesh={"size": 0.15, "contact_size": 0.02}, boundaries=boundaries), comm)
    assert len(set(counts)) > 1 and counts == sorted(counts)


@pytest.mark.mpi
def test_equal_steps_ask_once_what_the_inside_does(comm: MPI.Comm, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two solves with the factors for a step that is like the one before: one for its start value, one for its end."""
    solves, solve = [0], SchurFactors.solve

    def counted(self: SchurFactors, right: np.ndarray) -> np.ndarray:
        solves[0] += 1
        return solve(self, right)

    def taken(steps: int) -> int:
        solves[0] = 0
        load = {"steps": [steps], "factors": {"press": [steps / 4]}}
        history = run(pressed(2, load=load, solver={}), comm).history
        assert len(history) == steps and not any(row["cutbacks"] for row in history)
        return comm.allreduce(solves[0], op=MPI.MAX)  # a rank may have no body

    monkeypatch.setattr(SchurFactors, "solve", counted)
    assert taken(4) - taken(2) == 2 * 2


@pytest.mark.mpi
def test_a_solve_that_fails_on_the_way_leaves_nothing_behind(comm: MPI.Comm, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next one began with the inside of the one that had failed."""
    reference = run(pressed(2, load={"steps": [2], "factors": {"press": [1.0]}}), comm).history
    shorten, broken = Newton._shorten, []

    def breaks_once(self: Newton, x: PETSc.Vec, step: PETSc.Vec) -> None:
        if not broken:
            broken.append(self.linear.condensation.holds)
            raise SolveError("on purpose")
        shorten(self, x, step)

    residual, began = Newton._predict, []

    def predict(self: Newton, report: NewtonReport, *, closely: bool = False) -> None:
        began.append(self.problem.condensed is None)
        residual(self, report, closely=closely)

    monkeypatch.setattr(Newton, "_shorten", breaks_once)
    monkeypatch.setattr(Newton, "_predict", predict)
    history = run(pressed(2, load={"steps": [1], "factors": {"press": [1.0]}}), comm).history
    assert broken == [True] and all(began) and history[-1]["cutbacks"] == 1
    assert_equal(history[-1:], reference[-1:], (*EFFORT, "cutbacks", "step"))


@pytest.mark.mpi
def test_too_many_candidates_fall_back_on_the_whole(comm: MPI.Comm, monkeypatch: pytest.MonkeyPatch) -> None:
    reference = run(pressed(2), comm).history
    monkeypatch.setattr(linear, "CONDENSED_LIMIT", 20)
    assert_equal(run(pressed(2), comm).history, reference, EFFORT)
