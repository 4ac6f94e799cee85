"""MUMPS's Schur complements against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from petsc4py import PETSc

from piezomat.solver.mumps_schur import SchurFactors


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
    for complement, expected in zip(factors.complements, complements, strict=True):
        assert complement == pytest.approx(expected, abs=1e-12)
    expected = scipy.linalg.block_diag(complements[0], complements[2])
    assert factors.reduced(right[:4]) == pytest.approx(expected @ right[:4], abs=1e-12)
    assert factors.solve(right) == pytest.approx(np.concatenate(solution), abs=1e-12)
    nothing = SchurFactors()
    assert nothing.complements == []
    assert len(nothing.solve(right[:0])) == len(nothing.reduced(right[:0])) == 0
