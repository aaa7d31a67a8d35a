"""Arrays in a layout that the fast reader does not take: read through zarr-python."""

import math
from typing import Any

import numpy as np

from exumi_data.errors import DamagedDataError, ExumiError, LimitError, UnsupportedError
from exumi_data.store.access import Store
from exumi_data.store.zarr_document import DTYPES, MAX_CHUNK_BYTES

__all__ = ["MAX_WHOLE_READ", "ZarrReader"]

MAX_WHOLE_READ = 2 << 30
"""Bytes of an array that are read at once."""
_MAX_CHUNKS_AT_ONCE = 1 << 20


class ZarrReader:
    """Read an array in any other layout, through zarr-python.

    Parameters
    ----------
    store : Store
    path : str
        The array's path inside the store.

    Raises
    ------
    DamagedDataError
        zarr-python cannot open it, or it is no array of rows.
    UnsupportedError
        A data type that the format does not have.
    LimitError
        A chunk of more than 256 MiB.
    """

    def __init__(self, store: Store, path: str) -> None:
        import zarr  # slow to import, and rarely needed

        from exumi_data.store.zarr_backing import ZarrBacking

        self._where = f"{store.location}/{path}"
        try:
            array = zarr.open_array(ZarrBacking(store), path=path, mode="r", zarr_format=3)
        except ExumiError:
            raise
        except Exception as error:
            raise DamagedDataError(
                f"zarr-python cannot open the array ({error})", where=self._where
            ) from error
        if array.dtype.name not in DTYPES:
            raise UnsupportedError(f"an array of {array.dtype}", where=self._where)
        self._array: Any = array
        self.shape: tuple[int, ...] = tuple(array.shape)
        self.dtype: np.dtype[Any] = array.dtype.newbyteorder("<")
        if not self.shape or 0 in self.shape[1:] or 0 in array.chunks:
            raise DamagedDataError(f"shape {self.shape} has no rows", where=self._where)
        chunk_bytes = math.prod(array.chunks) * self.dtype.itemsize
        if chunk_bytes > MAX_CHUNK_BYTES:
            raise LimitError(f"a chunk of {chunk_bytes:,} bytes", where=self._where)
        self._row_bytes = math.prod(self.shape[1:]) * self.dtype.itemsize

    def check_shards(self) -> None:
        """Check nothing: zarr-python cannot tell a missing chunk from zeros."""

    def rows(self, start: int, stop: int) -> np.ndarray:
        """Return rows [start, stop).

        Raises
        ------
        DamagedDataError
            They cannot be read, or lie outside the array.
        LimitError
            They are more than 2 GiB, or lie in more than 2**20 chunks.
        """
        if not 0 <= start <= stop <= self.shape[0]:
            raise DamagedDataError(
                f"rows {start} to {stop} lie outside the array ({self.shape[0]})",
                where=self._where,
            )
        across, *others = self._array.chunks
        chunks = (stop // across - start // across + 1) * math.prod(
            -(-size // chunk) for size, chunk in zip(self.shape[1:], others, strict=True)
        )
        if (stop - start) * self._row_bytes > MAX_WHOLE_READ or chunks > _MAX_CHUNKS_AT_ONCE:
            raise LimitError(
                f"{(stop - start) * self._row_bytes:,} bytes in {chunks:,} chunks are too many to "
                "be read at once",
                where=self._where,
            )
        try:
            values = np.asarray(self._array[start:stop])
        except ExumiError:
            raise
        except Exception as error:
            raise DamagedDataError(f"cannot be read ({error})", where=self._where) from error
        return np.ascontiguousarray(values, dtype=self.dtype)

    def bytes_at(self, start: int, length: int) -> bytes:
        """Return `length` bytes of the array's memory, from byte `start`."""
        first = start // self._row_bytes
        last = -(-(start + length) // self._row_bytes) if length else first
        data = self.rows(first, last).tobytes()
        return data[start - first * self._row_bytes :][:length]

    def read(self) -> np.ndarray:
        """Return the whole array."""
        return self.rows(0, self.shape[0])
