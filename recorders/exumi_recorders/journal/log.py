"""Writing one log: records are appended in batches, to segments of bounded size."""

import errno
import os
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from exumi_data.store.files import sync_folder
from exumi_recorders.journal.record import HEADER_BYTES

__all__ = ["SEGMENT_BYTES", "LogWriter", "is_full", "segment_name"]

SEGMENT_BYTES = 64 << 20
_MOST_PIECES = 1024  # of one writev: IOV_MAX of Linux


def segment_name(number: int) -> str:
    """Return the file name of a segment.

    Parameters
    ----------
    number : int
    """
    return f"{number:06d}.log"


@dataclass(slots=True, eq=False)
class _Segment:
    """A file of a log that is open. One thread adds to `position`, another reads it."""

    path: Path
    descriptor: int
    position: int = 0
    flushed: int = 0


class LogWriter:
    """Append records to a log. One thread appends, another one flushes.

    Parameters
    ----------
    folder : pathlib.Path
        Made here; the first segment is durable when this returns.
    segment_bytes : int
        A segment that is this long is the last but the one that is begun then.

    Attributes
    ----------
    bytes, records : int
        What was appended, of all segments: whole records alone.
    """

    def __init__(self, folder: Path, *, segment_bytes: int = SEGMENT_BYTES) -> None:
        self.folder = folder
        self.bytes = self.records = 0
        self._segment_bytes = segment_bytes
        self._segments = 0
        self._retired: deque[_Segment] = deque()
        folder.mkdir()
        self._current = self._begin()
        os.fsync(self._current.descriptor)
        sync_folder(folder)
        self._named = self._current
        self._closed = False

    def _begin(self) -> _Segment:
        path = self.folder / segment_name(self._segments)
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW
        segment = _Segment(path, os.open(path, flags, 0o644))
        self._segments += 1
        return segment

    def append(self, pieces: Sequence[bytes]) -> None:
        """Append records with as few system calls as may be.

        Parameters
        ----------
        pieces : sequence of bytes
            Header, payload, header, payload ...

        Raises
        ------
        OSError
            Nothing more can be written, as when the disk is full. Whole records that were written
            stay, the rest of one is cut off.
        """
        if self._closed:
            raise OSError(errno.EBADF, "the log is closed", str(self.folder))
        for start in range(0, len(pieces), _MOST_PIECES):
            if self._current.position >= self._segment_bytes:
                begun = self._begin()
                self._retired.append(self._current)
                self._current = begun
            self._write(self._current, pieces[start : start + _MOST_PIECES])

    def _write(self, segment: _Segment, pieces: Sequence[bytes]) -> None:
        total = sum(map(len, pieces))
        done = 0
        try:
            done = os.writev(segment.descriptor, pieces)
            while done < total:
                done += os.write(segment.descriptor, _from(pieces, done))
        except OSError:
            records, length = _whole_records(pieces, done)
            whole = segment.position + length
            os.ftruncate(segment.descriptor, whole)
            os.lseek(segment.descriptor, whole, os.SEEK_SET)
            self._count(segment, records, length)
            raise
        self._count(segment, len(pieces) // 2, total)

    def _count(self, segment: _Segment, records: int, length: int) -> None:
        segment.position += length
        self.bytes += length
        self.records += records

    def flush(self) -> list[tuple[Path, int]]:
        """Make what was appended survive a power loss; for one thread beside the appending one.

        Returns
        -------
        list of (pathlib.Path, int)
            Segments, and how many bytes of each are now known to be safe.

        Raises
        ------
        OSError
            The disk reports that it could not.
        """
        done = []
        # Looked up first: what is retired after this is flushed the next time.
        current = self._current
        while self._retired and self._retired[0] is not current:
            segment = self._retired[0]
            done += self._flush(segment)
            os.close(segment.descriptor)
            self._retired.popleft()
        return done + self._flush(current)

    def _flush(self, segment: _Segment) -> list[tuple[Path, int]]:
        # Looked up first: what is appended meanwhile may be flushed as well, but is not claimed.
        length = segment.position
        if length == segment.flushed:
            return []
        os.fdatasync(segment.descriptor)
        if self._named is not segment:
            sync_folder(self.folder)
            self._named = segment
        segment.flushed = length
        return [(segment.path, length)]

    def close(self) -> list[tuple[Path, int]]:
        """Flush and close; nobody else may use the log any more. Returns as `flush`."""
        if self._closed:
            return []
        self._closed = True
        try:
            return self.flush()
        finally:
            for segment in (*self._retired, self._current):
                os.close(segment.descriptor)
            self._retired.clear()


def is_full(error: OSError) -> bool:
    """Whether an error says that there is no room: of the disk, of a quota, of a file's size.

    Parameters
    ----------
    error : OSError
    """
    return error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def _from(pieces: Sequence[bytes], start: int) -> memoryview:
    """Return the rest of the piece that the byte `start` of all pieces lies in."""
    for piece in pieces:
        if start < len(piece):
            return memoryview(piece)[start:]
        start -= len(piece)
    return memoryview(b"")


def _whole_records(pieces: Sequence[bytes], done: int) -> tuple[int, int]:
    """Return how many records are whole in the first `done` bytes, and how long these are."""
    length = 0
    for index in range(0, len(pieces), 2):
        end = length + HEADER_BYTES + len(pieces[index + 1])
        if end > done:
            return index // 2, length
        length = end
    return len(pieces) // 2, length
