"""Exact search: the largest cosines, block by block."""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

__all__ = ["ExactSearch", "Search"]

_SCORES = 1 << 20  # numbers of a block of similarities: 4 MiB, which stay in the cache


class Search(Protocol):
    """What finds the nearest rows."""

    def nearest(self, queries: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Return similarities (B, k) float32, falling, and rows (B, k) int64."""
        ...


class ExactSearch:
    """Search all rows by matrix products of blocks. Memory: some MiB, whatever the rows.

    Parameters
    ----------
    blocks : sequence of (n, d) float32
        Rows of length 1, one block after the other; they can be memory maps.
    alive : (N,) bool, optional
        Which rows count; default all.
    before : callable, optional
        Told of the number of each block before it is read.
    """

    def __init__(
        self,
        blocks: Sequence[np.ndarray],
        alive: np.ndarray | None = None,
        *,
        before: Callable[[int], None] = lambda _number: None,
    ) -> None:
        self._blocks = blocks
        self._before = before
        self._alive = alive
        rows = sum(len(block) for block in blocks)
        self._count = rows if alive is None else int(alive.sum())

    def nearest(self, queries: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Find the rows with the largest inner products.

        Parameters
        ----------
        queries : (B, d) float32
        k : int
            Rows for each query; there are fewer if the index has fewer.

        Returns
        -------
        similarity : (B, k) float32
            Falling. Of equal rows the earlier comes first.
        row : (B, k) int64
        """
        best = _Best(len(queries), min(k, self._count))
        if not len(queries) or not best.k:
            return best.similarity, best.row
        step = max(1, _SCORES // len(queries))
        start = 0
        for number, block in enumerate(self._blocks):
            self._before(number)
            for low in range(0, len(block), step):
                part = block[low : low + step]
                # One query is a product of matrix and vector, which reads the rows in order.
                scores = (part @ queries[0])[None] if len(queries) == 1 else queries @ part.T
                if self._alive is not None:
                    scores[:, ~self._alive[start + low : start + low + len(part)]] = -np.inf
                best.take(scores, start + low)
            start += len(block)
        return best.similarity, best.row


class _Best:
    """The best rows so far."""

    def __init__(self, queries: int, k: int) -> None:
        self.k = k
        self.similarity = np.full((queries, k), -np.inf, dtype=np.float32)
        self.row = np.full((queries, k), -1, dtype=np.int64)

    def take(self, scores: np.ndarray, start: int) -> None:
        """Take a block of similarities (B, n) of the rows from `start` into account."""
        # After some blocks hardly any row is better than the worst of the best. One pass over
        # the maxima finds that out.
        largest = scores.max(axis=1)
        if np.isnan(largest).any():  # of a damaged row, which must not hide the others
            scores = np.nan_to_num(scores, nan=-np.inf)
            largest = scores.max(axis=1)
        better = np.flatnonzero(largest > self.similarity[:, -1])
        for query in better:
            worst = self.similarity[query, -1]
            found = np.flatnonzero(scores[query] > worst)
            if len(found) > self.k:
                values = scores[query, found]
                least = np.partition(values, len(found) - self.k)[len(found) - self.k]
                found = found[values >= least]
            similarity = np.concatenate((self.similarity[query], scores[query, found]))
            row = np.concatenate((self.row[query], start + found))
            order = np.lexsort((row, -similarity))[: self.k]
            self.similarity[query], self.row[query] = similarity[order], row[order]
