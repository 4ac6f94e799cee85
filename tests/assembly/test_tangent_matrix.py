"""The tangent matrix against a dense reference: every entry, while contacts come, move and go."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from piezomat.assembly.tangent_matrix import TangentMatrix
from piezomat.forms.arrays import Array, Integers

pytestmark = pytest.mark.mpi

NODES = 30


class Eliminations:
    """Constraints of numbered unknowns: some are fixed, some equal others; eliminated (k,): this rank's of both."""

    def __init__(self, image: Integers, eliminated: Integers) -> None:
        self.ties = self
        self._image, self._eliminated = image, eliminated.astype(np.int32)

    def __bool__(self) -> bool:
        return bool((self._image != np.arange(len(self._image))).any())

    def image(self, numbers: Integers) -> Integers:
        return self._image[numbers]

    def eliminate(self, matrix: PETSc.Mat) -> None:
        matrix.zeroRowsColumns(self._eliminated, diag=1.0)


class Case:
    """A chain of nodes, unevenly owned, with full blocks between neighbours; what is random is so on all ranks alike.

    The dense reference holds the whole matrix on every rank.
    """

    def __init__(
        self, comm: MPI.Comm, block: int, rng: np.random.Generator, uneven: bool = False, tied: int = 0
    ) -> None:
        self.comm, self.block, self.rng = comm, block, rng
        cuts = NODES * np.arange(1, comm.size) // comm.size
        if uneven:  # and the first rank owns nothing
            cuts = np.sort(rng.integers(0, NODES + 1, comm.size - 1)) * (np.arange(comm.size - 1) > 0)
        self.ends = np.concatenate([[0], cuts, [NODES]])
        self.first, self.last = int(self.ends[comm.rank]), int(self.ends[comm.rank + 1])
        chosen = rng.choice((NODES - 1) * block, 7 + tied, replace=False)
        self.image = np.arange(NODES * block)
        self.image[chosen[7:]] = (NODES - 1) * block + rng.integers(0, block, tied)  # unknowns of the last node
        self.fixed = np.sort(chosen)  # or tied
        self.dense = self.new_bulk()
        mine = self.fixed[(self.fixed >= self.first * block) & (self.fixed < self.last * block)]
        self.tangent = TangentMatrix(comm, self.bulk(), block, Eliminations(self.image, mine))

    def new_bulk(self) -> Array:
        """A random symmetric matrix with blocks between neighbours of the chain."""
        near = np.abs(np.subtract.outer(np.arange(NODES), np.arange(NODES))) <= 1
        values = self.rng.standard_normal((NODES * self.block,) * 2)
        return (values + values.T) * np.kron(near, np.ones((self.block, self.block)))

    def bulk(self) -> PETSc.Mat:
        """The dense bulk as a distributed matrix with full blocks."""
        b = self.block
        local = (self.last - self.first) * b
        pointer, columns, values = [0], [], []
        for row in range(self.first * b, self.last * b):
            node = row // b
            places = np.arange(max(node - 1, 0) * b, min(node + 2, NODES) * b)
            columns.append(places)
            values.append(self.dense[row, places])
            pointer.append(pointer[-1] + len(places))
        csr = (
            np.array(pointer, PETSc.IntType),
            np.concatenate([np.zeros(0), *columns]).astype(PETSc.IntType),
            np.concatenate([np.zeros(0), *values]),
        )
        matrix = PETSc.Mat().createAIJ(((local, None), (local, None)), bsize=b, csr=csr, comm=self.comm)
        matrix.assemble()
        return matrix

    def contacts(self, count: int, nodes_each: int = 4) -> tuple[Integers, Array, Array]:
        """Random contact pairs: this rank's nodes and symmetric matrices, and the dense sum over all ranks.

        Pairs are dealt out at random and have nodes of any rank, some of them pair after pair.
        """
        b = self.block
        nodes = np.array([self.rng.choice(NODES, nodes_each, replace=False) for _ in range(count)], np.int64)
        nodes = nodes.reshape(count, nodes_each)
        matrices = self.rng.standard_normal((count, nodes_each * b, nodes_each * b))
        matrices += np.swapaxes(matrices, 1, 2)
        dense = np.zeros_like(self.dense)
        for pair, matrix in zip(nodes, matrices, strict=True):
            rows = (pair[:, None] * b + np.arange(b)).ravel()
            dense[np.ix_(rows, rows)] += matrix
        mine = self.rng.integers(0, self.comm.size, count) == self.comm.rank
        return nodes[mine], matrices[mine], dense

    def none(self) -> Integers:
        return np.zeros((0, 4), np.int64)

    def found(self, matrix: PETSc.Mat) -> Array:
        """The distributed matrix in full on every rank."""
        b = self.block
        rows = np.arange(self.first * b, self.last * b, dtype=PETSc.IntType)
        local = matrix.getValues(rows, np.arange(NODES * b, dtype=PETSc.IntType))
        return np.concatenate(self.comm.allgather(local.reshape(len(rows), NODES * b)))

    def reduced(self, dense: Array) -> Array:
        """T^T K T, where the columns of T that belong to tied unknowns are those of their images."""
        ties = np.eye(len(dense))[self.image]
        return ties.T @ dense @ ties

    def eliminated(self, dense: Array) -> Array:
        result = self.reduced(dense)
        result[self.fixed], result[:, self.fixed] = 0.0, 0.0
        result[self.fixed, self.fixed] = 1.0
        return result

    def check(self, contacts: tuple[Integers, Array, Array], reserve: Integers | None = None) -> bool:
        """Assemble, eliminate and compare; whether the pattern was new.

        Before the elimination too, but for the fixed: rows that contact does not touch stay eliminated.
        """
        nodes, matrices, dense = contacts
        matrix, fresh = self.tangent.assemble(nodes, matrices, self.none() if reserve is None else reserve)
        total = self.dense + dense
        free = np.setdiff1d(np.arange(len(total)), self.fixed)
        expected = self.reduced(total)[np.ix_(free, free)]
        np.testing.assert_allclose(self.found(matrix)[np.ix_(free, free)], expected, atol=1e-12)
        assert len(set(self.comm.allgather(fresh))) == 1
        self.tangent.eliminate()
        np.testing.assert_allclose(self.found(matrix), self.eliminated(total), atol=1e-12)
        vector, product = matrix.createVecs()
        values = self.rng.standard_normal(NODES * self.block)
        vector.array[:] = values[self.first * self.block : self.last * self.block]
        matrix.mult(vector, product)
        expected = self.eliminated(total) @ values
        np.testing.assert_allclose(
            product.array_r, expected[self.first * self.block : self.last * self.block], atol=1e-12
        )
        return fresh


cases = pytest.mark.parametrize(("block", "uneven"), [(1, False), (3, False), (4, True)])


@cases
def test_bulk_alone(block: int, uneven: bool, comm: MPI.Comm, rng: np.random.Generator) -> None:
    case = Case(comm, block, rng, uneven)
    assert case.check(case.contacts(0))
    assert not case.check(case.contacts(0))
    assert case.tangent.rebuilds == 1


@cases
def test_tied_unknowns_add_up_at_their_references(
    block: int, uneven: bool, comm: MPI.Comm, rng: np.random.Generator
) -> None:
    """With contact on tied nodes, new places, and a bulk that changes."""
    case = Case(comm, block, rng, uneven, tied=9)
    case.check(case.contacts(0))
    for count in (5, 0, 20):
        case.check(case.contacts(count))
    case.dense = case.new_bulk()
    case.tangent.set_bulk(case.bulk())
    assert not case.check(case.contacts(0))


@cases
def test_contacts_come_move_and_go(block: int, uneven: bool, comm: MPI.Comm, rng: np.random.Generator) -> None:
    """No entry of an earlier contact is left behind, nor one that the elimination has zeroed."""
    case = Case(comm, block, rng, uneven)
    for count in (3, 0, 8, 1, 0, 20):
        case.check(case.contacts(count))
    # By now the pattern is nearly full: more of the same place needs no new one.
    nodes, matrices, dense = case.contacts(5)
    case.check((nodes, matrices, dense))
    assert not case.check((nodes, 2.0 * matrices, 2.0 * dense))
    assert not case.check(case.contacts(0))


@cases
def test_pattern_grows_only_when_it_must(block: int, uneven: bool, comm: MPI.Comm, rng: np.random.Generator) -> None:
    case = Case(comm, block, rng, uneven)
    first, second = case.contacts(4), case.contacts(4)
    assert case.check(first)
    assert not case.check(first)
    assert case.check(second)  # grows, and keeps the places of the first
    assert not case.check(first)
    assert not case.check(case.contacts(0))
    assert case.tangent.rebuilds == 2
    case.tangent.forget_pattern()
    assert case.check(first)
    assert case.check(second)
    assert case.tangent.rebuilds == 4


@cases
def test_reserved_places_need_no_new_pattern(
    block: int, uneven: bool, comm: MPI.Comm, rng: np.random.Generator
) -> None:
    """What is reserved when the pattern is new can come into contact later without another."""
    case = Case(comm, block, rng, uneven)
    now, soon = case.contacts(3), case.contacts(5)
    assert case.check(now, soon[0])
    assert not case.check(soon)
    assert not case.check(now)
    case.tangent.forget_pattern()
    assert case.check(now)
    assert case.check(soon)


@cases
def test_new_bulk_takes_over(block: int, uneven: bool, comm: MPI.Comm, rng: np.random.Generator) -> None:
    """Other values in the bulk, with and without contact, with the old pattern and a new one."""
    case = Case(comm, block, rng, uneven)
    contacts = case.contacts(5)
    case.check(contacts)
    for following in (contacts, case.contacts(0), case.contacts(6), contacts):
        case.dense = case.new_bulk()
        case.tangent.set_bulk(case.bulk())
        case.check(following)
    case.check(case.contacts(2))


@cases
def test_pairs_that_repeat_add_up(block: int, uneven: bool, comm: MPI.Comm, rng: np.random.Generator) -> None:
    """The same pair of facets many times over, on one rank and on several."""
    case = Case(comm, block, rng, uneven)
    pair = case.rng.choice(NODES, 4, replace=False).astype(np.int64)
    matrices = case.rng.standard_normal((6, 4 * block, 4 * block))
    rows = (pair[:, None] * block + np.arange(block)).ravel()
    dense = np.zeros_like(case.dense)
    dense[np.ix_(rows, rows)] = comm.size * matrices.sum(axis=0)
    case.check((np.tile(pair, (6, 1)), matrices, dense))


def test_it_solves_like_the_dense_one(comm: MPI.Comm, rng: np.random.Generator) -> None:
    """The assembled matrix serves a factorization: the pattern has what a solver expects, the diagonal too."""
    case = Case(comm, 2, rng)
    case.dense += 20.0 * np.eye(len(case.dense))
    case.tangent.set_bulk(case.bulk())
    nodes, matrices, dense = case.contacts(6)
    matrix, _ = case.tangent.assemble(nodes, matrices, case.none())
    case.tangent.eliminate()
    right, found = matrix.createVecs()
    values = rng.standard_normal(NODES * 2)
    mine = slice(case.first * 2, case.last * 2)
    right.array[:] = values[mine]
    solver = PETSc.KSP().create(comm)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    solver.getPC().setFactorSolverType("mumps")
    solver.setOperators(matrix)
    solver.solve(right, found)
    expected = np.linalg.solve(case.eliminated(case.dense + dense), values)
    np.testing.assert_allclose(found.array_r, expected[mine], rtol=1e-10, atol=1e-12)
    assert matrix.getBlockSize() == 2
