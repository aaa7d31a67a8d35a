"""Let another thread make items while the ones before are worked on."""

import threading
from collections.abc import Generator, Iterable
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import TypeVar

__all__ = ["ahead"]

T = TypeVar("T")

_WAIT_S = 0.2


def ahead(items: Iterable[T], most: int = 2) -> Generator[T, None, None]:
    """Yield items that another thread makes meanwhile.

    Parameters
    ----------
    items : iterable
    most : int
        How many may wait.
    """
    # Simple ones: a signal in the midst of a `queue.Queue` leaves its lock to nobody, for ever.
    waiting: SimpleQueue[tuple[bool, T | BaseException | None]] = SimpleQueue()
    room: SimpleQueue[None] = SimpleQueue()
    for _ in range(most):
        room.put(None)
    stop = threading.Event()

    def put(entry: tuple[bool, T | BaseException | None]) -> None:
        while not stop.is_set():
            with suppress(Empty):
                room.get(timeout=_WAIT_S)
                waiting.put(entry)
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
            room.put(None)
            if there:
                yield item  # type: ignore[misc]  # an item, then
            elif isinstance(item, BaseException):
                raise item
            else:
                return
    finally:
        stop.set()
        thread.join()
