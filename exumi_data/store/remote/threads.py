"""Threads that nobody waits for at the end: Ctrl-C stops a program while a server is silent."""

import threading
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from queue import SimpleQueue
from typing import Any, ParamSpec, TypeVar
from weakref import finalize

__all__ = ["DaemonThreads"]

T = TypeVar("T")
P = ParamSpec("P")
_Queue = SimpleQueue[tuple[Future[Any], Callable[[], Any]] | None]


class DaemonThreads:
    """As `ThreadPoolExecutor`, whose threads however are waited for when a program ends.

    Parameters
    ----------
    most : int
        Threads; each is started when there is something for it to do.
    name : str
        Of the threads.
    """

    def __init__(self, most: int, name: str) -> None:
        self._most = most
        self._name = name
        self._started = 0
        self._queue: _Queue = SimpleQueue()
        self._lock = threading.Lock()
        finalize(self, _stop, self._queue, most).atexit = False

    def submit(self, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Have a function called.

        Parameters
        ----------
        work : callable
        *args, **kwargs
            What it is called with.
        """
        future: Future[T] = Future()
        with self._lock:
            if self._started < self._most:
                self._started += 1
                threading.Thread(
                    target=_work, args=(self._queue,), name=self._name, daemon=True
                ).start()
        self._queue.put((future, partial(work, *args, **kwargs)))
        return future


def _stop(queue: _Queue, threads: int) -> None:
    for _ in range(threads):
        queue.put(None)


def _work(queue: _Queue) -> None:
    while (item := queue.get()) is not None:
        future, work = item
        if not future.set_running_or_notify_cancel():
            continue
        try:
            result = work()
        except BaseException as error:  # noqa: BLE001  # raised where the result is waited for
            future.set_exception(error)
        else:
            future.set_result(result)
        del item, future, work  # nothing is held while there is nothing to do
