"""Sampling: which of many rows are looked at, so that each kind of them has its share."""

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Kinds = NDArray[np.unsignedinteger]


def balanced(kinds: Kinds, n: int, random: Generator) -> NDArray[np.int64]:
    """The places, ascending, of `n` rows, as many of each of their `kinds` (rows,) as there are of any other.

    Of a kind that has fewer all are taken, of one that has more they are drawn uniformly; all, where there
    are fewer than `n`.
    """
    order = random.permutation(len(kinds))
    order = order[np.argsort(kinds[order], kind="stable")]
    starts = np.concatenate([[0], np.cumsum(np.bincount(kinds))])
    turns = np.arange(len(order)) - starts[kinds[order]]
    chosen = order[np.argsort(turns, kind="stable")[:n]]
    places: NDArray[np.int64] = np.sort(chosen)
    return places
