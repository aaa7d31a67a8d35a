"""Two helpers that keep the disk and a second core busy while an episode is written."""

import os
import queue
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

__all__ = ["ahead", "synced_early"]

T = TypeVar("T")

_PERIOD_S = 0.05
_WAIT_S = 0.2


def ahead(items: Iterable[T], most: int = 2) -> Iterator[T]:
    """Yield items that another thread makes meanwhile.

    Parameters
    ----------
    items : iterable
    most : int
        How many may wait.
    """
    waiting: queue.Queue[tuple[bool, T | BaseException | None]] = queue.Queue(most)
    stop = threading.Event()

    def put(entry: tuple[bool, T | BaseException | None]) -> None:
        while not stop.is_set():
            with suppress(queue.Full):
                waiting.put(entry, timeout=_WAIT_S)
                return

    def make() -> None:
        try:
            for item in items:
                put((True, item))
                if stop.is_set():
                    return
            put((False, None))
        except BaseException as error:  # noqa: BLE001  # raised where the items are taken
            put((False, error))

    thread = threading.Thread(target=make, name="read ahead", daemon=True)
    thread.start()
    try:
        while True:
            there, item = waiting.get()
            if there:
                yield item  # type: ignore[misc]  # an item, then
            elif isinstance(item, BaseException):
                raise item
            else:
                return
    finally:
        stop.set()
        thread.join()


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
