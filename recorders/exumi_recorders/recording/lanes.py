"""Queues from the devices' threads to the writer: bounded, and what is dropped is counted."""

import struct
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from exumi_recorders.contract import Sample
from exumi_recorders.journal.record import MAX_PAYLOAD_BYTES, NONE, pack_header

__all__ = ["Lane", "Limits", "Pressure"]


_FUTURE_NS = 1_000_000_000
"""A stamp that is further ahead than this is none: it would drag along all that come after it."""


@dataclass(frozen=True, slots=True)
class Limits:
    """How much may wait for the disk.

    Attributes
    ----------
    bytes : int
        Of all queues together.
    age_s : float
        Of the oldest sample.
    preview_share, warn_share : float
        The part of either at which the preview is given up, and at which the operator is told.
        At the whole, the newest samples of droppable streams are dropped.
    """

    bytes: int = 64 << 20
    age_s: float = 5.0
    preview_share: float = 0.08
    warn_share: float = 0.1


class Pressure:
    """How far the disk is behind, over all lanes of an episode.

    Parameters
    ----------
    limits : Limits
    """

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.lanes: tuple[Lane, ...] = ()

    def share(self, now_ns: int) -> float:
        """Return 0 where nothing waits, 1 where no more may.

        Parameters
        ----------
        now_ns : int
            CLOCK_MONOTONIC.
        """
        waiting = sum(lane.waiting_bytes for lane in self.lanes)
        oldest = max((lane.age_ns(now_ns) for lane in self.lanes), default=0)
        return max(waiting / self.limits.bytes, oldest / (self.limits.age_s * 1e9))


class Lane:
    """The queue of one stream while an episode is recorded.

    Its samples are numbered as they come, dropped ones as well: the journal shows a hole.

    Parameters
    ----------
    stream : str
    salt : int
        Of the stream's log.
    pressure : Pressure
    droppable : bool
    start_ns : int
        Samples that were stamped earlier are not recorded.
    payload_bytes : int, optional
        Length that all payloads have to have.

    Attributes
    ----------
    written, dropped, malformed : int
        Samples so far. Malformed ones are not what the port promised.
    waiting_bytes : int
    """

    def __init__(
        self,
        stream: str,
        salt: int,
        pressure: Pressure,
        *,
        droppable: bool,
        start_ns: int,
        payload_bytes: int | None = None,
    ) -> None:
        self.stream = stream
        self.written = self.dropped = self.malformed = 0
        self.waiting_bytes = 0
        self._salt = salt
        self._pressure = pressure
        self._droppable = droppable
        self._start_ns = start_ns
        self._stop_ns: int | None = None
        self._fixed = payload_bytes
        self._next = 0
        self._closed = False
        self._lock = threading.Lock()
        self._waiting: deque[tuple[int, bytes, bytes]] = deque()

    def put(self, sample: Sample, flags: int, now_ns: int) -> None:
        """Take a sample; for the thread of its device.

        Parameters
        ----------
        sample : Sample
        flags : int
            Those of the record.
        now_ns : int
            CLOCK_MONOTONIC.
        """
        if sample.time_host_ns < self._start_ns:
            return
        if sample.time_host_ns > now_ns + _FUTURE_NS:
            self.malformed += 1
            return
        if self._stop_ns is not None and sample.time_host_ns > self._stop_ns:
            return
        if self._droppable and self._pressure.share(now_ns) >= 1.0:
            with self._lock:
                self._next += 1
                self.dropped += 1
            return
        payload = sample.payload
        try:
            header = self._header(sample, flags, payload)
        except (struct.error, TypeError):
            self.malformed += 1
            return
        with self._lock:
            if self._closed:
                self.dropped += 1
                return
            self._next += 1
            self._waiting.append((now_ns, header, payload))
            self.waiting_bytes += len(header) + len(payload)

    def _header(self, sample: Sample, flags: int, payload: bytes) -> bytes:
        length = len(payload)
        if length > MAX_PAYLOAD_BYTES or self._fixed not in (None, length):
            msg = "the payload has another length"
            raise TypeError(msg)
        device = NONE if sample.time_device_ns is None else sample.time_device_ns
        sequence = NONE if sample.sequence is None else sample.sequence
        return pack_header(
            self._salt, self._next, sample.time_host_ns, device, sequence, flags, payload
        )

    def take(self) -> list[bytes]:
        """Return what waits, as pieces to write: it counts as waiting until `done`."""
        with self._lock:
            waiting = list(self._waiting)
        return [piece for _, header, payload in waiting for piece in (header, payload)]

    def done(self, pieces: Sequence[bytes]) -> None:
        """Say that what was taken is written.

        Parameters
        ----------
        pieces : sequence of bytes
        """
        count = len(pieces) // 2
        with self._lock:
            for _ in range(count):
                self._waiting.popleft()
            self.waiting_bytes -= sum(map(len, pieces))
            self.written += count

    def age_ns(self, now_ns: int) -> int:
        """Return for how long the oldest sample has waited.

        Parameters
        ----------
        now_ns : int
        """
        try:
            return max(0, now_ns - self._waiting[0][0])
        except IndexError:
            return 0

    def end_at(self, stop_ns: int) -> None:
        """Take no sample that was stamped later.

        Parameters
        ----------
        stop_ns : int
        """
        self._stop_ns = stop_ns

    def close(self, *, give_up: bool = False) -> None:
        """Take nothing any more.

        Parameters
        ----------
        give_up : bool
            What waits counts as dropped: it cannot be written.
        """
        with self._lock:
            self._closed = True
            if give_up:
                self.dropped += len(self._waiting)
                self._waiting.clear()
                self.waiting_bytes = 0
