"""How much memory a Parquet file asks for, told from the headers of its pages.

A page of a few bytes can stand for two thousand million values, each a long string from the
dictionary. The file's own summary says nothing of that which a stranger could not make up; the
headers of its pages are what the reader goes by.
"""

import os
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pyarrow.parquet as pq

__all__ = ["MAX_TABLE_BYTES", "footer_mistake", "pages_mistake"]

MAX_TABLE_BYTES = 512 << 20
"""Memory that a table may take."""
_MAX_FOOTER_BYTES = 16 << 20
_MAX_HEADER_BYTES = 64 << 10
_MAX_PAGES = 100_000
_ENCODINGS = frozenset((0, 2, 3, 4, 5, 6, 8, 9))  # without 7, whose strings grow by each other
_TYPES = frozenset(("BOOLEAN", "INT32", "INT64", "FLOAT", "DOUBLE", "BYTE_ARRAY"))
_DICTIONARY_ENCODINGS = (2, 8)
_DICTIONARY_PAGE = 2
_HARMLESS_BYTES = 1 << 20
_VALUE_BYTES = 16  # of the value, its levels and its place in a list


def footer_mistake(path: Path) -> str | None:
    """Return why a file's footer should not be read; None where it can be.

    Parameters
    ----------
    path : pathlib.Path
        A Parquet file.
    """
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - 8))
        tail = file.read(8)
    if size < 12 or tail[4:] != b"PAR1":
        return "it is no Parquet file"
    length = int.from_bytes(tail[:4], "little")
    return f"its footer has {length:,} bytes" if length > _MAX_FOOTER_BYTES else None


def pages_mistake(
    path: Path,
    metadata: "pq.FileMetaData",
    *,
    columns: Collection[str] | None = None,
    groups: Collection[int] | None = None,
) -> str | None:
    """Return why a file asks for too much memory; None where it does not.

    Parameters
    ----------
    path : pathlib.Path
        A Parquet file.
    metadata : pyarrow.parquet.FileMetaData
        Its footer.
    columns : collection of str, optional
        The columns that will be read; default: all.
    groups : collection of int, optional
        The row groups that will be read; default: all.
    """
    asked = pages = 0
    with path.open("rb") as file:
        for group in range(metadata.num_row_groups) if groups is None else groups:
            for number in range(metadata.num_columns):
                column = metadata.row_group(group).column(number)
                if columns is not None and not _is_of(column.path_in_schema, columns):
                    continue
                if column.physical_type not in _TYPES:
                    return f"it has a column of {column.physical_type}"
                try:
                    for need in _needs(file, column):
                        asked += need
                        pages += 1
                        if asked > MAX_TABLE_BYTES or pages > _MAX_PAGES:
                            return "it asks for more memory than a catalog needs"
                except (ValueError, IndexError, OSError) as error:
                    return f"a page cannot be read ({error})"
    return None


def _is_of(path: str, columns: Collection[str]) -> bool:
    """Whether a path such as ``state.list.element`` is of one of some columns."""
    return any(path == name or path.startswith(f"{name}.") for name in columns)


def _needs(file: IO[bytes], column: Any) -> Iterator[int]:
    """Yield the memory that each page of a column asks for, in bytes."""
    at = column.data_page_offset
    first = column.dictionary_page_offset if column.has_dictionary_page else 0
    if first > 0 and (first < at or not at):  # a column without values has no data page
        at = first
    end = at + column.total_compressed_size
    strings = column.physical_type == "BYTE_ARRAY"
    dictionary = _Dictionary(0, 0, 0, "")
    while at < end:
        header, length = _header(file, at)
        unpacked, packed = _size(header.get(2)), _size(header.get(3))
        page = header.get(5) or header.get(8) or header.get(7) or {}
        values = _size(page.get(1))
        encoding = page.get(4 if 8 in header else 2)
        need = unpacked + values * _VALUE_BYTES
        if header.get(1) == _DICTIONARY_PAGE:
            dictionary = _Dictionary(at + length, packed, unpacked, column.compression)
        elif encoding not in _ENCODINGS:
            msg = f"encoding {encoding}"
            raise ValueError(msg)
        elif encoding in _DICTIONARY_ENCODINGS and strings:
            need += values * dictionary.longest(file, values)
        yield need
        at += length + packed


def _header(file: IO[bytes], at: int) -> tuple[dict[int, Any], int]:
    """Return a page's header and its length; most have a hundred bytes."""
    for room in (1 << 10, _MAX_HEADER_BYTES):
        file.seek(at)
        raw = file.read(room)
        with suppress(IndexError):
            return _Thrift(raw).whole()
    msg = "a header without end"
    raise ValueError(msg)


@dataclass
class _Dictionary:
    """A page of strings that other pages refer to."""

    at: int
    packed: int
    unpacked: int
    compression: str
    known: int | None = None

    def longest(self, file: IO[bytes], values: int) -> int:
        """Return the length of the longest string, or a larger number where that does no harm."""
        if values * self.unpacked <= _HARMLESS_BYTES:
            return self.unpacked
        if self.known is None:
            file.seek(self.at)
            data = _unpacked(file.read(self.packed), self.unpacked, self.compression)
            self.known = _longest(data)
        return self.known


def _size(value: object) -> int:
    if not isinstance(value, int) or value < 0:
        msg = f"a size of {value}"
        raise ValueError(msg)
    return value


def _unpacked(data: bytes, size: int, compression: str) -> bytes:
    import pyarrow as pa

    if compression == "UNCOMPRESSED":
        return data
    name = {"LZ4": "lz4_raw"}.get(compression, compression.lower())
    return bytes(pa.decompress(data, decompressed_size=size, codec=name, asbytes=True))


def _longest(data: bytes) -> int:
    """Return the length of the longest string: each comes after its length."""
    at = longest = 0
    while at + 4 <= len(data):
        length = int.from_bytes(data[at : at + 4], "little")
        longest = max(longest, length)
        at += 4 + length
    return min(longest, len(data))


class _Thrift:
    """A struct in Thrift's compact protocol, as far as the headers of pages use it."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def whole(self) -> tuple[dict[int, Any], int]:
        """Return the struct, and its length in bytes."""
        return self._struct(0), self._at

    def _byte(self) -> int:
        value = self._data[self._at]
        self._at += 1
        return value

    def _varint(self) -> int:
        value = shift = 0
        while True:
            byte = self._byte()
            value |= (byte & 0x7F) << shift
            if byte < 0x80 or shift > 63:
                return value
            shift += 7

    def _number(self) -> int:
        value = self._varint()
        return value >> 1 ^ -(value & 1)

    def _struct(self, depth: int) -> dict[int, Any]:
        if depth > 8:
            msg = "a header is nested too deeply"
            raise ValueError(msg)
        found: dict[int, Any] = {}
        field = 0
        while kind := self._byte():
            field = field + (kind >> 4) if kind >> 4 else self._number()
            found[field] = self._value(kind & 0x0F, depth)
        return found

    def _value(self, kind: int, depth: int) -> Any:
        if kind in (1, 2):  # a boolean is its type
            return kind == 1
        if kind == 3:
            return self._byte()
        if kind in (4, 5, 6):
            return self._number()
        if kind == 8:  # bytes: statistics, which nobody asks for here
            length = self._varint()
            self._at += length
            return None
        if kind == 12:
            return self._struct(depth + 1)
        msg = f"a field of type {kind}"
        raise ValueError(msg)
