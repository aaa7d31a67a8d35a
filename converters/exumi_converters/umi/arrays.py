"""The arrays of a replay buffer, in a folder or a zip: rows of one episode, read when asked for."""

import json
import math
import os
import weakref
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from exumi_converters.umi.chunk_codecs import check_codec, check_filters, decode_chunk
from exumi_converters.umi.zip_index import Member, ZipIndex, is_zip, read_index, read_member
from exumi_data.errors import (
    ExumiError,
    LimitError,
    MissingExtraError,
    SourceError,
    UnsupportedError,
)
from exumi_data.store.access import FolderStore

__all__ = ["EPISODE_ENDS", "ArrayMeta", "Block", "Buffer", "Rows", "open_buffer"]

EPISODE_ENDS = "meta/episode_ends"
_MAX_DOCUMENT = 1 << 20
_MAX_CHUNK = 1 << 28
_MAX_PIECES = 4096
_MAX_ROWS = 1 << 40
_MAX_EPISODES = 1 << 22
_KINDS = "biufSU"
_Piece = tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class ArrayMeta:
    """A ``.zarray`` document.

    Attributes
    ----------
    path : str
        Within the buffer, such as ``data/camera0_rgb``.
    shape, chunks : tuple of int
    dtype : numpy.dtype
    order : str
        ``C`` or ``F``: of the numbers in a chunk.
    compressor : mapping or None
    filters : list of mapping or None
    separator : str
        Between the numbers of a chunk's name.
    fill_value : int, float, str or None
        What a chunk that is not stored holds throughout.
    """

    path: str
    shape: tuple[int, ...]
    chunks: tuple[int, ...]
    dtype: np.dtype[Any]
    order: str
    compressor: Mapping[str, Any] | None
    filters: list[Mapping[str, Any]] | None
    separator: str
    fill_value: Any = None

    @property
    def name(self) -> str:
        """The last part of its path."""
        return self.path.rpartition("/")[2]

    @property
    def codec(self) -> str | None:
        """Id of its compressor."""
        return None if self.compressor is None else str(self.compressor.get("id"))

    @property
    def row_bytes(self) -> int:
        """Bytes of one row, decoded."""
        return math.prod(self.shape[1:]) * self.dtype.itemsize

    def pieces(self) -> list[tuple[int, ...]]:
        """Return the numbers, but the first, of the chunks that a row lies in."""
        ranges = (
            range(-(-size // chunk))
            for size, chunk in zip(self.shape[1:], self.chunks[1:], strict=True)
        )
        return list(product(*ranges))

    def chunk_name(self, row: int, piece: tuple[int, ...]) -> str:
        """Return a chunk's name within the array."""
        return self.separator.join(map(str, (row, *piece)))


def _parse(raw: bytes, path: str, where: object) -> ArrayMeta:
    """Read a ``.zarray`` document.

    Raises
    ------
    SourceError, UnsupportedError, LimitError
        It is damaged, is of a kind that is not read, or asks for too much memory.
    """
    try:
        document: Any = json.loads(raw) if len(raw) <= _MAX_DOCUMENT else None
        dtype = document["dtype"]
        if document["zarr_format"] != 2 or not isinstance(dtype, str):
            raise KeyError("zarr_format or dtype")
        meta = ArrayMeta(
            path=path,
            shape=_numbers(document["shape"]),
            chunks=_numbers(document["chunks"]),
            dtype=np.dtype("V1" if "O" in dtype else dtype),
            order=document.get("order", "C"),
            compressor=document.get("compressor"),
            filters=document.get("filters") or None,
            separator=document.get("dimension_separator", "."),
            fill_value=document.get("fill_value"),
        )
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise SourceError(
            f"its .zarray is damaged ({type(error).__name__}: {error})",
            where=where,
            fix="Get the file again from its source.",
        ) from None
    _check(meta, dtype, where)
    return meta


def _numbers(value: object) -> tuple[int, ...]:
    if not isinstance(value, list) or any(
        isinstance(n, bool) or not isinstance(n, int) or not 0 <= n <= _MAX_ROWS for n in value
    ):
        raise ValueError("shape")
    return tuple(value)


def _check(meta: ArrayMeta, dtype: str, where: object) -> None:
    if "O" in dtype:
        raise UnsupportedError(
            "it holds Python objects (pickles), which are never loaded from a file",
            where=where,
            fix="Write the array again as numbers, with the program that made it.",
        )
    same = len(meta.shape) == len(meta.chunks) >= 1 and all(meta.chunks)
    if meta.dtype.kind not in _KINDS or not same or meta.order not in ("C", "F"):
        raise UnsupportedError(
            f"an array of {dtype}, shape {meta.shape}, chunks {meta.chunks} is not read",
            where=where,
        )
    if meta.separator not in (".", "/"):
        raise UnsupportedError("its chunks are named in an unknown way", where=where)
    size = math.prod(meta.chunks) * meta.dtype.itemsize
    block = meta.chunks[0] * meta.row_bytes
    if size > _MAX_CHUNK or block > _MAX_CHUNK or len(meta.pieces()) > _MAX_PIECES:
        raise LimitError(
            f"a chunk of {max(size, block):,} bytes, or a row of too many",
            where=where,
            fix="Write the buffer again with smaller chunks.",
        )
    check_codec(meta.compressor, where)
    check_filters(meta.filters, where)


class Chunks(Protocol):
    """Where the chunks of an array are."""

    def read(self, row: int, piece: _Piece) -> bytes | None:
        """Return a chunk as stored; None if there is none."""
        ...

    def part(self, first: int, last: int) -> "Chunks":
        """Return the same of some rows of chunks only."""
        ...


@dataclass(frozen=True, slots=True)
class _FolderChunks:
    store: FolderStore
    meta: ArrayMeta

    def read(self, row: int, piece: _Piece) -> bytes | None:
        try:
            return self.store.read(f"{self.meta.path}/{self.meta.chunk_name(row, piece)}")
        except FileNotFoundError:
            return None

    def part(self, first: int, last: int) -> "_FolderChunks":  # nothing is held
        return self


class _ZipFile:
    """A descriptor of a zip: opened when first read, not sent to other processes."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._descriptor: int | None = None

    def __getstate__(self) -> Path:
        return self.path

    def __setstate__(self, path: Path) -> None:
        self.__init__(path)  # type: ignore[misc]  # descriptors do not cross processes

    @property
    def descriptor(self) -> int:
        if self._descriptor is None:
            self._descriptor = os.open(self.path, os.O_RDONLY)
            weakref.finalize(self, os.close, self._descriptor)
        return self._descriptor


class _ZipChunks:
    """Chunks in a zip: for each piece of a row, the records of its chunks, ascending."""

    def __init__(self, file: _ZipFile, path: str, tables: Mapping[_Piece, np.ndarray]) -> None:
        self._file = file
        self._path = path
        self._tables = tables
        # The same as a dictionary, when it is asked for: looked up in a tenth of the time.
        self._found: dict[_Piece, dict[int, Member]] = {}

    def __getstate__(self) -> tuple[_ZipFile, str, Mapping[_Piece, np.ndarray]]:
        return self._file, self._path, self._tables

    def __setstate__(self, state: tuple[_ZipFile, str, Mapping[_Piece, np.ndarray]]) -> None:
        self.__init__(*state)  # type: ignore[misc]  # without what was found

    def read(self, row: int, piece: _Piece) -> bytes | None:
        found = self._found.get(piece)
        if found is None:
            table = self._tables.get(piece)
            members = () if table is None else map(Member._make, table.tolist())
            found = self._found[piece] = {member.row: member for member in members}
        member = found.get(row)
        if member is None:
            return None
        return read_member(self._file.descriptor, member, f"{self._path} {row}")

    def part(self, first: int, last: int) -> "_ZipChunks":
        tables = {}
        for piece, table in self._tables.items():
            start, stop = np.searchsorted(table["row"], (first, last + 1))
            # A view: what is sent to a worker is this part alone.
            tables[piece] = table[start:stop]
        return _ZipChunks(self._file, self._path, tables)


class Block(NamedTuple):
    """Rows that lie in the same chunks.

    Attributes
    ----------
    first : int
        The first of them, counted from the episode's first.
    values : (n, ...) ndarray or None
        None: a chunk is missing or damaged.
    reason : str
        What is the matter then.
    rows : int
        How many they are.
    """

    first: int
    values: np.ndarray | None
    reason: str
    rows: int


@dataclass(frozen=True, slots=True)
class Rows:
    """The rows of an array that belong to one episode.

    Attributes
    ----------
    meta : ArrayMeta
    start, stop : int
    chunks : Chunks
    """

    meta: ArrayMeta
    start: int
    stop: int
    chunks: Chunks = field(repr=False)

    def __len__(self) -> int:
        return self.stop - self.start

    @property
    def name(self) -> str:
        """Of the array."""
        return self.meta.name

    def __iter__(self) -> Iterator[tuple[str, bytes]]:
        """Yield what makes the episode's id.

        A chunk as it is stored, where it is of this episode alone: nothing is decoded for it. Of
        chunks that hold more than one row, as those of small numbers, the rows: what episodes
        come after must not matter.
        """
        if self.meta.chunks[0] > 1:
            for block in self.blocks():
                if block.values is not None:
                    yield f"{block.first}", np.ascontiguousarray(block.values).tobytes()
            return
        for row in range(self.start, self.stop):
            for piece in self.meta.pieces():
                content = self._stored(row, piece)
                if content is not None:
                    yield ".".join(map(str, (row - self.start, *piece))), content

    def _stored(self, row: int, piece: _Piece) -> bytes | None:
        try:
            return self.chunks.read(row, piece)
        except ExumiError:
            return None  # decoding says what is the matter with it

    def slice(self, first: int, stop: int) -> "Rows":
        """Return some of these rows, counted from the first of them."""
        return replace(self, start=self.start + first, stop=self.start + stop)

    def stored(self, index: int) -> bytes | None:
        """Return the chunk of a row that is one chunk, as stored; None if it cannot be read."""
        return self._stored(self.start + index, (0,) * (len(self.meta.shape) - 1))

    @property
    def is_chunk_a_row(self) -> bool:
        """Whether each row is one chunk."""
        meta = self.meta
        return meta.chunks[0] == 1 and all(
            c >= s for c, s in zip(meta.chunks[1:], meta.shape[1:], strict=True)
        )

    def blocks(self, *, channel: int | None = None, fill: bool = False) -> Iterator[Block]:
        """Yield all rows, some at a time.

        Parameters
        ----------
        channel : int, optional
            Decode this entry of the last axis alone, where it has chunks of its own; the others
            are then undefined.
        fill : bool
            Whether chunks that are not stored hold the fill value, as Zarr has it, and are not
            missing.
        """
        meta = self.meta
        rows = meta.chunks[0]
        pieces = meta.pieces()
        if channel is not None:
            pieces = [p for p in pieces if p[-1] == channel // meta.chunks[-1]]
        for number in range(self.start // rows, -(-self.stop // rows)):
            first = max(self.start, number * rows)
            count = min(self.stop, (number + 1) * rows) - first
            values, reason = self._decode(number, pieces, fill=fill)
            if values is not None:
                values = values[first - number * rows :][:count]
            yield Block(first - self.start, values, reason, count)

    def _decode(
        self, number: int, pieces: Sequence[tuple[int, ...]], *, fill: bool
    ) -> tuple[np.ndarray | None, str]:
        meta = self.meta
        whole = np.empty((meta.chunks[0], *meta.shape[1:]), meta.dtype)
        try:
            for piece in pieces:
                data = self.chunks.read(number, piece)
                if data is not None:
                    self._put(data, number, piece, whole)
                elif fill and isinstance(meta.fill_value, bool | int | float | str):
                    self._place(piece, whole)[...] = meta.fill_value
                else:
                    return None, "it is not there"
        except (ValueError, OverflowError):
            return None, f"its fill value {meta.fill_value!r} is none of {meta.dtype}"
        except LimitError:
            raise
        except ExumiError as error:
            return None, error.what
        return whole, ""

    def _put(self, data: bytes, number: int, piece: tuple[int, ...], whole: np.ndarray) -> None:
        meta = self.meta
        where = f"{meta.path} {meta.chunk_name(number, piece)}"
        if whole.shape == meta.chunks and meta.order == "C":
            decode_chunk(data, whole, meta.compressor, meta.filters, where)
            return
        shape = meta.chunks if meta.order == "C" else meta.chunks[::-1]
        chunk = np.empty(shape, meta.dtype)
        decode_chunk(data, chunk, meta.compressor, meta.filters, where)
        if meta.order == "F":
            chunk = chunk.T
        target = self._place(piece, whole)
        target[...] = chunk[tuple(slice(0, n) for n in target.shape)]

    def _place(self, piece: tuple[int, ...], whole: np.ndarray) -> np.ndarray:
        """Return the part of some rows that a chunk holds."""
        corner = [(p * c, c) for p, c in zip(piece, self.meta.chunks[1:], strict=True)]
        return whole[(slice(None), *(slice(a, a + c) for a, c in corner))]

    def read(self, *, fill: bool = False) -> np.ndarray:
        """Return all rows of an array of small numbers.

        Parameters
        ----------
        fill : bool
            See `blocks`.

        Raises
        ------
        SourceError
            A chunk is missing or damaged.
        LimitError
            They are too many.
        """
        size = len(self) * self.meta.row_bytes
        if size > _MAX_CHUNK:
            raise LimitError(f"an episode of {size:,} bytes of numbers", where=self.meta.path)
        parts = []
        for block in self.blocks(fill=fill):
            if block.values is None:
                raise SourceError(
                    f"rows from {block.first} cannot be read: {block.reason}",
                    where=self.meta.path,
                    fix="Get the file again from its source.",
                )
            parts.append(block.values)
        nothing = np.empty((0, *self.meta.shape[1:]), self.meta.dtype)
        return np.concatenate([nothing, *parts])


@dataclass(frozen=True, slots=True)
class Buffer:
    """A replay buffer.

    Attributes
    ----------
    path : pathlib.Path
    arrays : dict of str to ArrayMeta
        Those of ``data`` that can be read, by name, in order.
    refused : dict of str to str
        Those that cannot, with the reason.
    ends : (E,) int64
        One past the last row of each episode.
    attributes : dict
        The root's ``.zattrs``.
    """

    path: Path
    arrays: dict[str, ArrayMeta]
    refused: dict[str, str]
    ends: np.ndarray
    attributes: dict[str, Any]
    _chunks: dict[str, Chunks] = field(repr=False)

    def rows(self, name: str, start: int, stop: int) -> Rows:
        """Return some rows of an array."""
        meta = self.arrays[name]
        first, last = start // meta.chunks[0], max(start, stop - 1) // meta.chunks[0]
        return Rows(meta, start, stop, self._chunks[name].part(first, last))


def open_buffer(path: Path) -> Buffer:
    """Open a replay buffer: a folder or a zip, whatever it is called. No frame is read.

    Raises
    ------
    SourceError
        It is none, or damaged.
    UnsupportedError, LimitError
        It cannot be read safely.
    MissingExtraError
        imagecodecs is not installed.
    """
    store = _ZipDocuments(path) if is_zip(path) else _FolderDocuments(path)
    names = store.arrays()
    arrays: dict[str, ArrayMeta] = {}
    refused: dict[str, str] = {}
    for name in sorted(names):
        try:
            arrays[name] = store.meta(f"data/{name}")
        except MissingExtraError:
            raise
        except ExumiError as error:
            refused[name] = error.what
    ends = _read_ends(store)
    chunks = {name: store.chunks(meta) for name, meta in arrays.items()}
    return Buffer(path, arrays, refused, ends, store.attributes(), chunks)


class _Documents(Protocol):
    path: Path

    def read(self, name: str) -> bytes | None: ...
    def arrays(self) -> list[str]: ...
    def chunks(self, meta: ArrayMeta) -> Chunks: ...


class _Common(ABC):
    path: Path

    @abstractmethod
    def read(self, name: str) -> bytes | None: ...

    def meta(self, path: str) -> ArrayMeta:
        raw = self.read(f"{path}/.zarray")
        where = f"{self.path}: {path}"
        if raw is None:
            raise SourceError(
                "there is no such array: this is no replay buffer of UMI",
                where=where,
                fix="Name the .zarr folder or the .zarr.zip itself.",
            )
        return _parse(raw, path, where)

    def attributes(self) -> dict[str, Any]:
        raw = self.read(".zattrs") or b"{}"
        try:
            value = json.loads(raw) if len(raw) <= 32 * _MAX_DOCUMENT else {}
        except (ValueError, RecursionError):
            value = {}
        return value if isinstance(value, dict) else {}


class _FolderDocuments(_Common):
    def __init__(self, path: Path) -> None:
        self.path = path
        self._store = FolderStore(path)

    def read(self, name: str) -> bytes | None:
        try:
            return self._store.read(name)
        except FileNotFoundError:
            return None

    def arrays(self) -> list[str]:
        folder = self.path / "data"
        if not folder.is_dir():
            return []
        return [p.name for p in folder.iterdir() if (p / ".zarray").is_file()]

    def chunks(self, meta: ArrayMeta) -> Chunks:
        return _FolderChunks(self._store, meta)


class _ZipDocuments(_Common):
    def __init__(self, path: Path) -> None:
        self.path = path
        self._index: ZipIndex = read_index(path)
        self._file = _ZipFile(path)
        self._prefix = self._find_prefix()

    def _find_prefix(self) -> str:
        """Return what comes before the names: a folder that was packed with its own name."""
        tail = f"{EPISODE_ENDS}/.zarray"
        found = [n[: -len(tail)] for n in self._index.documents if n.endswith(tail)]
        found = [prefix for prefix in found if not prefix or prefix.endswith("/")]
        if len(found) > 1:
            raise SourceError(
                f"it holds {len(found)} replay buffers",
                where=self.path,
                fix="Unpack it, and convert them one by one.",
            )
        return found[0] if found else ""

    def read(self, name: str) -> bytes | None:
        record = self._index.documents.get(self._prefix + name)
        if record is None:
            return None
        if int(record["full"][0]) > 32 * _MAX_DOCUMENT:
            raise LimitError("a document of more than 32 MiB", where=f"{self.path}: {name}")
        member = Member._make(record[0].tolist())
        return read_member(self._file.descriptor, member, f"{self.path}: {name}")

    def arrays(self) -> list[str]:
        head, tail = f"{self._prefix}data/", "/.zarray"
        names = (
            n[len(head) : -len(tail)]
            for n in self._index.documents
            if n.startswith(head) and n.endswith(tail)
        )
        return [name for name in names if name and "/" not in name]

    def chunks(self, meta: ArrayMeta) -> Chunks:
        path = self._prefix + meta.path
        tables = {
            tuple(map(int, filter(None, piece.split(".")))): table
            for (array, piece), table in self._index.chunks.items()
            if array == path
        }
        return _ZipChunks(self._file, meta.path, tables)


def _read_ends(store: _FolderDocuments | _ZipDocuments) -> np.ndarray:
    meta = store.meta(EPISODE_ENDS)
    if len(meta.shape) != 1 or meta.dtype.kind not in "iu" or meta.shape[0] > _MAX_EPISODES:
        raise SourceError(
            f"it is {meta.shape} {meta.dtype}, expected one whole number an episode",
            where=f"{store.path}: {EPISODE_ENDS}",
        )
    ends = Rows(meta, 0, meta.shape[0], store.chunks(meta)).read()
    if (ends > _MAX_ROWS).any():
        raise SourceError("an end is no row", where=f"{store.path}: {EPISODE_ENDS}")
    return ends.astype(np.int64)
