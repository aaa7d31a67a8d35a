"""Frames, logged one by one in bounded blocks; a damaged one is missing, the others are there."""

from collections.abc import Callable, Sequence

import numpy as np
import rerun as rr

from exumi_data.episode import StreamView
from exumi_data.errors import DamagedDataError, LimitError, UnsupportedError
from exumi_data.tactile.images import UInt8Array
from exumi_data.view.log import EVENTS_SHOWN, Event, Log
from exumi_data.view.looks import Look, Picture, look_of

__all__ = ["Block", "OnGrey", "log_frames", "watch_frames"]

OnGrey = Callable[[int, UInt8Array | None], None]
"""Told about each frame: its index, and its (H, W) luma, None where it is damaged."""

_BLOCK_BYTES = 4 << 20
_BLOCK_ROWS = 256


class Block:
    """Rows that are sent together.

    Parameters
    ----------
    log : Log
    path : str
    columns : callable
        Makes the columns of blobs.
    """

    def __init__(
        self,
        log: Log,
        path: str,
        columns: Callable[[Sequence[bytes | None]], rr.ComponentColumnList],
    ) -> None:
        self._log = log
        self._path = path
        self._columns = columns
        self._times: list[int] = []
        self._blobs: list[bytes | None] = []
        self._bytes = 0

    def add(self, time_ns: int, blob: bytes | None) -> None:
        """Add a row; send all where they are enough."""
        self._times.append(time_ns)
        self._blobs.append(blob)
        self._bytes += 0 if blob is None else len(blob)
        if self._bytes >= _BLOCK_BYTES or len(self._times) >= _BLOCK_ROWS:
            self.send()

    def send(self) -> None:
        """Send what is there."""
        if self._times:
            time = np.array(self._times, np.int64)
            self._log.rows(self._path, time, self._columns(self._blobs))
        self._times, self._blobs, self._bytes = [], [], 0


def log_frames(
    log: Log, stream: StreamView, path: str, *, on_grey: OnGrey | None = None
) -> list[Event]:
    """Log a stream's frames.

    Parameters
    ----------
    log : Log
    stream : StreamView
        With frames.
    path : str
    on_grey : callable, optional
        Told about each frame.

    Returns
    -------
    list of Event
        Frames that are missing.
    """
    look = look_of(stream)
    look.begin(log, path)
    block = Block(log, path, look.columns)

    def on_frame(time_ns: int, picture: Picture | None) -> None:
        block.add(time_ns, None if picture is None else picture.data())
        log.on_samples(1)

    events = _each(log, stream, look, on_frame, on_grey)
    block.send()
    return events


def watch_frames(log: Log, stream: StreamView, on_grey: OnGrey) -> list[Event]:
    """Decode a stream's frames without logging them.

    Parameters
    ----------
    log : Log
    stream : StreamView
    on_grey : callable
        Told about each frame.

    Returns
    -------
    list of Event
        Frames that are missing.
    """
    return _each(log, stream, look_of(stream), lambda *_: log.on_samples(1), on_grey)


def _each(
    log: Log,
    stream: StreamView,
    look: Look,
    on_frame: Callable[[int, Picture | None], None],
    on_grey: OnGrey | None,
) -> list[Event]:
    events: list[Event] = []
    for index, time_ns in enumerate(stream.time.tolist()):
        picture = grey = None
        try:
            read = look.read(index)
            grey = None if on_grey is None else read.grey()
            picture = read
        except (DamagedDataError, LimitError, UnsupportedError) as error:
            log.fault(stream.name, error, frame=True)
            if len(events) <= EVENTS_SHOWN:
                text = f"{stream.name}: frame {index} is missing: {error.reason}"
                events.append(Event(time_ns, text, "ERROR"))
        on_frame(time_ns, picture)
        if on_grey is not None:
            on_grey(index, grey)
    return events
