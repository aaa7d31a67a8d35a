"""Keeps the disk busy while an episode is written."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = ["synced_early"]

_PERIOD_S = 0.05


@contextmanager
def synced_early(folder: Path) -> Iterator[None]:
    """Sync the shards of an episode as they are finished, so that little is left at the end.

    Parameters
    ----------
    folder : pathlib.Path
        Of the episode that is being written.
    """
    stop = threading.Event()
    thread = threading.Thread(target=_sync, args=(folder, stop), name="sync early", daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def _sync(folder: Path, stop: threading.Event) -> None:
    synced: set[Path] = set()
    while not stop.wait(_PERIOD_S):
        for shards in folder.glob("streams/*/data/c"):
            # The last one is being written.
            found = sorted((path for path in shards.iterdir() if path.is_file()), key=_number)
            for path in found[:-1]:
                if path not in synced:
                    synced.add(path)
                    # What fails here fails again, and is told, when the whole is synced.
                    with suppress(OSError):
                        _sync_file(path)


def _number(path: Path) -> int:
    return int(path.name) if path.name.isdigit() else 0


def _sync_file(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
