"""One timeline for all streams of an episode: ticks, and which samples stand at them."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from exumi_data.episode import StreamView
from exumi_data.errors import DamagedDataError
from exumi_data.geometry import interpolate_linear, interpolate_poses
from exumi_data.standard import flags
from exumi_data.ticks import image_tolerance_ns, max_gap_ns, tick_times_ns
from exumi_data.time import bracket_indices, nearest_indices

__all__ = ["MAX_FRAMES", "Ticks", "common_ticks", "frames_at", "tick_times", "values_at"]

MAX_FRAMES = 2_000_000
"""Frames of the longest episode: nine hours of 60 a second."""
_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Ticks:
    """Where all streams of an episode overlap.

    Attributes
    ----------
    start_ns : int
        The first tick.
    valid : (M,) bool
        Ticks at which every stream has a sample within reach.
    gaps : dict of str to int
        How many ticks each stream misses.
    """

    start_ns: int
    valid: np.ndarray
    gaps: dict[str, int]

    def longest(self) -> tuple[int, int]:
        """Return first and one after the last tick of the longest stretch without a gap."""
        edges = np.flatnonzero(np.diff(np.concatenate(([0], self.valid.view(np.int8), [0]))))
        starts, stops = edges[::2], edges[1::2]
        if not len(starts):
            return 0, 0
        best = int((stops - starts).argmax())
        return int(starts[best]), int(stops[best])


def _usable(stream: StreamView) -> tuple[np.ndarray, np.ndarray]:
    """Return times and rows of the samples that their device did not call invalid."""
    time = stream.time
    rows = np.arange(len(time))
    if "flags" in stream.metadata.arrays:
        rows = np.flatnonzero((stream.array("flags") & np.uint32(flags()["invalid"].mask)) == 0)
    return time[rows], rows


def tick_times(start_ns: int, first: int, stop: int, fps: Fraction) -> np.ndarray:
    """Return the times of ticks, (M,) int64.

    Parameters
    ----------
    start_ns : int
        Of tick 0.
    first, stop : int
        From tick `first` to before tick `stop`.
    fps : Fraction
    """
    return start_ns + tick_times_ns(np.arange(first, stop, dtype=np.int64), 1 / fps)


def common_ticks(streams: Sequence[StreamView], timeline: str | None, fps: Fraction) -> Ticks | str:
    """Find the ticks of an episode; else say why there are none.

    Parameters
    ----------
    streams : sequence of StreamView
    timeline : str or None
        The stream with whose first frame, once all streams have begun, the ticks begin.
    fps : Fraction
    """
    samples = {stream.name: _usable(stream)[0] for stream in streams}
    for name, time in samples.items():
        if not len(time):
            return f"stream {name!r} has no sample"
    begin = max(int(time[0]) for time in samples.values())
    end = min(int(time[-1]) for time in samples.values())
    if timeline is not None:
        time = samples[timeline]
        anchor = int(np.searchsorted(time, begin))
        begin = int(time[anchor]) if anchor < len(time) else end + 1
    if end < begin:
        return "its streams do not overlap in time"
    count = int(Fraction(end - begin, _NS) * fps) + 1
    if count > MAX_FRAMES:
        return f"it would have {count:,} frames; at most {MAX_FRAMES:,} are written"
    at = tick_times(begin, 0, count, fps)
    valid = np.ones(count, bool)
    gaps: dict[str, int] = {}
    for stream in streams:
        reached = _reached(stream, samples[stream.name], at, fps)
        if not reached.all():
            gaps[stream.name] = int((~reached).sum())
        valid &= reached
    return Ticks(begin, valid, gaps)


def _reached(stream: StreamView, time: np.ndarray, at: np.ndarray, fps: Fraction) -> np.ndarray:
    if stream.is_image:
        return nearest_indices(time, at, image_tolerance_ns(time, 1 / fps)) >= 0
    return bracket_indices(time, at, max_gap_ns(time)).valid


def frames_at(stream: StreamView, at: np.ndarray) -> np.ndarray:
    """Return the frame nearest to each tick, (M,) int64.

    Parameters
    ----------
    stream : StreamView
        Of images.
    at : (M,) int64
        Ticks that `common_ticks` calls valid.
    """
    time, rows = _usable(stream)
    # How far is far enough was settled by `common_ticks`.
    return rows[nearest_indices(time, at, 2**62)]


def values_at(stream: StreamView, at: np.ndarray) -> np.ndarray:
    """Return the values at each tick, (M, C) float64.

    Poses by slerp on the shorter arc, widths and wrenches linearly; of taxels those of the nearest
    sample, which like images are never blended.

    Parameters
    ----------
    stream : StreamView
        Of poses, widths, wrenches or taxels.
    at : (M,) int64
        Ticks that `common_ticks` calls valid.

    Raises
    ------
    DamagedDataError
        A value is not finite, or a quaternion is zero.
    """
    time, rows = _usable(stream)
    data = stream.data[rows]
    if stream.kind == "taxels":
        nearest = data[nearest_indices(time, at, 2**62)]
        return _finite(nearest.reshape(len(at), -1).astype(np.float64), stream)
    gap = max_gap_ns(time)
    try:
        if stream.kind == "pose":
            return interpolate_poses(time, data, at, gap)[0]
        return interpolate_linear(time, data, at, gap)[0].reshape(len(at), -1)
    except ValueError as error:
        raise DamagedDataError(f"stream {stream.name!r}: {error}") from None


def _finite(values: np.ndarray, stream: StreamView) -> np.ndarray:
    if not np.isfinite(values).all():
        raise DamagedDataError(f"stream {stream.name!r}: a value is not finite")
    return values
