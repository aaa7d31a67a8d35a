"""What a worker process does, whoever started it."""

import copy
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import TypeVar

from exumi_data.engine.outcome import Outcome
from exumi_data.errors import ExumiError
from exumi_data.stopping import Stopped

__all__ = ["CLEAN_UP_S", "call", "call_in_worker", "stop", "use_one_thread"]

Item = TypeVar("Item")
Value = TypeVar("Value")

CLEAN_UP_S = 5.0
"""How long a worker that is told to end may take: removing what is half written takes ms."""


def call(function: Callable[[Item], Value], item: Item) -> Outcome[Item, Value]:
    """Call a function; its exception is an outcome."""
    try:
        return Outcome(item, function(item), None)
    except Exception as error:  # noqa: BLE001  # every failure is an outcome
        return Outcome(item, None, error)


def call_in_worker(function: Callable[[Item], Value], item: Item) -> Outcome[Item, Value]:
    """Do what `call` does in a worker process, whose outcome is sent back."""
    try:
        outcome = call(function, item)
    except Stopped:
        # What was half written is removed by now; the pool would go on to the next item.
        os._exit(1)
    except SystemExit as error:
        return Outcome(item, None, ExumiError(f"it ended its process (status {error.code})"))
    if outcome.error is not None:
        return Outcome(item, None, _portable(outcome.error))
    return outcome


def _portable(error: Exception) -> Exception:
    """Return an exception that another process can rebuild: one that it cannot breaks the pool."""
    try:
        copy.copy(error)
    except Exception:  # noqa: BLE001  # whatever a third party's constructor does
        return ExumiError(f"{type(error).__name__}: {error}")
    return error


def stop(*_: object) -> None:
    """Unwind what this worker is doing, so that it removes what is half written: for SIGTERM."""
    # When one worker has ended, the pool tells the others again, while they still clean up.
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    threading.Thread(target=_end_soon, daemon=True).start()
    raise Stopped(1)


def _end_soon() -> None:
    """End this worker even if the exception was lost, as it is in a destructor."""
    time.sleep(CLEAN_UP_S)
    os._exit(1)


def use_one_thread() -> None:
    """Let OpenCV use one thread: there is a worker for every core."""
    # It reads the variable when it is imported; many workers never do.
    os.environ["OPENCV_FOR_THREADS_NUM"] = "1"
    if "cv2" in sys.modules:
        sys.modules["cv2"].setNumThreads(1)
