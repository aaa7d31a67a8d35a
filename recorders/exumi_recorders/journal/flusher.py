"""Makes journals survive a power loss, twice a second, in a thread of its own."""

import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from exumi_recorders.journal.log import LogWriter

__all__ = ["FLUSH_PERIOD_S", "Flusher", "OnFlushed"]

FLUSH_PERIOD_S = 0.5
_PAUSE_S = 0.01

OnFlushed = Callable[[Path, int], None]
"""Told of a segment, and of how many of its bytes are safe."""


class Flusher:
    """Flush logs again and again, until it is stopped.

    Parameters
    ----------
    logs : sequence of LogWriter
    period_s : float
    on_flushed : callable, optional

    Attributes
    ----------
    error : OSError or None
        What the disk reported last: what was appended since the last flush may be lost.
    """

    def __init__(
        self,
        logs: Sequence[LogWriter],
        *,
        period_s: float = FLUSH_PERIOD_S,
        on_flushed: OnFlushed | None = None,
    ) -> None:
        self.error: OSError | None = None
        self._logs = tuple(logs)
        self._period_s = period_s
        self._on_flushed = on_flushed
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="journal flusher", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        began = time.monotonic()
        # From one beginning to the next: what takes long must not come off more seldom as well.
        while not self._stop.wait(max(_PAUSE_S, began + self._period_s - time.monotonic())):
            began = time.monotonic()
            for log in self._logs:
                try:
                    self.tell(log.flush())
                except OSError as error:
                    self.error = error

    def tell(self, flushed: Sequence[tuple[Path, int]]) -> None:
        """Tell what is safe now.

        Parameters
        ----------
        flushed : sequence of (pathlib.Path, int)
        """
        if self._on_flushed is not None:
            for path, length in flushed:
                self._on_flushed(path, length)

    def stop(self) -> None:
        """Stop; the logs can be closed when this returns."""
        self._stop.set()
        self._thread.join()
