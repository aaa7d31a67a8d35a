"""Zarr v3 shards (``sharding_indexed``): written once in order, read by offset.

A shard is its inner chunks end to end, then an index of (offset, length) pairs, then the index's
crc32c. Uncompressed chunks in order therefore form one run of bytes: byte *i* of the shard's data
is byte *i* of the file. The fast reader checks that from the index, once, and then reads single
frames with one ``pread``.
"""

import math
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import google_crc32c
import numpy as np
from numcodecs.zstd import Zstd

from exumi_data.errors import DamagedDataError, LimitError, UsageError
from exumi_data.store.access import Store
from exumi_data.store.zarr_document import (
    DTYPES,
    MAX_SHARD_BYTES,
    MAX_WHOLE_READ,
    ArrayDocument,
    array_document,
    parse_array,
)

__all__ = ["ArrayReader", "ArrayWriter", "Bytes", "crc32c", "open_array"]

Bytes = bytes | bytearray | memoryview

_ABSENT = np.uint64(0xFFFFFFFFFFFFFFFF)
_ZSTD = Zstd()  # decoding has no state
_TARGET_SHARD_BYTES = 32 << 20
_INDEX_ROOM = 1 << 20
_CHUNK_COST = 48  # of an index entry, and of zstd where nothing can be saved
_READ_PIECE = 4 << 20
_ZSTD_ROOM = 64 << 10  # more than what zstd adds to what it cannot compress
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def crc32c(data: Bytes | np.ndarray) -> int:
    """Return the CRC-32C (Castagnoli) of some bytes, or of those of a read-only array."""
    as_is = isinstance(data, bytes | np.ndarray)
    return int(google_crc32c.value(data if as_is else bytes(data)))


class ArrayWriter:
    """Append rows to one array; memory stays at one inner chunk.

    Parameters
    ----------
    folder : pathlib.Path
        Folder of the array; made here.
    dtype : numpy.dtype
    row_shape : tuple of int
        Shape of one row: ``()`` for a one-dimensional array.
    chunk_rows : int
        Rows of an inner chunk. An array that is shorter gets one chunk of its own length; where
        this many rows do not fit into a shard, a chunk has fewer.
    zstd : bool
        Compress inner chunks.
    dimension_names : tuple of str, optional
    shard_bytes : int
        Size that shards are filled to.

    Raises
    ------
    UsageError
        A type that the format does not have, an empty row, or one that does not fit into a shard.
    """

    def __init__(
        self,
        folder: Path,
        dtype: Any,
        row_shape: tuple[int, ...],
        *,
        chunk_rows: int,
        zstd: bool,
        dimension_names: tuple[str | None, ...] | None = None,
        shard_bytes: int = _TARGET_SHARD_BYTES,
    ) -> None:
        self.folder = folder
        self.dtype = np.dtype(dtype).newbyteorder("<")
        if self.dtype.name not in DTYPES:
            raise UsageError(
                f"arrays of {self.dtype.name} cannot be stored",
                where=folder.name,
                fix=f"Supported types are {', '.join(sorted(DTYPES))}.",
            )
        self.row_shape = row_shape
        self.rows = 0
        self._zstd = zstd
        self._names = dimension_names
        row_bytes = math.prod(row_shape) * self.dtype.itemsize
        if not 0 < row_bytes <= MAX_SHARD_BYTES - _INDEX_ROOM:
            raise UsageError(f"rows of shape {row_shape} cannot be stored", where=folder.name)
        shard_bytes = min(shard_bytes, MAX_SHARD_BYTES - _INDEX_ROOM)
        self._chunk_rows = max(1, min(chunk_rows, shard_bytes // row_bytes))
        self._chunk_bytes = self._chunk_rows * row_bytes
        fitting = (MAX_SHARD_BYTES - _INDEX_ROOM) // (self._chunk_bytes + _CHUNK_COST)
        self._chunks_per_shard = max(1, min(shard_bytes // self._chunk_bytes, fitting))
        self._pending = bytearray()
        self._index: list[tuple[int, int]] = []
        self._position = 0
        self._shards = 0
        self._file: BinaryIO | None = None
        self._codec = Zstd(level=3, checksum=True) if zstd else None
        self._usable = True
        folder.mkdir(parents=True)

    def append(self, rows: np.ndarray) -> None:
        """Append rows, shape (n, *row_shape).

        Raises
        ------
        UsageError
            As `check`. Nothing was appended.
        """
        self.check(rows)
        if len(rows):
            whole = np.ascontiguousarray(rows, dtype=self.dtype)
            self._append(whole.data.cast("B"), len(rows))

    def check(self, rows: np.ndarray) -> None:
        """Check that rows can be appended.

        Raises
        ------
        UsageError
            Another shape, or a type whose values this one cannot hold.
        """
        if rows.shape[1:] != self.row_shape or not rows.ndim:
            raise UsageError(
                f"rows of shape {rows.shape[1:]}, expected {self.row_shape}", where=self.folder.name
            )
        if not np.can_cast(rows.dtype, self.dtype, "safe"):
            raise UsageError(f"{rows.dtype} does not fit into {self.dtype}", where=self.folder.name)

    def append_bytes(self, data: Bytes) -> None:
        """Append bytes to a one-dimensional uint8 array."""
        view = memoryview(data).cast("B")
        self._append(view, len(view))

    def _append(self, data: memoryview, rows: int) -> None:
        if not self._usable:
            raise UsageError("nothing can be appended any more", where=self.folder.name)
        # Whoever goes on after a full disk would write an array with a hole.
        self._usable = False
        start = 0
        if self._pending:
            start = min(len(data), self._chunk_bytes - len(self._pending))
            self._pending += data[:start]
            if len(self._pending) == self._chunk_bytes:
                self._write_chunk(self._pending)
                self._pending = bytearray()
        while len(data) - start >= self._chunk_bytes:
            self._write_chunk(data[start : start + self._chunk_bytes])
            start += self._chunk_bytes
        self._pending += data[start:]
        self.rows += rows
        self._usable = True

    def _write_chunk(self, chunk: Bytes) -> None:
        if self._file is None:
            path = self._shard_path(self._shards)
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("xb")
            self._position = 0
        encoded = self._codec.encode(chunk) if self._codec else chunk
        self._file.write(encoded)
        length = memoryview(encoded).nbytes
        self._index.append((self._position, length))
        self._position += length
        if len(self._index) == self._chunks_per_shard:
            self._finish_shard(self._chunks_per_shard)

    def _shard_path(self, index: int) -> Path:
        return self.folder.joinpath("c", str(index), *["0"] * len(self.row_shape))

    def _finish_shard(self, chunks: int) -> None:
        if self._file is None:
            return
        index = np.full((chunks, 2), _ABSENT, dtype="<u8")
        index[: len(self._index)] = self._index
        raw = index.tobytes()
        self._file.write(raw)
        self._file.write(crc32c(raw).to_bytes(4, "little"))
        self._file.close()
        self._file = None
        self._index = []
        self._shards += 1

    def finish(self) -> ArrayDocument:
        """Write what is pending and the array's ``zarr.json``.

        Raises
        ------
        UsageError
            An earlier call failed half-way.
        """
        if not self._usable:
            raise UsageError("the array was not written whole", where=self.folder.name)
        self._usable = False
        chunk_rows = self._chunk_rows
        if self._pending:
            if not self._index and not self._shards:
                chunk_rows = self.rows
            else:
                self._pending += bytes(self._chunk_bytes - len(self._pending))
            self._write_chunk(self._pending)
        elif not self.rows:
            chunk_rows = 1
        chunks = self._chunks_per_shard
        if not self._shards:
            # One shard holds everything: its index needs no entries for chunks that cannot be.
            chunks = max(1, len(self._index))
        self._finish_shard(chunks)
        document = ArrayDocument(
            (self.rows, *self.row_shape),
            self.dtype,
            chunk_rows,
            chunk_rows * chunks,
            self._zstd,
            self._names,
        )
        (self.folder / "zarr.json").write_bytes(array_document(document))
        return document

    def abort(self) -> None:
        """Close the open shard, whatever its state."""
        self._usable = False
        if self._file is not None:
            # Closing writes what is buffered, and the disk may be full.
            with suppress(OSError):
                self._file.close()
            self._file = None


class ArrayReader:
    """Read one array in the standard layout.

    Parameters
    ----------
    store : Store
    path : str
        The array's path inside the store.
    document : ArrayDocument
    """

    def __init__(self, store: Store, path: str, document: ArrayDocument) -> None:
        self.store = store
        self.path = path
        self.document = document
        self.shape = document.shape
        self.dtype = document.dtype
        # Looked up for every frame: worked out once.
        self._row_bytes = document.row_bytes
        self._nbytes = document.nbytes
        self._shard_bytes = document.shard_rows * document.row_bytes
        self._paths: dict[int, str] = {}
        self._contiguous: dict[int, bool] = {}
        self._indices: dict[int, np.ndarray] = {}

    def _where(self, shard: int) -> str:
        return f"{self.store.location}/{self.path}/{self.document.shard_path(shard)}"

    def _shard(self, shard: int) -> str:
        path = self._paths.get(shard)
        if path is None:
            path = self._paths[shard] = f"{self.path}/{self.document.shard_path(shard)}"
        return path

    def _index(self, shard: int) -> np.ndarray:
        """Return a shard's index, (chunks, 2) uint64; checked against the file's size."""
        known = self._indices.get(shard)
        if known is not None:
            return known
        document = self.document
        length = document.chunks_per_shard * 16 + 4
        path = self._shard(shard)
        try:
            size = self.store.size(path)
        except FileNotFoundError:
            raise DamagedDataError(
                "shard is missing", where=self._where(shard), fix="Copy the episode again."
            ) from None
        if size < length:
            raise DamagedDataError("shard is cut short", where=self._where(shard))
        raw = self.store.read_range(path, size - length, length)
        if crc32c(raw[:-4]) != int.from_bytes(raw[-4:], "little"):
            raise DamagedDataError("shard index has a wrong checksum", where=self._where(shard))
        index = np.frombuffer(raw[:-4], dtype="<u8").reshape(-1, 2)
        needed = self._chunks_in(shard)
        entries = index[:needed]
        room = size - length
        # Compared one by one first: the sum of two hostile uint64 values could wrap.
        if entries.max() > room or entries.sum(axis=1).max() > room:
            absent = bool((entries == _ABSENT).any())
            what = "lacks an inner chunk" if absent else "index points outside its file"
            raise DamagedDataError(f"shard {what}", where=self._where(shard))
        # Chunks that share bytes would make much data from a small file.
        if entries[:, 1].sum(dtype=np.float64) > room:
            raise DamagedDataError("shard index has overlapping chunks", where=self._where(shard))
        self._indices[shard] = index
        return index

    def _chunks_in(self, shard: int) -> int:
        document = self.document
        rows = min(document.shard_rows, self.shape[0] - shard * document.shard_rows)
        return -(-rows // document.chunk_rows)

    def is_contiguous(self, shard: int) -> bool:
        """Whether a shard's chunks are uncompressed and lie in order without holes."""
        known = self._contiguous.get(shard)
        if known is None:
            known = False
            if not self.document.zstd:
                chunk = self.document.chunk_bytes
                entries = self._index(shard)[: self._chunks_in(shard)]
                starts = np.arange(len(entries), dtype=np.uint64) * np.uint64(chunk)
                known = bool((entries[:, 0] == starts).all() and (entries[:, 1] == chunk).all())
            self._contiguous[shard] = known
        return known

    def check_shards(self) -> None:
        """Check that every shard is there and its index is sound. Reads no chunk."""
        for shard in range(self.document.shards):
            self._index(shard)

    def bytes_at(self, start: int, length: int) -> bytes:
        """Return `length` bytes of the array's memory, from byte `start`.

        Raises
        ------
        DamagedDataError
            A shard is missing or cut short, or the range lies outside the array.
        """
        shard_bytes = self._shard_bytes
        if start < 0 or length < 0 or start + length > self._nbytes:
            raise DamagedDataError(
                f"bytes {start} to {start + length} lie outside the array ({self._nbytes})",
                where=f"{self.store.location}/{self.path}",
            )
        if length > MAX_WHOLE_READ and self.document.zstd:
            raise self._too_much(length)
        shard, offset = divmod(start, shard_bytes)
        if offset + length <= shard_bytes:
            if length and self._contiguous.get(shard):
                return self.store.read_range(self._paths[shard], offset, length)
            return self._bytes_in(shard, offset, length)
        parts = []
        while length:
            take = min(length, shard_bytes - offset)
            parts.append(self._bytes_in(shard, offset, take))
            length -= take
            shard, offset = shard + 1, 0
        return b"".join(parts)

    def _bytes_in(self, shard: int, offset: int, length: int) -> bytes:
        if not length:
            return b""
        if self.is_contiguous(shard):
            return self.store.read_range(self._shard(shard), offset, length)
        chunk_bytes = self.document.chunk_bytes
        first, last = offset // chunk_bytes, (offset + length - 1) // chunk_bytes
        if first == last:
            start = offset - first * chunk_bytes
            return self._chunk(shard, first)[start : start + length]
        data = b"".join(self._chunk(shard, chunk) for chunk in range(first, last + 1))
        start = offset - first * chunk_bytes
        return data[start : start + length]

    def _chunk(self, shard: int, chunk: int) -> bytes:
        start, length = self._index(shard)[chunk].tolist()
        expected = self.document.chunk_bytes
        if not self.document.zstd:
            if length != expected:
                raise DamagedDataError(
                    f"inner chunk {chunk} has a wrong length", where=self._where(shard)
                )
            return self.store.read_range(self._shard(shard), start, length)
        if length > 2 * expected + _ZSTD_ROOM:
            raise DamagedDataError(
                f"inner chunk {chunk} is longer compressed than it can be",
                where=self._where(shard),
            )
        raw = self.store.read_range(self._shard(shard), start, length)
        out = np.empty(expected, dtype=np.uint8)
        if not raw.startswith(_ZSTD_MAGIC):
            raise DamagedDataError(f"inner chunk {chunk} is not zstd", where=self._where(shard))
        if _zstd_content_size(raw) not in (expected, None):
            # The decoder would leave the rest of the buffer as it was.
            raise DamagedDataError(
                f"inner chunk {chunk} has a wrong length", where=self._where(shard)
            )
        try:
            # A buffer of the declared size bounds memory, whatever the frame claims.
            _ZSTD.decode(raw, out)
        except (RuntimeError, ValueError) as error:
            raise DamagedDataError(
                f"inner chunk {chunk} cannot be decompressed ({error})", where=self._where(shard)
            ) from None
        return out.tobytes()

    def ranges(self, start: int, length: int) -> list[tuple[str, int, int]]:
        """Return which bytes of which files `bytes_at` reads: (path, start, length) each.

        Raises
        ------
        DamagedDataError
            A shard is missing, or its index is damaged.
        """
        found = []
        while length > 0:
            shard, offset = divmod(start, self._shard_bytes)
            take = min(length, self._shard_bytes - offset)
            path = self._shard(shard)
            if self.is_contiguous(shard):
                found.append((path, offset, take))
            else:
                chunk_bytes = self.document.chunk_bytes
                first, last = offset // chunk_bytes, (offset + take - 1) // chunk_bytes
                entries = self._index(shard)[first : last + 1].tolist()
                found += [(path, begin, size) for begin, size in entries]
            start, length = start + take, length - take
        return found

    def rows(self, start: int, stop: int) -> np.ndarray:
        """Return rows [start, stop), shape (stop - start, *row_shape)."""
        row_bytes = self._row_bytes
        data = self.bytes_at(start * row_bytes, (stop - start) * row_bytes)
        return np.frombuffer(data, dtype=self.dtype).reshape(stop - start, *self.shape[1:])

    def read(self) -> np.ndarray:
        """Return the whole array.

        Raises
        ------
        LimitError
            The array is larger than 2 GiB: read rows instead.
        DamagedDataError
            Shards are missing or damaged. Found before memory is taken.
        """
        document = self.document
        self.check_shards()
        if document.nbytes > MAX_WHOLE_READ:
            raise self._too_much(document.nbytes)
        if document.nbytes <= _READ_PIECE:  # most arrays of an episode
            return np.frombuffer(self.bytes_at(0, document.nbytes), self.dtype).reshape(self.shape)
        try:
            out = np.empty(self.shape, dtype=self.dtype)
        except MemoryError:
            raise self._too_much(document.nbytes) from None
        flat = out.reshape(-1).view(np.uint8)
        step = max(1, _READ_PIECE // document.chunk_bytes) * document.chunk_bytes
        for start in range(0, document.nbytes, step):
            piece = self.bytes_at(start, min(step, document.nbytes - start))
            flat[start : start + len(piece)] = np.frombuffer(piece, dtype=np.uint8)
        out.flags.writeable = False
        return out

    def _too_much(self, length: int) -> LimitError:
        return LimitError(
            f"{length:,} bytes of the array are asked for; at most {MAX_WHOLE_READ:,} are read at "
            "once, and no more than there is memory",
            where=f"{self.store.location}/{self.path}",
        )


def _zstd_content_size(raw: bytes) -> int | None:
    """Return the length that a zstd frame states for its content, or None (RFC 8878, 3.1.1.1)."""
    descriptor = raw[4] if len(raw) > 4 else 0
    single_segment = descriptor >> 5 & 1
    width = (single_segment, 2, 4, 8)[descriptor >> 6]
    start = 5 + (not single_segment) + (0, 1, 2, 4)[descriptor & 3]
    if not width:
        return None
    return int.from_bytes(raw[start : start + width], "little") + (256 if width == 2 else 0)


def open_array(store: Store, path: str) -> ArrayReader:
    """Open an array.

    Raises
    ------
    DamagedDataError
        No such array, or its document is broken.
    LimitError
        It asks for more memory than it may.
    UnsupportedError
        It is stored in another layout than the standard's.
    """
    where = f"{store.location}/{path}"
    try:
        raw = store.read(f"{path}/zarr.json")
    except FileNotFoundError:
        raise DamagedDataError(
            "array is missing", where=where, fix="Copy the episode again from its source."
        ) from None
    return ArrayReader(store, path, parse_array(raw, where))
