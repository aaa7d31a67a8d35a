"""The one thread that writes an episode's journal."""

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from exumi_recorders.contract import Event
from exumi_recorders.finalise.events import COUNTERS
from exumi_recorders.journal.journal import JournalWriter
from exumi_recorders.journal.log import is_full
from exumi_recorders.journal.space import Reserve, SpaceLimits, free_bytes
from exumi_recorders.recording.lanes import Lane

__all__ = ["DISK_FULL", "WriterThread"]

DISK_FULL = "disk_full"
_BATCH_S = 0.02
_SECOND_NS = 1_000_000_000
_CLOCK_NS = 2_000_000_000


class WriterThread:
    """Writes what waits in the lanes: at once where it is urgent, else every 20 ms.

    Parameters
    ----------
    journal : JournalWriter
    lanes : sequence of Lane
    counters : callable
        Returns what was lost so far, for the journal.
    limits : SpaceLimits
    reserve : Reserve

    Attributes
    ----------
    truncated : str or None
        Why it ended by itself.
    free_bytes : int
        Of the disk, when it was last looked at.
    """

    def __init__(
        self,
        journal: JournalWriter,
        lanes: Sequence[Lane],
        *,
        counters: Callable[[], Mapping[str, Any]],
        limits: SpaceLimits,
        reserve: Reserve,
    ) -> None:
        self.truncated: str | None = None
        self.free_bytes = free_bytes(journal.path)
        self.wake = threading.Event()
        self._journal = journal
        self._lanes = tuple(lanes)
        self._counters = counters
        self._limits = limits
        self._reserve = reserve
        self._events: deque[tuple[str, Event]] = deque()
        self._stop = threading.Event()
        self._last_counters: Mapping[str, Any] = {}
        self._counted_at = self._clocked_at = time.monotonic_ns()
        self._thread = threading.Thread(target=self._run, name="journal writer", daemon=True)

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    def put_event(self, device: str, event: Event) -> None:
        """Take an event; never dropped.

        Parameters
        ----------
        device : str
        event : Event
        """
        self._events.append((device, event))

    def stop(self) -> None:
        """Write what waits, and close the journal."""
        self._stop.set()
        self.wake.set()
        self._thread.join()

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                self.wake.wait(_BATCH_S)
                self.wake.clear()
                self._write()
                self._look_after(time.monotonic_ns())
                if (error := self._journal.flush_error) is not None:
                    raise error  # what was written may be lost: no better than if it could not be
                if self.truncated is not None:
                    break
            self._end()
        except OSError as error:
            self.truncated = DISK_FULL if is_full(error) else f"disk_error ({error.strerror})"
            self._give_up()
        except Exception as error:  # noqa: BLE001  # nobody would notice that nothing is written
            self.truncated = f"error ({type(error).__name__}: {error})"
            self._give_up()

    def _write(self) -> None:
        for lane in self._lanes:
            pieces = lane.take()
            if pieces:
                self._append(lane, pieces)
        while self._events:
            device, event = self._events[0]
            self._journal.append_event(device, event)
            self._events.popleft()

    def _append(self, lane: Lane, pieces: Sequence[bytes]) -> None:
        before = self._journal.records(lane.stream)
        try:
            self._journal.append(lane.stream, pieces)
        finally:
            # Of a disk that ran full meanwhile, some are there: they are not lost.
            written = self._journal.records(lane.stream) - before
            lane.done(pieces[: 2 * written])

    def _look_after(self, now_ns: int) -> None:
        if now_ns - self._clocked_at > _CLOCK_NS:
            self._clocked_at = now_ns
            self._journal.append_clock()
        if now_ns - self._counted_at > _SECOND_NS:
            self._counted_at = now_ns
            self._count(now_ns)
            self.free_bytes = free_bytes(self._journal.path)
            if self.free_bytes < self._limits.hard_bytes:
                self.truncated = DISK_FULL

    def _count(self, now_ns: int) -> None:
        counters = self._counters()
        if counters != self._last_counters:
            self._last_counters = counters
            self._journal.append_event("", Event(COUNTERS, now_ns, counters))

    def _end(self) -> None:
        if self.truncated is not None:
            self._reserve.release()
        for lane in self._lanes:
            lane.close()
        self._write()
        self._journal.append_clock()
        self._count(time.monotonic_ns())
        self._journal.stop(truncated=self.truncated)

    def _give_up(self) -> None:
        """Close the journal on a disk that takes nothing more, with what was kept back for that."""
        self._reserve.release()
        for lane in self._lanes:
            lane.close(give_up=True)
        try:
            self._write()
            self._count(time.monotonic_ns())
        except Exception:  # noqa: BLE001, S110  # the journal is whole without it
            pass
        try:
            self._journal.stop(truncated=self.truncated)
        except OSError:
            # Its state still says that it is being recorded, which recovers as well.
            self._journal.abandon()
