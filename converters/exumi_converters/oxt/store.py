"""A Zarr v2 folder, written file by file: frames one by one, numbers in blocks."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["NumberArray", "chunk_name", "encode", "write_array", "write_group"]

_LEVEL = 3
_BLOCK_BYTES = 1 << 20
_COMPRESSOR = {"id": "zstd", "level": _LEVEL}


def encode(values: np.ndarray) -> bytes:
    """Compress a chunk; the same numbers give the same bytes on every machine.

    Parameters
    ----------
    values : ndarray
        C-contiguous.
    """
    from numcodecs import Zstd

    # Smaller and faster for images than what FTP-1 itself writes (Blosc with bitshuffle), whose
    # threads moreover write blocks in the order in which they happen to be done.
    return bytes(Zstd(level=_LEVEL).encode(np.ascontiguousarray(values).reshape(-1).view(np.uint8)))


def chunk_name(row: int, *piece: int, dimensions: int) -> str:
    """Return the name of a chunk.

    Parameters
    ----------
    row : int
        Its number along the first axis.
    *piece : int
        Along the axes after it; 0 along the others.
    dimensions : int
    """
    numbers = (row, *piece)
    return ".".join(map(str, (*numbers, *(0,) * (dimensions - len(numbers)))))


def write_group(folder: Path, attributes: Mapping[str, Any] | None = None) -> None:
    """Make a group."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / ".zgroup").write_bytes(_json({"zarr_format": 2}))
    if attributes is not None:
        (folder / ".zattrs").write_bytes(_json(attributes))


def write_array(
    folder: Path, shape: tuple[int, ...], chunks: tuple[int, ...], dtype: np.dtype[Any]
) -> None:
    """Describe an array whose chunks are there, or will be."""
    folder.mkdir(parents=True, exist_ok=True)
    document = {
        "zarr_format": 2,
        "shape": list(shape),
        "chunks": list(chunks),
        "dtype": dtype.str,
        "compressor": _COMPRESSOR,
        "fill_value": "" if dtype.kind == "U" else 0.0 if dtype.kind == "f" else 0,
        "order": "C",
        "filters": None,
        "dimension_separator": ".",
    }
    (folder / ".zarray").write_bytes(_json(document))


def _json(value: Mapping[str, Any]) -> bytes:
    text = json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False, sort_keys=True)
    return (text + "\n").encode()


class NumberArray:
    """An array that grows by rows; a chunk is written when it is full.

    Parameters
    ----------
    folder : pathlib.Path
        Of the array; made.
    row : tuple of int
        Shape of a row.
    dtype : numpy.dtype
    length : int
        How many rows there will be: chunks are not longer.
    """

    def __init__(
        self, folder: Path, row: tuple[int, ...], dtype: np.dtype[Any], length: int
    ) -> None:
        self._folder = folder
        self._length = length
        row_bytes = max(1, math.prod(row) * dtype.itemsize)
        rows = max(1, min(length, _BLOCK_BYTES // row_bytes))
        self._buffer = np.zeros((rows, *row), dtype)
        self._filled = 0
        self._number = 0
        write_array(folder, (length, *row), self._buffer.shape, dtype)

    def append(self, values: np.ndarray) -> None:
        """Append rows.

        Parameters
        ----------
        values : (n, ...) ndarray
        """
        done = 0
        while done < len(values):
            count = min(len(values) - done, len(self._buffer) - self._filled)
            self._buffer[self._filled : self._filled + count] = values[done : done + count]
            self._filled += count
            done += count
            if self._filled == len(self._buffer):
                self._flush()

    def repeat(self, value: object, count: int) -> None:
        """Append the same row again and again."""
        block = np.empty(
            (min(count, len(self._buffer)), *self._buffer.shape[1:]), self._buffer.dtype
        )
        block[...] = value
        while count > 0:
            self.append(block[:count])
            count -= len(block)

    def finish(self) -> None:
        """Write what is left."""
        if self._filled:
            self._buffer[self._filled :] = np.zeros((), self._buffer.dtype)
            self._flush()

    def _flush(self) -> None:
        name = chunk_name(self._number, dimensions=self._buffer.ndim)
        (self._folder / name).write_bytes(encode(self._buffer))
        self._number += 1
        self._filled = 0
