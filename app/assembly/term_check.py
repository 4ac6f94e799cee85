"""Check of terms from a user's script: the matrix of each has what its residual asks for."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from petsc4py import PETSc

from piezomat.discretization.model import Model
from piezomat.discretization.term import AssembledTerm

TOLERANCE = 1e-8  # of the residual


def check_terms(model: Model, terms: Sequence[AssembledTerm], new_matrix: Callable[[], PETSc.Mat]) -> None:
    """Raise ValueError where a constant tangent times a state is not the residual. Collective.

    Entries without a place, between nodes that share no cell, are lost: DOLFINx does not say so.
    """
    for term in terms:
        matrix, x, residual = new_matrix(), model.new_vector(), model.new_vector()
        matrix.zeroEntries()
        try:
            term.add_tangent(matrix)
        except PETSc.Error as error:
            raise ValueError(_words(term)) from error
        if not term.is_constant:
            continue
        x.array[:] = np.random.default_rng(model.comm.rank).uniform(-1.0, 1.0, len(x.array_r))
        model.set_trial_state(x)
        term.add_residual(x, residual)
        largest, missed = residual.norm(), matrix * x
        term.add_constant_residual(missed)
        missed.axpy(-1.0, residual)
        if missed.norm() > TOLERANCE * largest:
            raise ValueError(_words(term))
    if terms:
        model.set_trial_state(model.new_vector())


def _words(term: AssembledTerm) -> str:
    return (
        f"{type(term).__name__}: its tangent is not that of its residual, or couples nodes that share no cell, such as "
        "those of two bodies, which a BlockTerm can"
    )
