"""Reading a log back: every record that is whole, whatever lies between them.

A record counts when its checksum is right and its number is higher than the one before. Where that
is not so, the next one is searched by its magic, and what was passed over is reported.
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from exumi_recorders.journal.log import segment_name
from exumi_recorders.journal.record import (
    HEADER_BYTES,
    MAGIC,
    MAX_PAYLOAD_BYTES,
    Header,
    checksum_of,
    header_dtype,
    unpack_header,
)

__all__ = ["Block", "Damage", "LogReader"]

_PIECE = 1 << 20
_BLOCK_BYTES = 8 << 20
_BLOCK_RECORDS = 256
_ROWS = 8192
_MAGIC_NUMBER = np.uint32(int.from_bytes(MAGIC, "little"))
# A file that is all magics would have each of them read as a record of many megabytes.
_MOST_SEARCHED = 16
_DIGITS = 6


@dataclass(frozen=True, slots=True)
class Damage:
    """A part of a log that holds no whole record.

    Attributes
    ----------
    path : pathlib.Path
        The segment.
    offset, bytes : int
        Where it begins, and how long it is.
    lost : int or None
        How many records are missing there, by the numbers around it (those that were dropped when
        the disk could not keep up included); None where nothing follows.
    what : str
    """

    path: Path
    offset: int
    bytes: int
    lost: int | None
    what: str


@dataclass(slots=True, eq=False)
class Block:
    """Records in the order of the log.

    Attributes
    ----------
    seq : (N,) uint64
    time_host, time_device, sequence : (N,) int64
        `NONE` where there is none.
    flags : (N,) uint32
    damaged : (N,) bool
        Whether something was passed over before a record.
    files : list of bytes
        Payloads, of logs whose records have no fixed length.
    rows : (N, L) uint8 or None
        Payloads, of logs whose records have the fixed length L.
    """

    seq: npt.NDArray[np.uint64]
    time_host: npt.NDArray[np.int64]
    time_device: npt.NDArray[np.int64]
    sequence: npt.NDArray[np.int64]
    flags: npt.NDArray[np.uint32]
    damaged: npt.NDArray[np.bool_]
    files: list[bytes] = field(default_factory=list)
    rows: npt.NDArray[np.uint8] | None = None

    def __len__(self) -> int:
        return len(self.seq)


class LogReader:
    """Read a log in blocks; memory stays at a block, whatever a length claims.

    Parameters
    ----------
    folder : pathlib.Path
    salt : int
        See `exumi_recorders.journal.record.salt_of`.
    payload_bytes : int, optional
        Length of all payloads, where they have one.

    Attributes
    ----------
    damages : list of Damage
        Found so far.
    records : int
        Read so far.
    """

    def __init__(self, folder: Path, salt: int, payload_bytes: int | None = None) -> None:
        self.damages: list[Damage] = []
        self.records = 0
        self._folder = folder
        self._salt = salt
        self._fixed = payload_bytes
        self._last_seq = -1
        self._open_damage = False

    def __iter__(self) -> Iterator[Block]:
        expected = 0
        for number in self._numbers():
            if number > expected:
                self._missing(expected)
            expected = number + 1
            with _Segment(self._folder / segment_name(number)) as segment:
                yield from self._read(segment)

    def _numbers(self) -> list[int]:
        """Return the numbers of the segments, in order."""
        try:
            with os.scandir(self._folder) as entries:
                names = [entry.name for entry in entries if _is_segment(entry)]
        except FileNotFoundError:
            self.damages.append(Damage(self._folder, 0, 0, None, "the log is not there"))
            return []
        if not names:
            self._missing(0)
        return sorted(int(name[:_DIGITS]) for name in names)

    def _missing(self, number: int) -> None:
        path = self._folder / segment_name(number)
        self.damages.append(Damage(path, 0, 0, None, "the segment is not there"))
        self._open_damage = True

    def _read(self, segment: "_Segment") -> Iterator[Block]:
        if self._fixed is not None:
            yield from self._read_rows(segment, self._fixed)
        else:
            yield from self._read_files(segment)

    # ----------------------------------------------------------------- records of one fixed length

    def _read_rows(self, segment: "_Segment", payload_bytes: int) -> Iterator[Block]:
        dtype = header_dtype(payload_bytes)
        size = dtype.itemsize
        rows = max(1, min(_ROWS, _BLOCK_BYTES // size))
        offset = 0
        while offset < segment.size:
            raw = segment.read(offset, rows * size)
            found = np.frombuffer(raw, dtype, count=len(raw) // size)
            good = self._good_rows(found, raw, payload_bytes)
            if good:
                yield self._block_of(found[:good])
                offset += good * size
            if good < len(found) or len(raw) < rows * size:
                if offset >= segment.size:
                    return
                offset = self._resync(segment, offset)

    def _good_rows(self, found: np.ndarray, raw: bytes, payload_bytes: int) -> int:
        """Return how many rows from the first on are whole and follow each other."""
        fits = (found["magic"] == _MAGIC_NUMBER) & (found["length"] == payload_bytes)
        seq = found["seq"]
        fits[1:] &= seq[1:] > seq[:-1]
        if len(seq):
            fits[0] &= int(seq[0]) > self._last_seq
        count = len(fits) if fits.all() else int(np.argmin(fits))
        view, salt, size = memoryview(raw), self._salt, found.dtype.itemsize
        sums = [
            checksum_of(salt, view[at : at + HEADER_BYTES], view[at + HEADER_BYTES : at + size])
            for at in range(0, count * size, size)
        ]
        right = found["checksum"][:count] == np.array(sums, np.uint32)
        return count if right.all() else int(np.argmin(right))

    def _block_of(self, found: np.ndarray) -> Block:
        damaged = np.zeros(len(found), np.bool_)
        damaged[0] = self._close_damage(int(found["seq"][0]))
        self._last_seq = int(found["seq"][-1])
        self.records += len(found)
        return Block(
            found["seq"].astype(np.uint64),
            found["time_host"].astype(np.int64),
            found["time_device"].astype(np.int64),
            found["sequence"].astype(np.int64),
            found["flags"].astype(np.uint32),
            damaged,
            rows=np.ascontiguousarray(found["payload"]),
        )

    # ------------------------------------------------------------------ records of various lengths

    def _read_files(self, segment: "_Segment") -> Iterator[Block]:
        headers: list[Header] = []
        files: list[bytes] = []
        damaged: list[bool] = []
        offset = size = 0
        while offset < segment.size:
            record = self._record_at(segment, offset)
            if record is None:
                offset = self._resync(segment, offset)
                continue
            header, payload = record
            damaged.append(self._close_damage(header.seq))
            self._last_seq = header.seq
            headers.append(header)
            files.append(payload)
            offset += HEADER_BYTES + header.length
            size += header.length
            if len(headers) >= _BLOCK_RECORDS or size >= _BLOCK_BYTES:
                yield self._block(headers, files, damaged)
                headers, files, damaged, size = [], [], [], 0
        if headers:
            yield self._block(headers, files, damaged)

    def _block(self, headers: list[Header], files: list[bytes], damaged: list[bool]) -> Block:
        self.records += len(headers)
        return Block(
            np.array([header.seq for header in headers], np.uint64),
            np.array([header.time_host_ns for header in headers], np.int64),
            np.array([header.time_device for header in headers], np.int64),
            np.array([header.sequence for header in headers], np.int64),
            np.array([header.flags for header in headers], np.uint32),
            np.array(damaged, np.bool_),
            files,
        )

    def _record_at(self, segment: "_Segment", offset: int) -> tuple[Header, bytes] | None:
        """Return the record at an offset, if there is a whole one that may come next."""
        raw = segment.read(offset, HEADER_BYTES)
        header = unpack_header(raw)
        if header is None or not self._may_follow(header, segment.size - offset):
            return None
        payload = segment.read(offset + HEADER_BYTES, header.length)
        if len(payload) < header.length or checksum_of(self._salt, raw, payload) != header.checksum:
            return None
        return header, payload

    def _may_follow(self, header: Header, room: int) -> bool:
        fits = header.length <= min(MAX_PAYLOAD_BYTES, room - HEADER_BYTES)
        return fits and header.seq > self._last_seq and self._fixed in (None, header.length)

    # ------------------------------------------------------------------------------------- damages

    def _resync(self, segment: "_Segment", offset: int) -> int:
        """Report what begins at an offset; return where the next whole record is, or the end."""
        found = self._search(segment, offset + 1)
        self.damages.append(
            Damage(segment.path, offset, found - offset, None, _what(segment, offset, found))
        )
        self._open_damage = True
        return found

    def _search(self, segment: "_Segment", start: int) -> int:
        searched = 0
        for at in _magics(segment, start):
            header = unpack_header(segment.read(at, HEADER_BYTES))
            if header is None or not self._may_follow(header, segment.size - at):
                continue
            searched += header.length
            if searched > _MOST_SEARCHED * max(segment.size, MAX_PAYLOAD_BYTES):
                return segment.size
            if self._record_at(segment, at) is not None:
                return at
        return segment.size

    def _close_damage(self, seq: int) -> bool:
        """Say how many records an open damage cost, now that one follows it."""
        if not self._open_damage:
            return False
        self._open_damage = False
        last = self.damages[-1]
        lost = seq - self._last_seq - 1
        self.damages[-1] = Damage(last.path, last.offset, last.bytes, lost, last.what)
        return True


class _Segment:
    """A segment that is open; its size is that of the file, which nobody else changes."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
        self.size = os.fstat(self._descriptor).st_size

    def read(self, offset: int, length: int) -> bytes:
        """Return bytes; fewer at the end of the file."""
        return os.pread(self._descriptor, length, offset)

    def __enter__(self) -> "_Segment":
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._descriptor)


def _magics(segment: _Segment, start: int) -> Iterator[int]:
    """Yield where magics are, from an offset on."""
    while start < segment.size:
        # The last ones of a piece may go over its end.
        piece = segment.read(start, _PIECE + len(MAGIC) - 1)
        at = piece.find(MAGIC)
        while at >= 0:
            yield start + at
            at = piece.find(MAGIC, at + 1)
        start += _PIECE


def _what(segment: _Segment, start: int, stop: int) -> str:
    if not segment.read(start, min(stop - start, _PIECE)).strip(b"\0"):
        return "zeros"
    return "no whole record follows" if stop == segment.size else "no record"


def _is_segment(entry: "os.DirEntry[str]") -> bool:
    digits, dot, suffix = entry.name.partition(".")
    named = len(digits) == _DIGITS and digits.isascii() and digits.isdigit()
    return named and dot + suffix == ".log" and entry.is_file(follow_symlinks=False)
