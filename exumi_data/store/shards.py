"""Zarr v3 shards (``sharding_indexed``): written once in order, read by offset.

A shard is its inner chunks end to end, then an index of (offset, length) pairs, then the index's
crc32c. Uncompressed chunks in order therefore form one run of bytes: byte *i* of the shard's data
is byte *i* of the file. The fast reader checks that from the index, once, and then reads single
frames with one ``pread``.
"""

import math
import os
from pathlib import Path
from typing import Any, BinaryIO

import google_crc32c
import numpy as np
from numcodecs.zstd import Zstd

from exumi_data.errors import DamagedDataError, LimitError
from exumi_data.store.access import Store
from exumi_data.store.zarr_document import (
    ArrayDocument,
    ForeignLayoutError,
    array_document,
    parse_array,
)

__all__ = ["ArrayReader", "ArrayWriter", "Bytes", "ZarrReader", "crc32c", "open_array"]

Bytes = bytes | bytearray | memoryview

_ABSENT = np.uint64(0xFFFFFFFFFFFFFFFF)
_TARGET_SHARD_BYTES = 32 << 20
_MAX_WHOLE_READ = 2 << 30
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def crc32c(data: Bytes) -> int:
    """Return the CRC-32C (Castagnoli) of some bytes."""
    return int(google_crc32c.value(bytes(data) if not isinstance(data, bytes) else data))


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
        Rows of an inner chunk. An array that is shorter gets one chunk of its own length.
    zstd : bool
        Compress inner chunks.
    dimension_names : tuple of str, optional
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
    ) -> None:
        self.folder = folder
        self.dtype = np.dtype(dtype).newbyteorder("<")
        self.row_shape = row_shape
        self.rows = 0
        self._chunk_rows = chunk_rows
        self._zstd = zstd
        self._names = dimension_names
        self._row_bytes = math.prod(row_shape) * self.dtype.itemsize
        self._chunk_bytes = chunk_rows * self._row_bytes
        self._chunks_per_shard = max(1, _TARGET_SHARD_BYTES // max(1, self._chunk_bytes))
        self._pending = bytearray()
        self._index: list[tuple[int, int]] = []
        self._position = 0
        self._shards = 0
        self._file: BinaryIO | None = None
        self._codec = Zstd(level=3, checksum=True) if zstd else None
        folder.mkdir(parents=True)

    def append(self, rows: np.ndarray) -> None:
        """Append rows, shape (n, *row_shape)."""
        if rows.shape[1:] != self.row_shape:
            msg = f"rows of shape {rows.shape[1:]}, expected {self.row_shape}"
            raise ValueError(msg)
        self._append(np.ascontiguousarray(rows, dtype=self.dtype).data.cast("B"), len(rows))

    def append_bytes(self, data: Bytes) -> None:
        """Append bytes to a one-dimensional uint8 array."""
        view = memoryview(data).cast("B")
        self._append(view, len(view))

    def _append(self, data: memoryview, rows: int) -> None:
        self.rows += rows
        if not self._pending and len(data) == self._chunk_bytes:
            self._write_chunk(data)
            return
        self._pending += data
        if len(self._pending) > self._chunk_bytes:
            # The last whole chunk stays pending: a short array's chunk is cut to its length.
            whole = (len(self._pending) - 1) // self._chunk_bytes * self._chunk_bytes
            with memoryview(self._pending) as view:
                for start in range(0, whole, self._chunk_bytes):
                    self._write_chunk(view[start : start + self._chunk_bytes])
            del self._pending[:whole]

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
        """Write what is pending and the array's ``zarr.json``."""
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
        if self._file is not None:
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
        self._contiguous: dict[int, bool] = {}
        self._indices: dict[int, np.ndarray] = {}

    def _where(self, shard: int) -> str:
        return f"{self.store.location}/{self.path}/{self.document.shard_path(shard)}"

    def _shard(self, shard: int) -> str:
        return f"{self.path}/{self.document.shard_path(shard)}"

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
        if (entries == _ABSENT).any():
            raise DamagedDataError("shard lacks an inner chunk", where=self._where(shard))
        # Compared one by one: the sum of two hostile uint64 values could wrap.
        if (entries > size).any() or (entries.sum(axis=1) > size - length).any():
            raise DamagedDataError("shard index points outside its file", where=self._where(shard))
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
        document = self.document
        if start < 0 or length < 0 or start + length > document.nbytes:
            raise DamagedDataError(
                f"bytes {start} to {start + length} lie outside the array ({document.nbytes})",
                where=f"{self.store.location}/{self.path}",
            )
        shard_bytes = document.shard_rows * document.row_bytes
        shard, offset = divmod(start, shard_bytes)
        if offset + length <= shard_bytes:
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
        data = b"".join(self._chunk(shard, chunk) for chunk in range(first, last + 1))
        start = offset - first * chunk_bytes
        return data[start : start + length]

    def _chunk(self, shard: int, chunk: int) -> bytes:
        start, length = (int(value) for value in self._index(shard)[chunk])
        expected = self.document.chunk_bytes
        where = self._where(shard)
        if not self.document.zstd:
            if length != expected:
                raise DamagedDataError(f"inner chunk {chunk} has a wrong length", where=where)
            return self.store.read_range(self._shard(shard), start, length)
        raw = self.store.read_range(self._shard(shard), start, length)
        out = np.empty(expected, dtype=np.uint8)
        if not raw.startswith(_ZSTD_MAGIC):
            raise DamagedDataError(f"inner chunk {chunk} is not zstd", where=where)
        try:
            # A buffer of the declared size bounds memory, whatever the frame claims.
            Zstd().decode(raw, out)
        except (RuntimeError, ValueError) as error:
            raise DamagedDataError(
                f"inner chunk {chunk} cannot be decompressed ({error})", where=where
            ) from None
        return out.tobytes()

    def rows(self, start: int, stop: int) -> np.ndarray:
        """Return rows [start, stop), shape (stop - start, *row_shape)."""
        row_bytes = self.document.row_bytes
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
        if document.nbytes > _MAX_WHOLE_READ:
            self.check_shards()
            raise LimitError(
                f"the array has {document.nbytes:,} bytes; at most {_MAX_WHOLE_READ:,} are read "
                "at once",
                where=f"{self.store.location}/{self.path}",
            )
        self.check_shards()
        if not self.shape[0]:
            return np.empty(self.shape, dtype=self.dtype)
        return self.rows(0, self.shape[0])


class ZarrReader:
    """Read an array in any other layout, through zarr-python."""

    def __init__(self, store: Store, path: str) -> None:
        import zarr  # slow to import, and rarely needed
        from zarr.storage import LocalStore, ZipStore

        backing: LocalStore | ZipStore
        if os.path.isdir(store.location):  # noqa: PTH112  # a string path, asked once
            backing = LocalStore(store.location, read_only=True)
        else:
            backing = ZipStore(store.location, read_only=True)
        try:
            array = zarr.open_array(backing, path=path, mode="r", zarr_format=3)
        except Exception as error:
            raise DamagedDataError(
                f"zarr-python cannot open the array ({error})", where=f"{store.location}/{path}"
            ) from error
        self._array = array
        self._where = f"{store.location}/{path}"
        self.shape: tuple[int, ...] = array.shape
        self.dtype: np.dtype[Any] = array.dtype
        if math.prod(array.chunks) * array.dtype.itemsize > _MAX_WHOLE_READ:
            raise LimitError("a chunk of more than 2 GiB", where=self._where)

    def check_shards(self) -> None:
        """Check nothing: zarr-python cannot tell a missing chunk from zeros."""

    def rows(self, start: int, stop: int) -> np.ndarray:
        """Return rows [start, stop)."""
        try:
            return np.asarray(self._array[start:stop])
        except Exception as error:
            raise DamagedDataError(f"cannot be read ({error})", where=self._where) from error

    def bytes_at(self, start: int, length: int) -> bytes:
        """Return bytes of the array's memory."""
        row_bytes = math.prod(self.shape[1:]) * self.dtype.itemsize
        first, last = start // row_bytes, -(-(start + length) // row_bytes)
        data = self.rows(first, last).tobytes()
        return data[start - first * row_bytes :][:length]

    def read(self) -> np.ndarray:
        """Return the whole array."""
        if math.prod(self.shape) * self.dtype.itemsize > _MAX_WHOLE_READ:
            raise LimitError("the array has more than 2 GiB", where=self._where)
        return self.rows(0, self.shape[0])


def open_array(store: Store, path: str) -> ArrayReader | ZarrReader:
    """Open an array: by the fast reader where its layout is the standard one.

    Raises
    ------
    DamagedDataError
        No such array, or its document is broken.
    LimitError
        It asks for more memory than it may.
    """
    where = f"{store.location}/{path}"
    try:
        raw = store.read(f"{path}/zarr.json")
    except FileNotFoundError:
        raise DamagedDataError(
            "array is missing", where=where, fix="Copy the episode again from its source."
        ) from None
    try:
        document = parse_array(raw, where)
    except ForeignLayoutError:
        return ZarrReader(store, path)
    return ArrayReader(store, path, document)
