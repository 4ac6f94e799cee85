"""Factors and Schur complements by MUMPS, for which petsc4py has no methods: they are called in PETSc's C library."""

from __future__ import annotations

import ctypes

import numpy as np
import petsc4py.PETSc
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from piezomat.forms.arrays import Array

_library = ctypes.CDLL(petsc4py.PETSc.__file__)  # PETSc itself is linked to it


class SchurFactors:
    """LDL^T of symmetric matrices of this rank, with the Schur complements of some of their unknowns. Not collective.

    The matrices are the blocks of one: vectors are those of the blocks, one after the other.

    complements: the Schur complement of each block
    """

    def __init__(self) -> None:
        self._factors: list[PETSc.Mat] = []
        self._vectors: list[tuple[PETSc.Vec, PETSc.Vec]] = []
        self.complements: list[Array] = []

    def add(self, matrix: PETSc.Mat, kept: NDArray[np.int32]) -> None:
        """Factorize one more matrix, and destroy it; `kept` (n,), sorted: unknowns of its Schur complement."""
        # The Schur complement of all unknowns is the matrix itself. MUMPS would return zeros, and solve with them.
        whole = len(kept) == matrix.getSize()[0]
        complement = _dense(matrix) if whole else np.zeros((0, 0))
        condense = 0 < len(kept) and not whole
        matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        matrix.convert(PETSc.Mat.Type.SBAIJ)  # the upper half, whose values MUMPS uses without a copy
        pc = PETSc.PC().create(MPI.COMM_SELF)
        pc.setOperators(matrix)
        pc.setType(PETSc.PC.Type.CHOLESKY)
        pc.setFactorSolverType("mumps")
        pc.setFactorSetUpSolverType()
        factor = pc.getFactorMatrix()
        factor.setMumpsIcntl(14, 60)  # room for pivots
        if condense:
            unknowns = PETSc.IS().createGeneral(kept.astype(PETSc.IntType), comm=MPI.COMM_SELF)
            _call("MatFactorSetSchurIS", factor, unknowns)
        pc.setUp()
        self._factors.append(factor)
        self._vectors.append(matrix.createVecs())
        self.complements.append(_schur_complement(factor, len(kept)) if condense else complement)
        # The factors do not need these, which would live until garbage is collected.
        pc.destroy()
        matrix.destroy()

    def destroy(self) -> None:
        """Free the factors. Ends its use."""
        for factor in self._factors:
            factor.destroy()
        for vectors in self._vectors:
            for vector in vectors:
                vector.destroy()
        self._factors, self._vectors, self.complements = [], [], []

    def reduced(self, kept: Array) -> Array:
        """The Schur complement times a vector (n,)."""
        result, first = np.zeros_like(kept), 0
        for complement in self.complements:
            part = slice(first, first := first + len(complement))
            result[part] = complement @ kept[part]
        return result

    def solve(self, right: Array) -> Array:
        """The solution with the whole matrices."""
        result, first = np.zeros_like(right), 0
        for factor, (b, x) in zip(self._factors, self._vectors, strict=True):
            part = slice(first, first := first + b.getSize())
            b.array[:] = right[part]
            factor.solve(b, x)
            result[part] = x.array_r
        return result


def _dense(matrix: PETSc.Mat) -> Array:
    dense = matrix.convert(PETSc.Mat.Type.DENSE, PETSc.Mat())
    values = dense.getDenseArray().copy()
    dense.destroy()
    return values


def _schur_complement(factor: PETSc.Mat, size: int) -> Array:
    matrix, status = ctypes.c_void_p(), ctypes.c_int()
    _call("MatFactorCreateSchurComplement", factor, ctypes.byref(matrix), ctypes.byref(status))
    values = ctypes.POINTER(ctypes.c_double)()
    _call("MatDenseGetArray", matrix, ctypes.byref(values))
    result = np.ctypeslib.as_array(values, (size, size)).copy()
    _call("MatDenseRestoreArray", matrix, ctypes.byref(values))
    _call("MatDestroy", ctypes.byref(matrix))
    return result


def _call(name: str, *arguments: object) -> None:
    handles = [ctypes.c_void_p(a.handle) if isinstance(a, PETSc.Object) else a for a in arguments]
    status = getattr(_library, name)(*handles)
    if status:
        raise PETSc.Error(status)
