"""Groups of nodes of several terms in one array: a smaller group has its first node again, where nothing is added."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from piezomat.forms.arrays import Array, Integers


def joined_groups(groups: Sequence[Integers]) -> Integers:
    """All groups (k, n) of nodes, given as several arrays; n is that of the largest, 1 without any."""
    size = max((nodes.shape[1] for nodes in groups), default=1)
    padded = [np.hstack([nodes, np.repeat(nodes[:, :1], size - nodes.shape[1], axis=1)]) for nodes in groups]
    return np.concatenate([np.zeros((0, size), np.int64), *padded])


def joined_blocks(blocks: Sequence[tuple[Integers, Array]], components: int) -> tuple[Integers, Array]:
    """All groups (k, n) of nodes and their matrices (k, n b, n b), given as several arrays; b: components of a node."""
    nodes = joined_groups([some for some, _ in blocks])
    size = nodes.shape[1] * components
    missing = [(matrices, size - matrices.shape[1]) for _, matrices in blocks]
    padded = [np.pad(matrices, ((0, 0), (0, more), (0, more))) if more else matrices for matrices, more in missing]
    return nodes, np.concatenate([np.zeros((0, size, size)), *padded])
