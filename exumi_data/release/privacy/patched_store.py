"""An episode as it is with some bytes written over and some files replaced; its source stays."""

from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from exumi_data.errors import DamagedDataError, UnsupportedError
from exumi_data.store.access import Store

if TYPE_CHECKING:
    from exumi_data.store.remote.reading import Identity
from exumi_data.store.shards import ArrayReader

__all__ = ["PatchedStore", "spread"]


class PatchedStore:
    """Read another store's files, some of them changed. Nothing is copied or written.

    Parameters
    ----------
    store : Store
    replaced : mapping of str to bytes
        Files that are others, by path.
    over : mapping of str to sequence of (int, bytes)
        What lies over the bytes of a file, by path; each with its place, without overlaps.
    """

    def __init__(
        self,
        store: Store,
        replaced: Mapping[str, bytes],
        over: Mapping[str, Sequence[tuple[int, bytes]]],
    ) -> None:
        self.location = store.location
        self._store = store
        self._replaced = dict(replaced)
        self._over = {path: sorted(pieces) for path, pieces in over.items()}
        self._starts = {path: [at for at, _ in pieces] for path, pieces in self._over.items()}

    @property
    def source(self) -> str:
        """What opens the store below it."""
        return self._store.source

    @property
    def is_packed(self) -> bool:
        """Whether what lies below is one file."""
        return self._store.is_packed

    @property
    def identity(self) -> "Identity | None":
        """None: it is not the object that lies below."""
        return None

    def read(self, path: str) -> bytes:
        """Return a whole small file."""
        if path in self._replaced:
            return self._replaced[path]
        data = self._store.read(path)
        return self._laid_over(path, 0, data) if path in self._over else data

    def read_range(self, path: str, start: int, length: int) -> bytes:
        """Return exactly `length` bytes from `start`."""
        if path in self._replaced:
            data = self._replaced[path][start : start + length]
            if len(data) != length:
                raise DamagedDataError("file is cut short", where=f"{self.location}/{path}")
            return data
        data = self._store.read_range(path, start, length)
        return self._laid_over(path, start, data) if path in self._over else data

    def _laid_over(self, path: str, start: int, data: bytes) -> bytes:
        pieces, stop = self._over[path], start + len(data)
        first = max(0, bisect_right(self._starts[path], start) - 1)
        made = bytearray(data)
        for at, new in pieces[first:]:
            if at >= stop:
                break
            low, high = max(at, start), min(at + len(new), stop)
            if low < high:
                made[low - start : high - start] = new[low - at : high - at]
        return bytes(made)

    def size(self, path: str) -> int:
        """Return a file's size in bytes."""
        return len(self._replaced[path]) if path in self._replaced else self._store.size(path)

    def paths(self) -> list[str]:
        """List all files, sorted."""
        return sorted({*self._store.paths(), *self._replaced})

    def close(self) -> None:
        """Close open files."""
        self._store.close()


def spread(
    array: ArrayReader, pieces: Iterable[tuple[int, bytes]]
) -> dict[str, list[tuple[int, bytes]]]:
    """Turn places in an array's bytes into places in its files.

    Parameters
    ----------
    array : ArrayReader
        One-dimensional, of bytes.
    pieces : iterable of (int, bytes)

    Returns
    -------
    dict of str to list of (int, bytes)
        By path.

    Raises
    ------
    UnsupportedError
        The array is compressed, or its chunks are not in order.
    """
    document = array.document
    shard_bytes = document.shard_rows * document.row_bytes
    found: dict[str, list[tuple[int, bytes]]] = {}
    for start, new in pieces:
        at, left = start, new
        while left:
            shard, offset = divmod(at, shard_bytes)
            if not array.is_contiguous(shard):
                raise UnsupportedError(
                    "its bytes are compressed, so none of them can be overwritten",
                    where=f"{array.store.location}/{array.path}",
                    fix="Convert the episode again, or keep what is there.",
                )
            take = min(len(left), shard_bytes - offset)
            path = f"{array.path}/{document.shard_path(shard)}"
            found.setdefault(path, []).append((offset, left[:take]))
            at, left = at + take, left[take:]
    return found
