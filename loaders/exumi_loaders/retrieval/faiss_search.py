"""Approximate search with FAISS, for indices of millions of clips."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from exumi_data.errors import MissingExtraError

__all__ = ["FaissSearch"]

_FLAT_BELOW = 20_000
_PER_LIST = 39  # rows for each list that FAISS asks for at least when it trains
_PROBED = 0.05


class FaissSearch:
    """Search a part of all rows: those in the lists next to the query.

    Fewer than 20,000 rows are searched exactly. All rows are copied into FAISS's own memory.

    Parameters
    ----------
    blocks : sequence of (n, d) float32
    alive : (N,) bool, optional

    Raises
    ------
    MissingExtraError
        FAISS is not installed.
    """

    def __init__(self, blocks: Sequence[np.ndarray], alive: np.ndarray | None = None) -> None:
        faiss = _faiss()
        rows = sum(len(block) for block in blocks)
        width = blocks[0].shape[1] if blocks else 1
        self._numbers = np.arange(rows) if alive is None else np.flatnonzero(alive)
        self._index = faiss.IndexFlatIP(width)
        if len(self._numbers) >= _FLAT_BELOW:
            lists = min(int(4 * len(self._numbers) ** 0.5), len(self._numbers) // _PER_LIST)
            self._index = faiss.IndexIVFFlat(self._index, width, lists, faiss.METRIC_INNER_PRODUCT)
            self._index.nprobe = max(1, round(_PROBED * lists))
            every = -(-len(self._numbers) // (_PER_LIST * lists * 2))
            self._index.train(_rows(blocks, self._numbers[::every]))
        start = 0
        for block in blocks:
            kept = block if alive is None else block[alive[start : start + len(block)]]
            self._index.add(np.ascontiguousarray(kept))
            start += len(block)

    def nearest(self, queries: np.ndarray, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Find rows with large inner products; mostly the largest.

        Parameters
        ----------
        queries : (B, d) float32
        k : int

        Returns
        -------
        similarity : (B, k) float32
            Falling; -inf where nothing was found.
        row : (B, k) int64
            -1 where nothing was found.
        """
        k = min(k, len(self._numbers))
        if not k or not len(queries):
            shape = (len(queries), k)
            return np.empty(shape, np.float32), np.empty(shape, np.int64)
        similarity, place = self._index.search(np.ascontiguousarray(queries), k)
        found = place >= 0
        row = np.where(found, self._numbers[np.maximum(place, 0)], -1)
        return np.where(found, similarity, -np.inf).astype(np.float32), row


def _faiss() -> Any:
    try:
        import faiss
    except ModuleNotFoundError:
        raise MissingExtraError(
            "backend='faiss' needs FAISS", fix='Install it: pip install "exumi-data[faiss]"'
        ) from None
    return faiss


def _rows(blocks: Sequence[np.ndarray], numbers: np.ndarray) -> np.ndarray:
    """Copy some rows out of blocks; `numbers` rise."""
    parts = []
    start = 0
    for block in blocks:
        inside = numbers[(numbers >= start) & (numbers < start + len(block))]
        parts.append(block[inside - start])
        start += len(block)
    return np.concatenate(parts)
