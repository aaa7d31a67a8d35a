"""Where the members of a large zip are: its directory read in pieces, 29 bytes kept a member.

Python's own reader keeps an object of some 500 bytes for each member, and a buffer of 100 GB has
millions of them, one or more for each frame.
"""

import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from exumi_data.errors import LimitError, SourceError

__all__ = ["CHUNK", "Member", "ZipIndex", "is_zip", "iter_names", "read_index", "read_member"]

CHUNK = np.dtype(
    [
        ("row", "<i8"),
        ("offset", "<u8"),
        ("size", "<u4"),
        ("full", "<u4"),
        ("crc", "<u4"),
        ("method", "u1"),
    ]
)
"""One chunk of an array: the first of its numbers, and where its bytes are."""

_ROW = struct.Struct("<qQIIIB")
_END = struct.Struct("<4s4H2LH")
_END64 = struct.Struct("<4sQ2H2L4Q")
_LOCATOR = struct.Struct("<4sLQL")
_ENTRY = struct.Struct("<4s6H3L5H2L")
_LOCAL = struct.Struct("<4s5H3L2H")
_END_SIGNATURE = b"PK\5\6"
_STORED, _DEFLATED = 0, 8
_ENCRYPTED = 1
_LARGE, _LARGE_SHORT = 0xFFFFFFFF, 0xFFFF
_PIECE = 4 << 20
_MAX_DIRECTORY = 1 << 30
_DOCUMENTS = (".zarray", ".zattrs", ".zgroup", ".zmetadata")
_MAX_DOCUMENTS = 10_000
_MAX_GROUPS = 20_000
MAX_MEMBER = 1 << 28
"""Most bytes of one member, unpacked."""


class Member(NamedTuple):
    """A record of type `CHUNK`."""

    row: int
    offset: int
    size: int
    full: int
    crc: int
    method: int


class _Entry(NamedTuple):
    name: str
    flags: int
    method: int
    crc: int
    size: int
    full: int
    offset: int


@dataclass(slots=True)
class ZipIndex:
    """What is in a zip of Zarr v2 arrays.

    Attributes
    ----------
    documents : dict of str to ndarray
        Members that are documents of Zarr, by name, each one record of type `CHUNK`.
    chunks : dict of (str, str) to ndarray
        Members that are chunks, by the array's path and the chunk's numbers but the first
        (``"0.0.0"``); records of type `CHUNK`, ascending.
    """

    documents: dict[str, np.ndarray] = field(default_factory=dict)
    chunks: dict[tuple[str, str], np.ndarray] = field(default_factory=dict)


def is_zip(path: Path) -> bool:
    """Whether a file begins as a zip does; its name says nothing. No pipe is waited for."""
    if not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            return file.read(4) in (b"PK\3\4", _END_SIGNATURE)
    except OSError:
        return False


def iter_names(path: Path, most_bytes: int) -> Iterator[str]:
    """Yield names of members, from the directory's first so many bytes."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        start, size = _find_directory(descriptor, path)
        for entry in _entries(descriptor, start, min(size, most_bytes), path, whole=False):
            yield entry.name
    finally:
        os.close(descriptor)


def read_index(path: Path) -> ZipIndex:
    """Read a zip's directory.

    Parameters
    ----------
    path : pathlib.Path

    Raises
    ------
    SourceError
        It is damaged, or of a kind that cannot be read.
    LimitError
        It claims more than memory is taken for.
    """
    descriptor = os.open(path, os.O_RDONLY)
    try:
        start, size = _find_directory(descriptor, path)
        if size > _MAX_DIRECTORY:
            raise LimitError(f"its directory is {size:,} bytes", where=path)
        return _collect(_entries(descriptor, start, size, path, whole=True), path)
    finally:
        os.close(descriptor)


def _collect(entries: Iterator[_Entry], path: Path) -> ZipIndex:
    index = ZipIndex()
    groups: dict[tuple[str, str], bytearray] = {}
    for entry in entries:
        folder, _, last = entry.name.rpartition("/")
        position = _chunk_position(folder, last)
        if position is None and last not in _DOCUMENTS:  # a folder, or a file of something else
            continue
        _check(entry, path)
        record = _ROW.pack(0, entry.offset, entry.size, entry.full, entry.crc, entry.method)
        if position is None:
            index.documents[entry.name] = np.frombuffer(record, CHUNK)
            if len(index.documents) > _MAX_DOCUMENTS:
                raise LimitError(f"more than {_MAX_DOCUMENTS:,} documents of arrays", where=path)
            continue
        array, row, rest = position
        group = groups.get((array, rest))
        if group is None:
            if len(groups) >= _MAX_GROUPS:
                raise LimitError(
                    f"arrays of more than {_MAX_GROUPS:,} chunks a row in all", where=path
                )
            group = groups[array, rest] = bytearray()
        group += row.to_bytes(8, "little") + record[8:]
    for key in list(groups):  # each is let go as soon as it is sorted
        index.chunks[key] = _ascending(np.frombuffer(groups.pop(key), CHUNK))
    return index


def _chunk_position(folder: str, last: str) -> tuple[str, int, str] | None:
    """Split a name into array, first number and other numbers; None if it is no chunk's."""
    if "." in last:
        first, _, rest = last.partition(".")
        return (folder, int(first), rest) if _is_number(first) and _are_numbers(rest) else None
    if not _is_number(last):
        return None
    numbers = [last]
    while _is_number((parts := folder.rpartition("/"))[2]) and parts[0]:
        folder = parts[0]
        numbers.insert(0, parts[2])
    return folder, int(numbers[0]), ".".join(numbers[1:])


def _is_number(text: str) -> bool:
    """Whether a text is a number as Zarr writes it: any other would stand for the same chunk."""
    digits = text.isdecimal() and text.isascii() and len(text) < 18
    return digits and (text[0] != "0" or len(text) == 1)


@lru_cache(maxsize=256)  # all rows have the same few
def _are_numbers(text: str) -> bool:
    return all(map(_is_number, text.split(".")))


def _ascending(table: np.ndarray) -> np.ndarray:
    """Sort by row; of members of one name the last counts, as in every reader of zips."""
    rows = table["row"]
    if (rows[1:] > rows[:-1]).all():
        return table
    table = table[np.argsort(rows, kind="stable")]
    rows = table["row"]
    last = np.append(rows[1:] != rows[:-1], True)
    return table if last.all() else table[last]


def _find_directory(descriptor: int, path: Path) -> tuple[int, int]:
    """Return where the directory begins, and its size."""
    length = os.fstat(descriptor).st_size
    tail_start = max(0, length - _END.size - 0xFFFF)
    tail = os.pread(descriptor, length - tail_start, tail_start)
    at = tail.rfind(_END_SIGNATURE)
    if at < 0 or at + _END.size > len(tail):
        raise _damaged(path, "its directory is missing: the file is cut short or is no zip")
    *_, size, start, _ = _END.unpack_from(tail, at)
    locator = at - _LOCATOR.size
    if locator >= 0 and tail.startswith(b"PK\6\7", locator):
        position = _LOCATOR.unpack_from(tail, locator)[2]
        end = os.pread(descriptor, _END64.size, position) if position < length else b""
        if len(end) < _END64.size or not end.startswith(b"PK\6\6"):
            raise _damaged(path, "the end of its directory is damaged")
        *_, size, start = _END64.unpack(end)
    if start + size > length:
        raise _damaged(path, "its directory lies beyond the end of the file")
    return start, size


def _entries(
    descriptor: int, start: int, size: int, path: Path, *, whole: bool
) -> Iterator[_Entry]:
    position, end, buffer, at = start, start + size, b"", 0
    while True:
        if len(buffer) - at < _ENTRY.size + 3 * _LARGE_SHORT and position < end:
            piece = os.pread(descriptor, min(_PIECE, end - position), position)
            if not piece:
                raise _damaged(path, "its directory is cut short")
            position += len(piece)
            buffer, at = buffer[at:] + piece, 0
        if at == len(buffer):
            return
        if len(buffer) - at < _ENTRY.size or not buffer.startswith(b"PK\1\2", at):
            if whole:
                raise _damaged(path, "its directory is damaged")
            return
        fields = _ENTRY.unpack_from(buffer, at)
        flags, method, crc, packed, full = fields[3], fields[4], *fields[7:10]
        name_length, extra_length, comment_length = fields[10:13]
        begin = at + _ENTRY.size
        at = begin + name_length + extra_length + comment_length
        if at > len(buffer):
            if whole:
                raise _damaged(path, "its directory is damaged")
            return
        name = buffer[begin : begin + name_length].decode("utf-8", "replace")
        extra = buffer[begin + name_length : begin + name_length + extra_length]
        entry = _Entry(name, flags, method, crc, packed, full, fields[16])
        yield _large(entry, extra) if _LARGE in (packed, full, fields[16]) else entry


def _check(entry: _Entry, path: Path) -> None:
    """Refuse what cannot be read."""
    where = f"{path}: {entry.name[:200]}"
    if entry.flags & _ENCRYPTED or entry.method not in (_STORED, _DEFLATED):
        raise SourceError(
            "a member is encrypted or packed by a method that is not read",
            where=where,
            fix="Unpack the zip, and convert the folder.",
        )
    if max(entry.size, entry.full) > MAX_MEMBER:
        raise LimitError(f"a member of {max(entry.size, entry.full):,} bytes", where=where)


def _large(entry: _Entry, extra: bytes) -> _Entry:
    """Replace what does not fit into 32 bits by what the field for large files says."""
    at = 0
    while at + 4 <= len(extra):
        kind, length = struct.unpack_from("<2H", extra, at)
        at += 4
        if kind == 1:
            count = min(length, len(extra) - at) // 8
            numbers = iter(struct.unpack_from(f"<{count}Q", extra, at))
            full, size, offset = (
                next(numbers, value) if value == _LARGE else value
                for value in (entry.full, entry.size, entry.offset)
            )
            return entry._replace(full=full, size=size, offset=offset)
        at += length
    return entry


def read_member(descriptor: int, member: Member, where: object) -> bytes:
    """Read a member's content and check it.

    Parameters
    ----------
    descriptor : int
        Of the open zip.
    member : Member
    where : object
        Named in errors.

    Raises
    ------
    SourceError
        It is damaged.
    """
    # One read gets most members whole: the local header is seldom longer than this.
    data = os.pread(descriptor, member.size + 128, member.offset)
    if len(data) < _LOCAL.size or not data.startswith(b"PK\3\4"):
        raise _damaged(where, "no member begins where the directory says")
    *_, name_length, extra_length = _LOCAL.unpack_from(data)
    begin = _LOCAL.size + name_length + extra_length
    if begin + member.size > len(data):
        data, begin = os.pread(descriptor, member.size, member.offset + begin), 0
    content = data[begin : begin + member.size]
    if len(content) < member.size:
        raise _damaged(where, "a member is cut short")
    if member.method == _DEFLATED:
        content = _inflate(content, member.full, where)
    if len(content) != member.full or zlib.crc32(content) != member.crc:
        raise _damaged(where, "a member's checksum is wrong")
    return content


def _inflate(content: bytes, full: int, where: object) -> bytes:
    try:
        return zlib.decompressobj(-15).decompress(content, full + 1)
    except zlib.error as error:
        raise _damaged(where, f"a member cannot be unpacked ({error})") from None


def _damaged(where: object, what: str) -> SourceError:
    return SourceError(what, where=where, fix="Get the file again from its source.")
