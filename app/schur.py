"""MUMPS's Schur complements, which petsc4py does not wrap: factors of a matrix and what is left of some unknowns."""

from __future__ import annotations

import ctypes

import numpy as np
import petsc4py.PETSc
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

Array = NDArray[np.float64]

_library = ctypes.CDLL(petsc4py.PETSc.__file__)  # PETSc itself is linked to it


class SchurFactor:
    """LDL^T of a symmetric matrix of this rank, with the Schur complement of some of its unknowns. Not collective."""

    def __init__(self, matrix: PETSc.Mat, kept: NDArray[np.int32]) -> None:
        """`matrix` is sequential; `kept` (n,) are the unknowns of the Schur complement, in its order."""
        matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._ksp = PETSc.KSP().create(MPI.COMM_SELF)
        self._ksp.setType(PETSc.KSP.Type.PREONLY)
        self._ksp.setOperators(matrix)
        pc = self._ksp.getPC()
        pc.setType(PETSc.PC.Type.CHOLESKY)
        pc.setFactorSolverType("mumps")
        pc.setFactorSetUpSolverType()
        factor = pc.getFactorMatrix()
        factor.setMumpsIcntl(14, 60)  # room for pivots
        if len(kept):
            unknowns = PETSc.IS().createGeneral(kept.astype(PETSc.IntType), comm=MPI.COMM_SELF)
            _call("MatFactorSetSchurIS", factor, unknowns)
        self._ksp.setUp()
        #: The Schur complement (n, n) of the kept unknowns.
        self.complement = _schur_complement(factor, len(kept)) if len(kept) else np.zeros((0, 0))
        self._right, self._result = matrix.createVecs()

    def destroy(self) -> None:
        """Give the factors' memory back. Ends its use."""
        self._ksp.destroy()

    def solve(self, right: Array) -> Array:
        """The solution with the whole matrix."""
        self._right.array[:] = right
        self._ksp.solve(self._right, self._result)
        return self._result.array.copy()


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
