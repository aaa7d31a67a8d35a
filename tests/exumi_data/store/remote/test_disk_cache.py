"""The cache on the disk: bounded whoever writes, sound whatever happened to it."""

import os
import time
from multiprocessing import get_context
from pathlib import Path

import pytest

from exumi_data.errors import UsageError
from exumi_data.store.remote import disk_cache, reading
from exumi_data.store.remote.disk_cache import BLOCK_BYTES, DiskCache

ROOM = 2 * 4096  # for the checksums of two objects
KEY, OTHER = "ab" * 20, "cd" * 20


def block(number: int) -> bytes:
    return bytes([number % 251]) * BLOCK_BYTES


def on_disk(folder: Path) -> int:
    return sum(path.stat().st_blocks * 512 for path in folder.rglob("*") if path.is_file())


def test_what_is_written_is_read(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path, 1 << 20)
    assert cache.read(KEY, [0, 1]) == {}
    last = b"the end"
    cache.write(KEY, {3: block(3), 4: block(4), 900: last})
    assert cache.read(KEY, range(901)) == {3: block(3), 4: block(4), 900: last}
    assert cache.read(KEY, [4]) == {4: block(4)}
    assert cache.read(OTHER, [4]) == {}
    assert on_disk(tmp_path) < 4 * BLOCK_BYTES + ROOM  # a hole takes no room


@pytest.mark.parametrize("suffix", [".blocks", ".sums"])
def test_what_was_spoiled_is_not_believed(tmp_path: Path, suffix: str) -> None:
    cache = DiskCache(tmp_path, 1 << 20)
    cache.write(KEY, {0: block(1), 1: block(2)})
    (path,) = tmp_path.glob(f"*/*{suffix}")
    raw = bytearray(path.read_bytes())
    raw[1] ^= 8
    path.write_bytes(raw)
    assert cache.read(KEY, [0, 1]) == {1: block(2)}
    cache.write(KEY, {0: block(1)})  # fetched again, it is kept again
    assert cache.read(KEY, [0, 1]) == {0: block(1), 1: block(2)}


@pytest.mark.parametrize("total", [b"", bytes(32), b"-5\n", b"\xff\xfe?"])
def test_a_spoiled_total_is_counted_again(tmp_path: Path, total: bytes) -> None:
    limit = 4 * BLOCK_BYTES + ROOM
    DiskCache(tmp_path, limit).write(KEY, {number: block(number) for number in range(3)})
    (tmp_path / "total").write_bytes(total)
    cache = DiskCache(tmp_path, limit)
    cache.write(OTHER, {number: block(number) for number in range(3)})
    assert len(cache.read(KEY, range(3))) == 3
    assert cache.read(OTHER, range(3)) == {}


def test_a_cache_that_cannot_be_written_is_still_read(tmp_path: Path) -> None:
    DiskCache(tmp_path, 1 << 20).write(KEY, {0: block(0)})
    (tmp_path / "total").unlink()
    (tmp_path / "total").mkdir()
    cache = DiskCache(tmp_path, 1 << 20)
    cache.write(KEY, {1: block(1)})
    assert cache.read(KEY, [0, 1]) == {0: block(0)}


def test_a_full_cache_keeps_what_it_has(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path, 4 * BLOCK_BYTES + ROOM)
    cache.write(KEY, {number: block(number) for number in range(3)})
    cache.write(OTHER, {0: block(0), 1: block(1)})
    assert len(cache.read(KEY, range(3))) == 3
    assert cache.read(OTHER, range(2)) == {}
    assert on_disk(tmp_path) <= 4 * BLOCK_BYTES + ROOM + 4096


def test_what_nobody_read_for_long_makes_room(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path, 4 * BLOCK_BYTES + ROOM)
    cache.write(KEY, {number: block(number) for number in range(3)})
    (path,) = tmp_path.glob("*/*.blocks")
    long_ago = time.time() - 2 * disk_cache._UNUSED_S
    os.utime(path, (long_ago, long_ago))
    cache.write(OTHER, {number: block(number) for number in range(4)})
    assert len(cache.read(OTHER, range(4))) == 4
    assert cache.read(KEY, range(3)) == {}


def test_halves_of_objects_are_removed(tmp_path: Path) -> None:
    for name in ("ef" * 20 + ".blocks", "fe" * 20 + ".sums"):
        (tmp_path / name[:2]).mkdir()
        (tmp_path / name[:2] / name).write_bytes(bytes(BLOCK_BYTES))
        os.utime(tmp_path / name[:2] / name, (0, 0))
    (tmp_path / "ef" / ("ef" * 19 + "ab.sums")).touch()  # somebody may be about to write the rest
    cache = DiskCache(tmp_path, BLOCK_BYTES + ROOM)
    cache.write(KEY, {0: block(0)})
    cache.write(OTHER, {0: block(0)})  # there is no room
    left = sorted(path.name for path in tmp_path.glob("*/*"))
    whole = [f"{key}{suffix}" for key in (KEY, OTHER) for suffix in (".blocks", ".sums")]
    assert left == [*whole, "ef" * 19 + "ab.sums"]


def test_reading_keeps_it(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path, 4 * BLOCK_BYTES + ROOM)
    cache.write(KEY, {number: block(number) for number in range(3)})
    (path,) = tmp_path.glob("*/*.blocks")
    os.utime(path, (0, 0))
    assert len(cache.read(KEY, range(3))) == 3
    cache.write(OTHER, {number: block(number) for number in range(4)})
    assert cache.read(OTHER, range(4)) == {}


def test_a_smaller_limit_is_kept_to(tmp_path: Path) -> None:
    DiskCache(tmp_path, 1 << 20).write(KEY, {number: block(number) for number in range(20)})
    smaller = DiskCache(tmp_path, 4 * BLOCK_BYTES + ROOM)
    smaller.write(OTHER, {0: block(0)})
    assert smaller.read(OTHER, [0]) == {0: block(0)}
    assert on_disk(tmp_path) <= 4 * BLOCK_BYTES + ROOM + 4096


def fill(folder: str, seed: int) -> None:
    cache = DiskCache(Path(folder), 32 * BLOCK_BYTES)
    for number in range(40):
        cache.write(f"{seed:02x}" * 20, {number: block(number)})


def test_several_processes_keep_to_one_limit(tmp_path: Path) -> None:
    context = get_context("forkserver")
    workers = [context.Process(target=fill, args=(str(tmp_path), seed)) for seed in range(3)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert [worker.exitcode for worker in workers] == [0, 0, 0]
    # How many objects got a block is chance; the total is in a file of one page.
    assert 28 * BLOCK_BYTES <= on_disk(tmp_path) <= 32 * BLOCK_BYTES + 4096


def test_a_folder_that_cannot_be_written_is_no_reason_to_stop(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    cache = DiskCache(tmp_path / "file", 1 << 20)
    cache.write(KEY, {0: block(0)})
    assert cache.read(KEY, [0]) == {}
    none = DiskCache(tmp_path / "none", 0)
    none.write(KEY, {0: block(0)})
    assert not (tmp_path / "none").exists()


def test_limits_come_from_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("EXUMI_CACHE", str(tmp_path))
    monkeypatch.setenv("EXUMI_CACHE_BYTES", str(80 << 20))
    reading._readers.clear()
    assert reading.reader().memory_bytes == 10 << 20
    monkeypatch.setenv("EXUMI_CACHE_BYTES", "20 GB")
    reading._readers.clear()
    with pytest.raises(UsageError, match="EXUMI_CACHE_BYTES is '20 GB'"):
        reading.reader()
