"""Files that appear under their final name only when they are complete."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = ["atomic_file", "replace_folder", "sync_folder", "sync_tree", "write_atomic"]


def sync_folder(path: Path) -> None:
    """Make a folder's entries survive a power loss."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _sync_file(path: str) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_tree(root: Path) -> None:
    """Make all files and folders below `root` survive a power loss."""
    for folder, _, files in os.walk(root, topdown=False):
        for name in files:
            _sync_file(f"{folder}/{name}")
        sync_folder(Path(folder))


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside `path`; on success it takes the final name."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".partial-{os.getpid()}-{path.name}")
    try:
        yield temporary
        _sync_file(str(temporary))
        temporary.replace(path)
        sync_folder(path.parent)
    finally:
        with suppress(FileNotFoundError):
            temporary.unlink()


def write_atomic(path: Path, data: bytes) -> None:
    """Write a small file so that it is there whole or not at all."""
    with atomic_file(path) as temporary:
        temporary.write_bytes(data)


def replace_folder(new: Path, final: Path) -> None:
    """Give `new` the name `final`; an old folder of that name is put aside, then removed.

    If the process dies between the two renames, the old folder waits under ``.replaced-<name>``
    and the new one under its partial name: nothing is lost.
    """
    aside = final.with_name(f".replaced-{final.name}")
    if aside.exists():
        shutil.rmtree(aside)
    if final.exists():
        final.rename(aside)
    new.rename(final)
    sync_folder(final.parent)
    shutil.rmtree(aside, ignore_errors=True)
