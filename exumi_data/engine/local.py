"""Processes of this machine: bounded queues, crashes named, Ctrl-C clean."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing.process import BaseProcess
from queue import Empty, SimpleQueue
from types import FrameType
from typing import TypeVar

from exumi_data.engine.outcome import Engine, Outcome
from exumi_data.engine.work import CLEAN_UP_S, call, call_in_worker, stop, use_one_thread
from exumi_data.errors import ExumiError
from exumi_data.stopping import Stopped

__all__ = ["default_workers", "map_locally", "warm_up"]

Item = TypeVar("Item")
Value = TypeVar("Value")

_QUEUED_PER_WORKER = 4
_LOOK_S = 0.5
_SAFE_PATH = "PYTHONSAFEPATH"


def default_workers() -> int:
    """Return how many processes this process may use: its cores, or what PYTHON_CPU_COUNT says.

    Python itself knows the variable since 3.13; containers that limit time, not cores, need it.
    """
    told = os.environ.get("PYTHON_CPU_COUNT", "")
    if told.isdecimal() and int(told) > 0:
        return int(told)
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def _prepare_worker() -> None:
    try:
        _heed_signals()
    except Stopped:
        os._exit(1)  # the pool would show a traceback


def _heed_signals() -> None:
    # Ctrl-C reaches every process of the terminal; only the parent acts on it, and tells the
    # workers with SIGTERM, which unwinds them so that they remove what they had half written.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, stop)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    use_one_thread()


def _end_with_parent() -> None:
    """Stop this worker when its parent is gone: a killed one cannot tell, and nobody would ask."""
    # The signal must reach the main thread: only there it interrupts what that is waiting for.
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGINT})
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)


def map_locally(
    function: Callable[[Item], Value], items: Iterable[Item], workers: int | None
) -> Generator[Outcome[Item, Value], None, None]:
    """Do what `exumi_data.engine.map_items` does, here.

    Parameters
    ----------
    function : callable
    items : iterable
    workers : int or None
        Processes; default all cores; 1 runs in this process.

    Yields
    ------
    Outcome
    """
    workers = workers or default_workers()
    if workers == 1:
        for item in items:
            yield call(function, item)
        return
    source = iter(items)
    while True:
        suspects = yield from _run_pool(function, source, workers)
        if not suspects:
            return
        # A pool broke. Each item that was under way is tried alone: the one that breaks a pool
        # of its own is the culprit.
        for item in suspects:
            died = yield from _run_pool(function, iter([item]), 1)
            if died:
                yield Outcome(item, None, _crash())


def warm_up(*modules: str, workers: int | None = None, engine: Engine | None = None) -> None:
    """Let modules be imported for the workers to come, while this process does something else.

    Worker processes are forked from a helper process: what that one has imported, they need not.
    Without effect once there have been workers, where there will be none, and where processes
    cannot be forked.

    Parameters
    ----------
    *modules : str
        Modules that hold the functions for `map_items`.
    workers : int, optional
    engine : Engine, optional
        As for `map_items`. With an engine nothing is done: its workers are not ours.
    """
    if engine is not None or os.name != "posix" or (workers or default_workers()) == 1:
        return
    multiprocessing.get_context("forkserver").set_forkserver_preload(["__main__", *modules])
    _start_helper()


def _start_helper() -> None:
    """Start the process that workers are forked from, if there is none yet."""
    from multiprocessing import forkserver, resource_tracker

    # Ctrl-C reaches every process of the terminal, and is the parent's to act on: the helper would
    # show a traceback in the middle of its imports, and a worker before it heeds signals. (The
    # tracker comes first: it would unblock.)
    with _without_current_folder():
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            forkserver.ensure_running()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _without_current_folder() -> Iterator[None]:
    """Let Python processes that start here not look for modules in the current folder.

    Those helpers are started with ``python -c``, which would: a file ``selectors.py`` in a dataset
    that somebody downloaded, and went into, would be run in place of Python's own.
    """
    before = os.environ.get(_SAFE_PATH)
    os.environ[_SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[_SAFE_PATH]
        else:
            os.environ[_SAFE_PATH] = before


def _pool(workers: int) -> ProcessPoolExecutor:
    context = multiprocessing.get_context("forkserver" if os.name == "posix" else "spawn")
    if os.name == "posix":
        _start_helper()
    return ProcessPoolExecutor(workers, mp_context=context, initializer=_prepare_worker)


def _crash() -> ExumiError:
    return ExumiError(
        "the worker process died while it was working on this (a crash in a codec, or out of "
        "memory)",
        fix="Try again with one worker (--workers 1) to see where. In a program of your own, "
        'the call belongs under `if __name__ == "__main__":`, or workers cannot start.',
    )


def _stop_workers(pool: ProcessPoolExecutor) -> threading.Timer:
    """Tell workers to end, and see to it that they do."""
    processes = list(pool._processes.values())  # no public way to stop
    for process in processes:
        process.terminate()
    # A worker that waits for a lock which another one took along when it ended would wait for
    # ever, and the pool for it.
    last_resort = threading.Timer(CLEAN_UP_S, _kill, (processes,))
    last_resort.daemon = True
    last_resort.start()
    return last_resort


@contextmanager
def signals_later() -> Iterator[None]:
    """Let signals that end the program wait for the end of the block; a second comes at once.

    An exception of a signal's handler may come at any place of the main thread. Within a pool it
    would leave locks that the pool's own threads wait for, and workers that nobody knows.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread runs handlers
        return
    numbers = (getattr(signal, name, None) for name in ("SIGINT", "SIGTERM", "SIGHUP"))
    handlers = {number: signal.getsignal(number) for number in numbers if number is not None}
    came: list[int] = []
    is_waiting = True

    def take(number: int, frame: FrameType | None) -> None:
        came.append(number)
        if len(came) > 1 or not is_waiting:
            handler = handlers[signal.Signals(number)]
            assert callable(handler)  # noqa: S101  # others were not replaced
            handler(number, frame)

    replaced = [number for number, handler in handlers.items() if callable(handler)]
    try:
        for number in replaced:
            signal.signal(number, take)
        yield
    finally:
        is_waiting = False
        for number in replaced:
            signal.signal(number, handlers[number])
        if came:
            signal.raise_signal(came[0])


def _next_of(ended: SimpleQueue[Future[Value]]) -> Future[Value]:
    """Wait for a future that ends, looking for signals now and then.

    One that comes while the process is stopped (Ctrl-Z, then kill) may reach another thread when it
    goes on, and then does not interrupt what this one waits for.
    """
    while True:
        with suppress(Empty):
            return ended.get(timeout=_LOOK_S)


def _kill(processes: Sequence[BaseProcess]) -> None:
    for process in processes:
        process.kill()


def _run_pool(
    function: Callable[[Item], Value], source: Iterator[Item], workers: int
) -> Generator[Outcome[Item, Value], None, list[Item]]:
    """Run items until the source ends; return those that were under way if the pool breaks."""
    pool = _pool(workers)
    pending: dict[Future[Outcome[Item, Value]], Item] = {}
    # Waiting here, other than in `concurrent.futures.wait`, holds no lock when a signal comes.
    ended: SimpleQueue[Future[Outcome[Item, Value]]] = SimpleQueue()
    suspects: list[Item] = []
    exhausted = False
    last_resort: threading.Timer | None = None
    try:
        while True:
            while not (exhausted or suspects) and len(pending) < workers * _QUEUED_PER_WORKER:
                try:
                    item = next(source)
                except StopIteration:
                    exhausted = True
                    break
                try:
                    with signals_later():
                        future = pool.submit(call_in_worker, function, item)
                        pending[future] = item
                        future.add_done_callback(ended.put)
                except BrokenProcessPool:
                    suspects.append(item)
                    break
            if not pending:
                return suspects
            future = _next_of(ended)
            item = pending.pop(future)
            error = future.exception()
            if isinstance(error, BrokenProcessPool):
                suspects.append(item)
            elif error is None:
                yield future.result()
            else:
                # The function, the item or its value cannot be sent between processes.
                yield Outcome(item, None, ExumiError(f"{type(error).__name__}: {error}"))
    except BaseException:
        last_resort = _stop_workers(pool)
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        if last_resort is not None:
            last_resort.cancel()
