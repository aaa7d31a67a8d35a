"""How a recording is going, in numbers that cost next to nothing to ask for."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from types import MappingProxyType
from typing import Any

__all__ = ["DeviceStatus", "Problem", "RecordingStatus", "StreamMeter", "StreamStatus"]

_KEPT = 256
_WINDOW_NS = 2_000_000_000
_NOTHING: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Problem:
    """Something that the operator has to look at.

    Attributes
    ----------
    where : str
        The stream or the device; empty for the recorder itself.
    code : str
        ``device_lost``, ``no_samples``, ``malformed``, ``frozen``, ``disk_slow``, ``dropping``,
        ``disk_full``, ``disk_error``, ``device``.
    text : str
        A sentence.
    """

    where: str
    code: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamStatus:
    """How one stream is.

    Attributes
    ----------
    name, device, kind : str
    rate_hz : float or None
        Over the last two seconds.
    jitter_s : float or None
        1.4826 times the median distance of the intervals from their median.
    age_s : float or None
        Of the newest sample, by its host time.
    samples : int
        Written in this episode.
    dropped : int
        In this episode, because the disk could not keep up.
    lost : mapping of str to int
        In this episode, by cause, as the device counts; and what it sent in a wrong form.
    queue_bytes : int
    queue_age_s : float
    """

    name: str
    device: str
    kind: str
    rate_hz: float | None = None
    jitter_s: float | None = None
    age_s: float | None = None
    samples: int = 0
    dropped: int = 0
    lost: Mapping[str, int] = field(default_factory=lambda: _NOTHING)
    queue_bytes: int = 0
    queue_age_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceStatus:
    """How one device is.

    Attributes
    ----------
    name : str
    connected : bool
    readings : mapping
        As the driver tells: ``agc``, ``magnet`` ...
    """

    name: str
    connected: bool
    readings: Mapping[str, Any] = field(default_factory=lambda: _NOTHING)


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingStatus:
    """How a recorder is.

    Attributes
    ----------
    recording : bool
    episode : str or None
        Id of the episode that is being recorded.
    elapsed_s : float
        Since it began.
    bytes : int
        Written of it.
    pressure : float
        0 where nothing waits for the disk, 1 where samples are dropped.
    truncated : str or None
        Why the recording ended by itself: ``disk_full``, or an error of the disk.
    free_bytes : int
        Of the disk; -1 where nothing is being recorded.
    streams : tuple of StreamStatus
    devices : tuple of DeviceStatus
    problems : tuple of Problem
    """

    recording: bool
    episode: str | None
    elapsed_s: float
    bytes: int
    pressure: float
    truncated: str | None
    free_bytes: int
    streams: tuple[StreamStatus, ...]
    devices: tuple[DeviceStatus, ...]
    problems: tuple[Problem, ...]


class StreamMeter:
    """Keeps the last times of a stream; written by one thread, read by any."""

    def __init__(self) -> None:
        self.last_host_ns: int | None = None
        self.last_arrival_ns: int | None = None
        self._times: deque[int] = deque(maxlen=_KEPT)

    def note(self, time_host_ns: int, now_ns: int) -> None:
        """Take note of a sample.

        Parameters
        ----------
        time_host_ns, now_ns : int
        """
        self.last_host_ns = time_host_ns
        self.last_arrival_ns = now_ns
        self._times.append(time_host_ns)

    def measure(self, now_ns: int) -> tuple[float | None, float | None]:
        """Return rate (Hz) and jitter (s) of the last two seconds.

        Parameters
        ----------
        now_ns : int
        """
        times = [time for time in self._times.copy() if now_ns - time <= _WINDOW_NS]
        if len(times) < 3:
            return None, None
        span = times[-1] - times[0]
        intervals = sorted(b - a for a, b in pairwise(times))
        middle = intervals[len(intervals) // 2]
        distances = sorted(abs(each - middle) for each in intervals)
        jitter = 1.4826e-9 * distances[len(distances) // 2]
        return ((len(times) - 1) * 1e9 / span if span > 0 else None), jitter
