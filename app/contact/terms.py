"""Contact's terms in residual and tangent: vectors and matrices of pairs of facets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from piezomat.forms.arrays import Array, Integers


@dataclass(frozen=True)
class ContactTerms:
    """Vectors and matrices of pairs of facets in contact.

    nodes (k, n): nodes of each pair, slave first, numbered as in `Interfaces.nodes`
    vectors (k, n, block_size): share of the residual
    matrices (k, n * block_size, n * block_size): share of the tangent; None without it
    """

    nodes: Integers
    vectors: Array
    matrices: Array | None

    @classmethod
    def none(cls, nodes_per_pair: int, block_size: int, *, tangent: bool) -> ContactTerms:
        """Terms of no pair."""
        n = nodes_per_pair
        matrices = np.zeros((0, n * block_size, n * block_size)) if tangent else None
        return cls(np.zeros((0, n), np.int64), np.zeros((0, n, block_size)), matrices)

    @classmethod
    def summed(cls, pair: Integers, nodes: Integers, vectors: Array, matrices: Array | None) -> ContactTerms:
        """Sums over the points (m,) of each pair, so that a matrix is scattered once a pair, not once a point."""
        if not len(pair):
            return cls(nodes, vectors, matrices)
        order = np.argsort(pair, kind="stable")
        first = np.unique(pair[order], return_index=True)[1]
        summed = None if matrices is None else np.add.reduceat(matrices[order], first)
        return cls(nodes[order[first]], np.add.reduceat(vectors[order], first), summed)

    @classmethod
    def joined(cls, terms: list[ContactTerms]) -> ContactTerms:
        """All pairs of several terms, which have as many nodes a pair each."""
        matrices = None if terms[0].matrices is None else np.concatenate([t.matrices for t in terms])
        return cls(np.concatenate([t.nodes for t in terms]), np.concatenate([t.vectors for t in terms]), matrices)
