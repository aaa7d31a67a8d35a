"""What the fingers look like when nothing touches them, taken before the first episode.

Gels change from day to day: a reference of the day is better than none. It is the median of a few
frames in which nothing changes. Whether nothing is touched only the operator knows, and only what
the operator asked for counts as that.
"""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from exumi_data.errors import ExumiError
from exumi_data.model import CalibrationItem
from exumi_data.model.calibration import RIG_REFERENCE
from exumi_data.store import jpeg
from exumi_recorders.calibration.files import array_path
from exumi_recorders.calibration.tactile import captured_reference
from exumi_recorders.contract import Files, Sample
from exumi_recorders.finalise.clocks import utc_text
from exumi_recorders.finalise.touch import NOTHING_TOUCHED, SESSION_REFERENCE
from exumi_recorders.recording.device import RecordedStream

__all__ = ["ReferenceTaker", "Taken"]

_FRAMES = 9
_PATIENCE_NS = 10_000_000_000
_OLDEST_NS = 3_000_000_000


@dataclass(frozen=True, slots=True)
class Taken:
    """What became of a stream's reference.

    Attributes
    ----------
    stream : str
    item : CalibrationItem or None
    image : (H, W, C) uint8 or None
    problem : str or None
        Why there is none.
    """

    stream: str
    item: CalibrationItem | None = None
    image: np.ndarray | None = None
    problem: str | None = None


@dataclass(slots=True)
class _Wanted:
    stream: RecordedStream
    since_ns: int
    nothing_touched: bool
    frames: dict[int, bytes] = field(default_factory=dict)


class ReferenceTaker:
    """Takes references of tactile cameras from the frames that a preview would show.

    Parameters
    ----------
    streams : iterable of RecordedStream
        Of which those of tactile cameras count.
    latest : callable
        Gives the newest frame of a stream.

    Attributes
    ----------
    streams : tuple of str
        Those of tactile cameras.
    """

    def __init__(
        self, streams: Iterable[RecordedStream], latest: Callable[[str], Sample | None]
    ) -> None:
        self._streams = {
            stream.name: stream
            for stream in streams
            if stream.port.kind == "tactile" and isinstance(stream.port.payload, Files)
        }
        self._latest = latest
        self._wanted: dict[str, _Wanted] = {}
        self.streams = tuple(self._streams)

    @property
    def is_busy(self) -> bool:
        """Whether frames are still being waited for."""
        return bool(self._wanted)

    def want(self, streams: Iterable[str], *, nothing_touched: bool) -> None:
        """Begin to take references from frames that come from now on.

        Parameters
        ----------
        streams : iterable of str
        nothing_touched : bool
            Whether the operator said so.
        """
        now_ns = time.monotonic_ns()
        for name in streams:
            self._wanted[name] = _Wanted(self._streams[name], now_ns, nothing_touched)

    def look(self) -> list[Taken]:
        """Take frames that have come; return what is done. Ten times a second is right.

        Returns
        -------
        list of Taken
        """
        now_ns = time.monotonic_ns()
        done = []
        for name, wanted in list(self._wanted.items()):
            sample = self._latest(name)
            if sample is not None and sample.time_host_ns > wanted.since_ns:
                wanted.frames[sample.time_host_ns] = sample.payload
            for time_ns in [each for each in wanted.frames if now_ns - each > _OLDEST_NS]:
                del wanted.frames[time_ns]
            if len(wanted.frames) >= _FRAMES or now_ns - wanted.since_ns > _PATIENCE_NS:
                done.append(_take(wanted))
                del self._wanted[name]
        return done


def _take(wanted: _Wanted) -> Taken:
    stream, payload = wanted.stream.name, wanted.stream.port.payload
    assert isinstance(payload, Files)  # noqa: S101  # others are not wanted
    frames = []
    for file in wanted.frames.values():
        frame = np.empty((payload.height, payload.width, payload.channels), np.uint8)
        try:
            jpeg.decode_into(file, frame)
        except ExumiError:
            continue
        frames.append(frame)
    try:
        captured = captured_reference(frames, stream)
    except ExumiError as error:
        return Taken(stream, problem=error.what)
    item = captured.items[RIG_REFERENCE + stream].model_copy(
        update={
            "value": {NOTHING_TOUCHED: wanted.nothing_touched},
            "time": utc_text(time.time_ns()),
            "array": array_path(SESSION_REFERENCE + stream),
        }
    )
    return Taken(stream, item, captured.arrays[RIG_REFERENCE + stream])
