"""The tangent matrix: a bulk part with a fixed pattern plus contact blocks whose places change.

The bulk of a small-strain scene is constant, so only the rows that contact touches are written anew. The pattern
grows when contact needs new places, and the matrix is then built anew.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


class TangentMatrix:
    """Bulk + contact in one AIJ matrix, the fixed unknowns eliminated symmetrically. Every method is collective."""

    def __init__(self, comm: MPI.Comm, bulk: PETSc.Mat, block: int, fixed: NDArray[np.int32]) -> None:
        """`bulk` has full blocks of `block` unknowns a node; `fixed` are this rank's fixed rows (global numbers)."""
        self.comm = comm
        self.block = block
        self.fixed = fixed
        self.rebuilds = 0
        self._sizes = bulk.getSizes()
        start, stop = bulk.getOwnershipRange()
        self._first, self._nodes = start // block, (stop - start) // block
        self._owners = np.array(comm.allgather(self._first), np.int64)
        self._total = bulk.getSize()[0] // block
        pointer, columns, _ = bulk.getValuesCSR()
        rows = np.repeat(np.arange(self._nodes), np.diff(pointer[::block]) // block**2)
        first_rows = _ranges(pointer[:-1:block], np.diff(pointer)[::block])
        self._bulk_keys = rows * self._total + columns[first_rows[::block]].astype(np.int64) // block
        self.forget_pattern()
        self._find_rows()
        # Of the bulk's values: row by row there, block by block here.
        self._bulk_order = self._places(self._bulk_keys).astype(PETSc.IntType)
        self.matrix: PETSc.Mat | None = None
        self.set_bulk(bulk)

    def set_bulk(self, bulk: PETSc.Mat) -> None:
        """Take over the bulk's values."""
        self._bulk_blocks = bulk.getValuesCSR()[2][self._bulk_order]
        self._bulk_is_new = True

    def forget_pattern(self) -> None:
        """Drop the places of past contacts: the next `assemble` starts from the bulk's pattern."""
        self._keys = self._bulk_keys
        self._pattern_is_new = True

    def assemble(self, nodes: Integers, matrices: Array, reserve: Integers) -> tuple[PETSc.Mat, bool]:
        """The matrix with contact blocks added, not yet eliminated, and whether its pattern is new.

        nodes (k, n): global nodes of each facet pair; matrices (k, n * block, n * block). `reserve` (r, n): node
        sets of pairs that may soon be in contact and should have places already.
        """
        keys, blocks = self._collect(nodes, matrices)
        if self._pattern_is_new:
            self._grow(np.union1d(keys, self._collect_keys(reserve)))
        elif self.comm.allreduce(bool(len(np.setdiff1d(keys, self._keys))), op=MPI.LOR):
            self._grow(keys)
        self._write(keys, blocks)
        fresh, self._pattern_is_new = self._pattern_is_new, False
        return self.matrix, fresh

    def eliminate(self) -> None:
        """Make the rows and columns of fixed unknowns those of the unit matrix."""
        self.matrix.zeroRowsColumns(self.fixed, diag=1.0)

    def _owner(self, node: Integers) -> Integers:
        return np.searchsorted(self._owners, node, side="right") - 1

    def _collect_keys(self, nodes: Integers) -> Integers:
        pairs = np.unique((nodes[:, :, None] * self._total + nodes[:, None, :]).ravel())
        owner = self._owner(pairs // self._total)
        received = self.comm.alltoall([pairs[owner == rank] for rank in range(self.comm.size)])
        return np.unique(np.concatenate(received)) - self._first * self._total

    def _collect(self, nodes: Integers, matrices: Array) -> tuple[Integers, Array]:
        """Sum blocks by place and bring each to the rank that owns its row: local keys (k,), blocks (k, b, b)."""
        b = self.block
        n = nodes.shape[1]
        keys = (nodes[:, :, None] * self._total + nodes[:, None, :]).ravel()
        blocks = matrices.reshape(-1, n, b, n, b).swapaxes(2, 3).reshape(-1, b * b)
        keys, blocks = _sum_equal(keys, blocks)
        if self.comm.size > 1:
            owner = self._owner(keys // self._total)
            parcels = [(keys[owner == rank], blocks[owner == rank]) for rank in range(self.comm.size)]
            received = self.comm.alltoall(parcels)
            keys, blocks = _sum_equal(
                np.concatenate([k for k, _ in received]), np.concatenate([v for _, v in received])
            )
        return keys - self._first * self._total, blocks.reshape(-1, b, b)

    def _grow(self, keys: Integers) -> None:
        self._keys = np.union1d(self._keys, keys)
        self._pattern_is_new = True

    def _write(self, keys: Integers, blocks: Array) -> None:
        b = self.block
        if self._pattern_is_new:
            self._find_rows()
            row_length = np.repeat(np.diff(self._row_start) * b, b)
            self._pointer = np.concatenate([[0], np.cumsum(row_length)]).astype(PETSc.IntType)
            node_columns = (self._keys % self._total)[:, None] * b + np.arange(b)
            spans = _ranges(np.repeat(self._row_start[:-1] * b, b), row_length)
            self._columns = node_columns.ravel()[spans].astype(PETSc.IntType)
            self._touched = np.zeros(0, np.int64)
        if self._pattern_is_new or self._bulk_is_new:
            self._base = np.zeros(len(self._columns))
            self._base[self._places(self._bulk_keys)] = self._bulk_blocks
        if self._pattern_is_new:
            if self.matrix is not None:
                self.matrix.destroy()  # for Python: who solves with it holds it as long as it needs it
            self.matrix = PETSc.Mat().createAIJ(
                self._sizes, bsize=b, csr=(self._pointer, self._columns, self._base), comm=self.comm
            )
            self.rebuilds += 1
        elif self._bulk_is_new:
            self.matrix.setValuesCSR(self._pointer, self._columns, self._base)
        rows = np.unique(np.concatenate([self._touched, keys // self._total]))
        scalar_rows = (rows[:, None] * b + np.arange(b)).ravel()
        lengths = np.diff(self._pointer)[scalar_rows]
        spans = _ranges(self._pointer[scalar_rows], lengths)
        places = self._places(keys).ravel()
        bulk = self._base[places]
        self._base[places] += blocks.ravel()
        pointer = np.concatenate([[0], np.cumsum(lengths)]).astype(PETSc.IntType)
        rowmap = (scalar_rows + self._first * b).astype(PETSc.IntType)
        self.matrix.setValuesIJV(pointer, self._columns[spans], self._base[spans], rowmap=rowmap)
        self._base[places] = bulk
        self.matrix.assemble()
        self._bulk_is_new = False
        self._touched = np.unique(keys // self._total)

    def _find_rows(self) -> None:
        """Where the blocks of each row begin among the present keys."""
        count = np.bincount(self._keys // self._total, minlength=self._nodes)
        self._row_start = np.concatenate([[0], np.cumsum(count)])

    def _places(self, keys: Integers) -> Integers:
        """Where the entries of the blocks with these local keys stand in the CSR data, (k, b, b)."""
        b = self.block
        index = np.searchsorted(self._keys, keys)
        row = keys // self._total
        start = self._row_start[row]
        length = (self._row_start[row + 1] - start) * b
        first = b * b * start + (index - start) * b
        return first[:, None, None] + np.arange(b)[:, None] * length[:, None, None] + np.arange(b)


def _sum_equal(keys: Integers, blocks: Array) -> tuple[Integers, Array]:
    if not len(keys):
        return keys, blocks
    order = np.argsort(keys, kind="stable")
    unique, first = np.unique(keys[order], return_index=True)
    return unique, np.add.reduceat(blocks[order], first)


def _ranges(starts: Integers, lengths: Integers) -> Integers:
    """The numbers start, ..., start + length - 1 of every range, one after the other."""
    ends = np.cumsum(lengths)
    return np.arange(ends[-1] if len(ends) else 0) + np.repeat(starts - (ends - lengths), lengths)
