"""A `Store` of ours, offered to zarr-python: read only, no links, no files left open."""

from collections.abc import AsyncIterator, Iterable

from zarr.abc.store import (
    ByteRequest,
    OffsetByteRequest,
    RangeByteRequest,
    Store,
    SuffixByteRequest,
)
from zarr.core.buffer import Buffer, BufferPrototype
from zarr.core.buffer.core import default_buffer_prototype

from exumi_data.errors import LimitError
from exumi_data.store.access import Store as EpisodeStore

__all__ = ["ZarrBacking"]

_MAX_VALUE_BYTES = 2 << 30


class ZarrBacking(Store):
    """zarr-python's view of an episode's store.

    Parameters
    ----------
    store : exumi_data.store.access.Store
    """

    supports_writes = False
    supports_deletes = False
    supports_listing = True

    def __init__(self, store: EpisodeStore) -> None:
        super().__init__(read_only=True)
        self._store = store

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ZarrBacking) and self._store is other._store

    __hash__ = None  # type: ignore[assignment]  # as in zarr's own stores

    async def get(
        self,
        key: str,
        prototype: BufferPrototype | None = None,
        byte_range: ByteRequest | None = None,
    ) -> Buffer | None:
        """Return a file's bytes, or None when there is no such file."""
        try:
            size = self._store.size(key)
            start, stop = _bounds(byte_range, size)
            if stop - start > _MAX_VALUE_BYTES:
                raise LimitError(f"a chunk of {stop - start:,} bytes", where=key)
            data = self._store.read_range(key, start, stop - start)
        except FileNotFoundError:
            return None
        return (prototype or default_buffer_prototype()).buffer.from_bytes(data)

    async def get_partial_values(
        self,
        prototype: BufferPrototype,
        key_ranges: Iterable[tuple[str, ByteRequest | None]],
    ) -> list[Buffer | None]:
        """Return several parts of files."""
        return [await self.get(key, prototype, byte_range) for key, byte_range in key_ranges]

    async def exists(self, key: str) -> bool:
        """Whether there is such a file."""
        try:
            self._store.size(key)
        except FileNotFoundError:
            return False
        return True

    async def set(self, key: str, value: Buffer) -> None:
        """Refuse: reading never writes."""
        self._check_writable()

    async def delete(self, key: str) -> None:
        """Refuse: reading never writes."""
        self._check_writable()

    async def list(self) -> AsyncIterator[str]:
        """List all files."""
        for path in self._store.paths():
            yield path

    async def list_prefix(self, prefix: str) -> AsyncIterator[str]:
        """List the files whose path begins with `prefix`."""
        for path in self._store.paths():
            if path.startswith(prefix):
                yield path

    async def list_dir(self, prefix: str) -> AsyncIterator[str]:
        """List the names directly below a folder."""
        folder = f"{prefix.rstrip('/')}/" if prefix else ""
        inside = [path for path in self._store.paths() if path.startswith(folder)]
        for name in sorted({path[len(folder) :].partition("/")[0] for path in inside}):
            yield name


def _bounds(byte_range: ByteRequest | None, size: int) -> tuple[int, int]:
    if isinstance(byte_range, RangeByteRequest):
        return min(byte_range.start, size), min(byte_range.end, size)
    if isinstance(byte_range, OffsetByteRequest):
        return min(byte_range.offset, size), size
    if isinstance(byte_range, SuffixByteRequest):
        return max(0, size - byte_range.suffix), size
    return 0, size
