"""Rows of vectors, mapped from a file, whose checksum is compared when they are first used."""

from pathlib import Path

import numpy as np

from exumi_data.errors import DamagedDataError
from exumi_data.store.shards import crc32c

__all__ = ["Block", "merge_small"]

_SMALL_BLOCK = 4096


class Block:
    """Some rows of an index.

    Opening an index reads none of its vectors. Whoever computes with a block checks it before; that
    reads it once more than needed, at a few GB/s from memory, and only the first time.

    Parameters
    ----------
    rows : (n, d) float32
        Read-only.
    where : pathlib.Path
        The file that they are mapped from.
    checksum : int or None
        CRC-32C that their bytes must have; None where that is known.
    """

    def __init__(self, rows: np.ndarray, where: Path, checksum: int | None) -> None:
        self.rows = rows
        self.where = where
        self._checksum = checksum

    def __len__(self) -> int:
        return len(self.rows)

    def check(self) -> None:
        """Compare the checksum, the first time that this is called.

        Raises
        ------
        DamagedDataError
            Names the file.
        """
        if self._checksum is None:
            return
        if crc32c(self.rows) != self._checksum:
            raise DamagedDataError(
                "vectors have a wrong checksum",
                where=self.where,
                fix="Copy the index again from its source, or build it again.",
            )
        self._checksum = None


def merge_small(blocks: list[Block]) -> list[Block]:
    """Put neighbours together that are small, once they are checked: each block has its cost."""
    merged: list[Block] = []
    waiting: list[Block] = []
    for block in [*blocks, None]:
        if block is not None and len(block) < _SMALL_BLOCK:
            waiting.append(block)
            continue
        if len(waiting) > 1:
            for one in waiting:
                one.check()
            rows = np.concatenate([one.rows for one in waiting])
            merged.append(Block(rows, waiting[0].where, None))
        else:
            merged += waiting
        waiting = []
        if block is not None:
            merged.append(block)
    return merged
