"""A part of an array's bytes as a file: what is large is read where it is needed, not whole."""

import io
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from typing import IO

    from exumi_data.store.shards import ArrayReader

__all__ = ["open_bytes"]

_PIECE_BYTES = 1 << 20


def open_bytes(array: "ArrayReader", start: int, stop: int) -> "IO[bytes]":
    """Open bytes of an array for reading, 1 MiB at a time.

    Parameters
    ----------
    array : ArrayReader
    start, stop : int
        Which of its bytes.

    Returns
    -------
    binary file
        Seekable. Reading raises what `ArrayReader.bytes_at` does.
    """
    raw = _ArrayFile(array, start, stop)
    return cast("IO[bytes]", io.BufferedReader(raw, _PIECE_BYTES))


class _ArrayFile(io.RawIOBase):
    def __init__(self, array: "ArrayReader", start: int, stop: int) -> None:
        self._array = array
        self._start = start
        self._size = stop - start
        self._at = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._size}.get(whence)
        if base is None or base + offset < 0:
            msg = "no such place"
            raise OSError(msg)
        self._at = base + offset
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, out: "memoryview") -> int:  # type: ignore[override]  # any buffer has these
        length = max(0, min(len(out), self._size - self._at))
        if length:
            out[:length] = self._array.bytes_at(self._start + self._at, length)
            self._at += length
        return length
