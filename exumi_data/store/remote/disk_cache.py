"""Blocks of remote objects on the local disk, shared by all processes, bounded in bytes.

An object's blocks lie in one sparse file at their own offsets, beside a file with the checksum of
each block that is there: what a power loss or a bad disk spoiled is fetched again. A full cache
keeps what it has, so that training, which reads everything once an epoch, is served the same part
each time; what nobody read for an hour makes room.
"""

import errno
import fcntl
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import google_crc32c
import numpy as np

__all__ = ["BLOCK_BYTES", "DiskCache"]

BLOCK_BYTES = 8 << 10
_UNUSED_S = 3600
_TOUCH_S = 600
_TRY_AGAIN_S = 60
_SUM_BYTES = 4
_PAGE_BYTES = 4096  # what the checksums of an object take at least
_DATA, _SUMS = ".blocks", ".sums"


class DiskCache:
    """A folder of blocks.

    Parameters
    ----------
    folder : pathlib.Path
        Made when the first block is written. Where that cannot be, nothing is kept.
    limit : int
        Bytes of all files in it.
    """

    def __init__(self, folder: Path, limit: int) -> None:
        self._folder = folder
        self._limit = limit
        self._full_until = 0.0
        self._touched: dict[str, float] = {}
        self._usable = limit >= BLOCK_BYTES
        self._can_write = True

    def read(self, key: str, numbers: Sequence[int]) -> dict[int, bytes]:
        """Return those of some blocks that are there and sound.

        Parameters
        ----------
        key : str
            Name of the object and its content.
        numbers : sequence of int
            Ascending, at least one.
        """
        if not self._usable:
            return {}
        found: dict[int, bytes] = {}
        with suppress(OSError), self._open(key, _SUMS, os.O_RDONLY) as sums:
            known = _sums(sums, numbers[0], numbers[-1] + 1)
            wanted = np.asarray(numbers)
            there = wanted[known[wanted - numbers[0]] != 0]
            if not len(there):
                return {}
            spoiled = []
            with self._open(key, _DATA, os.O_RDONLY) as data:
                for run in np.split(there, np.flatnonzero(np.diff(there) > 1) + 1):
                    first = int(run[0])
                    raw = os.pread(data, len(run) * BLOCK_BYTES, first * BLOCK_BYTES)
                    for at in range(len(run)):
                        block = raw[at * BLOCK_BYTES : (at + 1) * BLOCK_BYTES]
                        if _sum(block) == known[first + at - numbers[0]]:
                            found[first + at] = block
                        else:
                            spoiled.append(first + at)
            self._touch(key)
            self._forget(key, spoiled)
        return found

    def write(self, key: str, blocks: Mapping[int, bytes]) -> None:
        """Keep blocks, as far as there is room; what cannot be written is not kept.

        Parameters
        ----------
        key : str
        blocks : mapping of int to bytes
            All of them whole, but for an object's last.
        """
        if not self._usable or not self._can_write or not blocks:
            return
        if time.monotonic() < self._full_until:
            return
        try:
            self._write(key, blocks)
        except OSError:
            self._can_write = False  # a cache that cannot be written is no reason to stop

    def _write(self, key: str, blocks: Mapping[int, bytes]) -> None:
        self._path(key, _DATA).parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        flags = os.O_RDWR | os.O_CREAT
        with self._open(key, _SUMS, flags) as sums, self._open(key, _DATA, flags) as data:
            first, stop = min(blocks), max(blocks) + 1
            known = _sums(sums, first, stop)
            new = [number for number in sorted(blocks) if not known[number - first]]
            is_new = not os.fstat(sums).st_size
            if not new or not self._admit(key, len(new) * BLOCK_BYTES + is_new * _PAGE_BYTES):
                return
            for number in new:
                block = blocks[number]
                if os.pwrite(data, block, number * BLOCK_BYTES) < len(block):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            for number in new:  # after the data: nobody believes in a block that is half there
                os.pwrite(sums, _sum(blocks[number]).to_bytes(4, "little"), number * _SUM_BYTES)

    def _forget(self, key: str, numbers: Sequence[int]) -> None:
        """Take blocks for missing, so that they are written again."""
        if numbers:
            with self._open(key, _SUMS, os.O_WRONLY) as sums:
                for number in numbers:
                    os.pwrite(sums, bytes(_SUM_BYTES), number * _SUM_BYTES)

    def _path(self, key: str, suffix: str) -> Path:
        return self._folder / key[:2] / f"{key}{suffix}"

    @contextmanager
    def _open(self, key: str, suffix: str, flags: int) -> Iterator[int]:
        descriptor = os.open(
            self._path(key, suffix), flags | os.O_CLOEXEC | os.O_NOFOLLOW, mode=0o600
        )
        try:
            yield descriptor
        finally:
            os.close(descriptor)

    def _touch(self, key: str) -> None:
        now = time.monotonic()
        if now - self._touched.get(key, -_TOUCH_S) >= _TOUCH_S:
            self._touched[key] = now
            with suppress(OSError):
                os.utime(self._path(key, _DATA))

    def _admit(self, key: str, length: int) -> bool:
        """Count bytes that are to be written, if there is room for them or it can be made."""
        with self._open_total() as total:
            used = _number(os.pread(total, 32, 0))
            if used is None:  # new, lost, or spoiled by a power loss
                used = sum(size for _, size, _ in self._objects())
            if used + length > self._limit:
                used = self._make_room(key, length)
            fits = used + length <= self._limit
            if fits:
                used += length
            else:
                self._full_until = time.monotonic() + _TRY_AGAIN_S
            os.pwrite(total, f"{used:<31}\n".encode(), 0)
        return fits

    @contextmanager
    def _open_total(self) -> Iterator[int]:
        descriptor = os.open(self._folder / "total", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            yield descriptor
        finally:
            os.close(descriptor)

    def _make_room(self, key: str, length: int) -> int:
        """Remove what was not read for long, the oldest first; return the bytes that remain.

        The object that is to be written stays.
        """
        self._remove_halves()
        known = sorted(self._objects())
        used = sum(size for _, size, _ in known)
        for read_at, size, path in known:
            is_old = time.time() - read_at > _UNUSED_S
            # Whoever made the limit smaller meant it: then also what is new has to go.
            if used + length <= self._limit or not (is_old or used > self._limit):
                break
            if path.stem == key:
                continue
            with suppress(OSError):
                path.unlink(missing_ok=True)
                path.with_suffix(_SUMS).unlink(missing_ok=True)
                used -= size
        return used

    def _remove_halves(self) -> None:
        """Remove what lost its other file, as when a process ended between the two."""
        for path in self._folder.glob("*/*"):
            other = path.with_suffix(_SUMS if path.suffix == _DATA else _DATA)
            with suppress(OSError):
                if not other.exists() and time.time() - path.stat().st_mtime > _UNUSED_S:
                    path.unlink()

    def _objects(self) -> Iterator[tuple[float, int, Path]]:
        """Yield of each object when it was read, its bytes on the disk, and its file."""
        for path in self._folder.glob(f"*/*{_DATA}"):
            with suppress(OSError):
                info = path.stat()
                sums = path.with_suffix(_SUMS).stat()
                yield info.st_mtime, (info.st_blocks + sums.st_blocks) * 512, path


def _sums(descriptor: int, first: int, stop: int) -> np.ndarray:
    """Return the checksums of blocks, 0 for those that are not there."""
    raw = os.pread(descriptor, (stop - first) * _SUM_BYTES, first * _SUM_BYTES)
    out = np.zeros(stop - first, dtype="<u4")
    known = np.frombuffer(raw[: len(raw) // _SUM_BYTES * _SUM_BYTES], dtype="<u4")
    out[: len(known)] = known
    return out


def _number(text: bytes) -> int | None:
    text = text.strip()
    return int(text) if text.isdigit() else None


def _sum(block: bytes) -> int:
    return int(google_crc32c.value(block)) or 1  # 0 stands for no block
