"""A video file inside an array, read in pieces."""

import hashlib
import io
import os
from typing import IO, cast

from exumi_data.store.shards import ArrayReader

__all__ = ["VideoFileReader", "looks_like", "open_file", "sha256_of"]

_SMALL_BYTES = 4 << 20
_PIECE = 1 << 20
_QUICKTIME_ATOMS = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip", b"pnot")


class VideoFileReader(io.RawIOBase):
    """A binary file over a range of an array of bytes: nothing is read that is not asked for.

    Parameters
    ----------
    data : ArrayReader
        One-dimensional uint8.
    start, stop : int
        The file's bytes.
    """

    def __init__(self, data: ArrayReader, start: int, stop: int) -> None:
        self._data = data
        self._start = start
        self._size = stop - start
        self._position = 0

    def readable(self) -> bool:
        """Return True."""
        return True

    def seekable(self) -> bool:
        """Return True."""
        return True

    def tell(self) -> int:
        """Return the position in the file."""
        return self._position

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a position.

        Parameters
        ----------
        offset : int
        whence : int
            As in `io.IOBase.seek`.
        """
        base = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._size}[whence]
        self._position = max(0, base + offset)
        return self._position

    def read(self, size: int = -1) -> bytes:
        """Return the next bytes.

        Parameters
        ----------
        size : int
            At most; -1 for all that is left.
        """
        left = max(0, self._size - self._position)
        length = left if size < 0 else min(size, left)
        data = self._data.bytes_at(self._start + self._position, length) if length else b""
        self._position += len(data)
        return data


def open_file(data: ArrayReader, start: int, stop: int) -> IO[bytes]:
    """Open a file that lies in an array of bytes; a small one is read into memory at once.

    Parameters
    ----------
    data : ArrayReader
        Of bytes.
    start, stop : int
        Where the file begins and ends in it.
    """
    if stop - start <= _SMALL_BYTES:
        return io.BytesIO(data.bytes_at(start, stop - start))
    return cast("IO[bytes]", VideoFileReader(data, start, stop))


def sha256_of(file: IO[bytes]) -> str:
    """Return the digest of a whole file.

    Parameters
    ----------
    file : binary file
    """
    state = hashlib.sha256()
    file.seek(0)
    while piece := file.read(_PIECE):
        state.update(piece)
    return state.hexdigest()


def looks_like(head: bytes, media_type: str) -> bool:
    """Whether a file begins as its media type does.

    Asked before the file is opened: some text formats that a video library also opens name
    other files to read.

    Parameters
    ----------
    head : bytes
        The first twelve bytes.
    media_type : str
        One of those that the format has.
    """
    if media_type in ("video/mp4", "video/quicktime"):
        return head[4:8] in _QUICKTIME_ATOMS
    if media_type == "video/x-msvideo":
        return head[:4] == b"RIFF" and head[8:11] == b"AVI"
    return head[:4] == b"\x1a\x45\xdf\xa3"
