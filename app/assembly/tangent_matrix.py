"""The tangent matrix: a bulk part with a fixed pattern plus contact blocks whose places change.

In small kinematics the bulk is constant, and an iteration writes only the rows that contact touches. Where the pattern
lacks places that contact needs, it grows and the matrix is built anew.

Entries in rows and columns of tied unknowns are added where their references are as well, which makes T^T K T; those of
the tied unknowns themselves are eliminated with the fixed ones.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.discretization.constraints import Constraints
from piezomat.forms import fenicsx
from piezomat.forms.arrays import Array, Integers

CHUNK = 100_000  # blocks that are handled at once, to bound the memory of their places


class TangentMatrix:
    """Bulk + contact in one AIJ matrix, the eliminated unknowns left out symmetrically. Every method is collective.

    block: unknowns of a node
    constraints: which unknowns are eliminated, and which others the tied ones among them equal
    matrix: of the last `assemble`; None before
    rebuilds: number of times that the matrix was built with a new pattern
    """

    def __init__(self, comm: MPI.Comm, bulk: PETSc.Mat, block: int, constraints: Constraints) -> None:
        """bulk: AIJ with full blocks of `block` unknowns a node; read when needed, not copied: it must live as long."""
        self.comm = comm
        self.block = block
        self.constraints = constraints
        self.rebuilds = 0
        self._sizes = bulk.getSizes()
        start, stop = bulk.getOwnershipRange()
        self._first, self._nodes = start // block, (stop - start) // block
        self._owners = np.array(comm.allgather(self._first), np.int64)
        self._total = bulk.getSize()[0] // block
        pointer, columns, _ = bulk.getValuesCSR()
        rows = np.repeat(np.arange(self._nodes), np.diff(pointer[::block]) // block**2)
        first_rows = _ranges(pointer[:-1:block], np.diff(pointer)[::block])
        keys = rows * self._total + columns[first_rows[::block]].astype(np.int64) // block
        self._bulk_pattern = _Pattern(keys, self._nodes, self._total, block)
        self._tied_pattern = self._pattern_with_ties()
        self.matrix: PETSc.Mat | None = None
        self.forget_pattern()
        self.set_bulk(bulk)

    def set_bulk(self, bulk: PETSc.Mat) -> None:
        """Use the values of this bulk, whose pattern must be the same, in the next `assemble`."""
        self._bulk = bulk
        self._bulk_is_new = True

    def forget_pattern(self) -> None:
        """Drop the places of past contacts: the next `assemble` builds the matrix from the bulk's pattern."""
        self._pattern = self._tied_pattern
        self._rows = np.zeros(0, np.int64)  # local nodes in whose rows contact has places
        self._pattern_is_new = True

    def assemble(self, nodes: Integers, matrices: Array, reserve: Integers) -> tuple[PETSc.Mat, bool]:
        """The matrix with contact blocks added, nothing eliminated as yet, and whether its pattern is new.

        nodes (k, n), matrices (k, n * block, n * block): global nodes of each facet pair of this rank, and its matrix
        reserve (r, n): nodes of facet pairs that may soon be in contact, for which a new pattern has places too
        """
        keys, blocks = self._collect(nodes, matrices)
        fresh = self._pattern_is_new
        if fresh:
            self._grow(np.union1d(keys, self._collect_keys(reserve)))
        elif self.comm.allreduce(not self._has_places(keys), op=MPI.LOR):
            self._grow(keys)
            fresh = True
        if fresh or self._bulk_is_new:
            self._write_bulk(fresh)
        self._write_contact(keys, blocks)
        return self.matrix, fresh

    def eliminate(self) -> None:
        """Make the rows and columns of fixed and tied unknowns those of the unit matrix."""
        self.constraints.eliminate(self.matrix)

    def _owner(self, node: Integers) -> Integers:
        return np.searchsorted(self._owners, node, side="right") - 1

    def _collect_keys(self, nodes: Integers) -> Integers:
        pairs = np.unique((nodes[:, :, None] * self._total + nodes[:, None, :]).ravel())
        if self.constraints.ties:
            pairs = np.union1d(pairs, self._at_references(pairs, None)[0])
        owner = self._owner(pairs // self._total)
        received = self.comm.alltoall([pairs[owner == rank] for rank in range(self.comm.size)])
        return np.unique(np.concatenate(received)) - self._first * self._total

    def _collect(self, nodes: Integers, matrices: Array) -> tuple[Integers, Array]:
        """Sum blocks by place and bring each to the rank that owns its row: local keys (k,), blocks (k, b, b)."""
        b = self.block
        n = nodes.shape[1]
        keys = (nodes[:, :, None] * self._total + nodes[:, None, :]).ravel()
        blocks = matrices.reshape(-1, n, b, n, b).swapaxes(2, 3).reshape(-1, b * b)
        if self.constraints.ties:
            added = self._at_references(keys, blocks.reshape(-1, b, b))
            keys, blocks = np.concatenate([keys, added[0]]), np.concatenate([blocks, added[1]])
        return self._brought_home(keys, blocks)

    def _brought_home(self, keys: Integers, blocks: Array) -> tuple[Integers, Array]:
        """Sum blocks (k, b * b) of global keys, and bring each to the rank that owns its row, see `_collect`."""
        b = self.block
        keys, blocks = _sum_equal(keys, blocks)
        if self.comm.size > 1:
            owner = self._owner(keys // self._total)
            parcels = [(keys[owner == rank], blocks[owner == rank]) for rank in range(self.comm.size)]
            received = self.comm.alltoall(parcels)
            keys, blocks = _sum_equal(
                np.concatenate([k for k, _ in received]), np.concatenate([v for _, v in received])
            )
        return keys - self._first * self._total, blocks.reshape(-1, b, b)

    # --- ties

    def _at_references(self, keys: Integers, blocks: Array | None) -> tuple[Integers, Array]:
        """The entries of blocks (k, b, b) in rows or columns of tied unknowns, again at their references.

        Global keys (l,) and blocks (l, b * b), each with one entry, none of them zero; without `blocks` all keys.
        """
        b, ties = self.block, self.constraints.ties
        local = np.arange(b)
        rows, columns = ((nodes[:, None] * b + local) for nodes in (keys // self._total, keys % self._total))
        to_row, to_column = ties.image(rows), ties.image(columns)
        moved = (to_row != rows)[:, :, None] | (to_column != columns)[:, None, :]
        if blocks is not None:
            moved &= blocks != 0.0
        block, i, j = np.nonzero(moved)
        row, column = to_row[block, i], to_column[block, j]
        found = (row // b) * self._total + column // b
        if blocks is None:
            return np.unique(found), np.zeros((0, b * b))
        values = np.zeros((len(found), b * b))
        values[np.arange(len(found)), (row % b) * b + column % b] = blocks[block, i, j]
        return found, values

    def _pattern_with_ties(self) -> _Pattern:
        """The bulk's pattern with the places of `_tied_blocks`."""
        ties = self.constraints.ties
        self._tied_keys = np.zeros(0, np.int64)  # of the bulk's blocks that have tied unknowns
        if not ties:
            return self._bulk_pattern
        keys, b = self._bulk_pattern.keys, self.block
        numbers = np.arange(self._total * b)
        tied = (ties.image(numbers) != numbers).reshape(-1, b).any(axis=1)
        self._tied_keys = keys[tied[keys // self._total + self._first] | tied[keys % self._total]]
        whole = self._tied_keys + self._first * self._total
        every = self._at_references(whole, None)[0]
        local, _ = self._brought_home(every, np.zeros((len(every), b * b)))
        return _Pattern(np.union1d(keys, local), self._nodes, self._total, b)

    def _tied_blocks(self, bulk: Array) -> tuple[Integers, Array]:
        """The bulk's entries at tied unknowns, given its CSR data, as blocks at their references: see `_collect`."""
        blocks = bulk[self._bulk_pattern.places(self._tied_keys)]
        return self._brought_home(*self._at_references(self._tied_keys + self._first * self._total, blocks))

    def _has_places(self, keys: Integers) -> bool:
        return self._pattern.has(keys) and bool(np.isin(keys // self._total, self._rows).all())

    def _grow(self, keys: Integers) -> None:
        keys_now = np.union1d(self._pattern.keys, keys)
        self._pattern = _Pattern(keys_now, self._nodes, self._total, self.block)
        self._rows = np.union1d(self._rows, keys // self._total)

    def _write_bulk(self, fresh: bool) -> None:
        """Write the bulk into the matrix, a new one if the pattern is new; keep its values in the rows of contact."""
        b, pattern = self.block, self._pattern
        bulk = self._bulk.getValuesCSR()[2]
        values = np.zeros(pattern.pointer[-1])
        if fresh:
            self._columns = np.zeros(len(values), PETSc.IntType)
            self._touched = np.zeros(0, np.int64)
        for keys in self._bulk_pattern.chunks():
            values[pattern.places(keys)] = bulk[self._bulk_pattern.places(keys)]
        if self.constraints.ties:
            keys, blocks = self._tied_blocks(bulk)
            values[pattern.places(keys)] += blocks
        for keys in pattern.chunks() if fresh else ():
            self._columns[pattern.places(keys)] = ((keys % self._total)[:, None] * b + np.arange(b))[:, None]
        del bulk
        csr = pattern.pointer, self._columns, values
        if fresh:
            self.matrix = fenicsx.matrix_from_csr(self.matrix, self._sizes, b, csr, self.comm)
        else:
            self.matrix.setValuesCSR(*csr)
        self.rebuilds += fresh
        first, last = pattern.pointer[self._rows * b], pattern.pointer[(self._rows + 1) * b]
        self._base = values[_ranges(first, last - first)]
        # From a place in the matrix's CSR data to the one in these rows alone.
        self._shift = np.zeros(self._nodes, np.int64)
        self._shift[self._rows] = np.cumsum(last - first) - last
        self._pattern_is_new = self._bulk_is_new = False

    def _write_contact(self, keys: Integers, blocks: Array) -> None:
        """Write the rows that contact touches now, and those that it touched when it was written last."""
        b = self.block
        rows = np.unique(np.concatenate([self._touched, keys // self._total]))
        scalar_rows = (rows[:, None] * b + np.arange(b)).ravel()
        lengths = np.diff(self._pattern.pointer)[scalar_rows]
        spans = _ranges(self._pattern.pointer[scalar_rows], lengths)
        of_base = spans + np.repeat(np.repeat(self._shift[rows], b), lengths)
        places = (self._pattern.places(keys) + self._shift[keys // self._total][:, None, None]).ravel()
        bulk = self._base[places]
        self._base[places] += blocks.ravel()
        pointer = np.concatenate([[0], np.cumsum(lengths)]).astype(PETSc.IntType)
        rowmap = (scalar_rows + self._first * b).astype(PETSc.IntType)
        self.matrix.setValuesIJV(pointer, self._columns[spans], self._base[of_base], rowmap=rowmap)
        self._base[places] = bulk
        self.matrix.assemble()
        self._touched = np.unique(keys // self._total)


class _Pattern:
    """Places of the blocks of a matrix in its CSR data.

    keys (k,): node row * total + node column of each block, sorted
    pointer (rows * block + 1,): where each scalar row begins in the data
    """

    def __init__(self, keys: Integers, rows: int, total: int, block: int) -> None:
        self.keys, self._total, self._block = keys, total, block
        count = np.bincount(keys // total, minlength=rows)
        self._start = np.concatenate([[0], np.cumsum(count)])
        self.pointer = np.concatenate([[0], np.cumsum(np.repeat(count * block, block))]).astype(PETSc.IntType)

    def chunks(self) -> list[Integers]:
        """The keys in parts: the places of all blocks at once take more memory than the matrix."""
        return np.split(self.keys, np.arange(CHUNK, len(self.keys), CHUNK))

    def has(self, keys: Integers) -> bool:
        """Whether the pattern has all these keys."""
        index = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        return not len(keys) or (len(self.keys) > 0 and bool((self.keys[index] == keys).all()))

    def places(self, keys: Integers) -> Integers:
        """Positions (k, b, b) in the data of the entries of the blocks with these keys."""
        b = self._block
        index = np.searchsorted(self.keys, keys)
        row = keys // self._total
        start = self._start[row]
        length = (self._start[row + 1] - start) * b
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
