"""Finding touches in a curve of tactile activity, and how stale a curve's values are."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Touch", "find_touches", "holding_time_s", "still_touches"]

_QUIET = 2e-3
_QUIET_SHARE = 0.03
_TOP = 0.75
_LEAST_FRAMES = 4
_LEAST_QUIET = 2
_QUIET_FRAMES = 5
_LEAST_LEVEL = 0.01
# Frames further apart than this many median periods are not one rise.
_GAP_PERIODS = 3.5
_JUMP_UNITS = 3.0
_STILL_M = 5e-4


@dataclass(frozen=True, slots=True)
class Touch:
    """A contact with its beginning and its end: indices of frames.

    Attributes
    ----------
    rise : slice
        From a few quiet frames before the contact to where the activity is nearly full.
    fall : slice
        From where it is still nearly full to a few quiet frames after the contact.
    first, last : int
        First and last active frame.
    level : float
        Median activity while in contact.
    """

    rise: slice
    fall: slice
    first: int
    last: int
    level: float


def find_touches(time_ns: NDArray[np.int64], activity: NDArray[np.floating]) -> list[Touch]:
    """Find the touches that were recorded whole: quiet, contact, quiet.

    Parameters
    ----------
    time_ns : (N,) int64
        Strictly increasing.
    activity : (N,) float
        Share of active pixels, 0 to 1.

    Returns
    -------
    list of Touch
        In order. Touches whose rise or fall lies at a gap are left out, and so are those that
        hardly show.
    """
    if len(activity) < _LEAST_FRAMES + 2 * _LEAST_QUIET:
        return []
    quiet = max(_QUIET, _QUIET_SHARE * float(activity.max()))
    active = np.concatenate(([False], activity > quiet, [False]))
    edges = np.flatnonzero(active[1:] != active[:-1])
    period = np.diff(time_ns)
    limit = _GAP_PERIODS * float(np.median(period))
    starts, stops = edges[::2], edges[1::2]
    # Quiet frames belong to one touch only.
    before = np.concatenate(([0], stops))[:-1]
    after = np.concatenate((starts, [len(activity)]))[1:]
    found = []
    for start, stop, low, high in zip(starts, stops, before, after, strict=True):
        touch = _touch(activity, int(start), int(stop), int(low), int(high))
        if touch is not None and all(
            (period[part.start : part.stop - 1] <= limit).all() for part in (touch.rise, touch.fall)
        ):
            found.append(touch)
    return found


def _touch(
    activity: NDArray[np.floating], start: int, stop: int, low: int, high: int
) -> Touch | None:
    level = float(np.median(activity[start:stop]))
    lead, tail = min(start - low, _QUIET_FRAMES), min(high - stop, _QUIET_FRAMES)
    if stop - start < _LEAST_FRAMES or min(lead, tail) < _LEAST_QUIET or level < _LEAST_LEVEL:
        return None
    full = np.flatnonzero(activity[start:stop] >= _TOP * level)
    rise = slice(start - lead, start + int(full[0]) + 1)
    fall = slice(start + int(full[-1]), stop + tail)
    return Touch(rise, fall, start, stop - 1, level)


def still_touches(
    touches: Sequence[Touch],
    tactile_ns: NDArray[np.int64],
    width_ns: NDArray[np.int64],
    width_m: NDArray[np.floating],
) -> list[Touch]:
    """Keep the touches during which the gripper did not move: those that no grasp made.

    Parameters
    ----------
    touches : sequence of Touch
    tactile_ns : (N,) int64
        Times of the tactile frames.
    width_ns : (M,) int64
    width_m : (M,) float
        Metres.

    Returns
    -------
    list of Touch
    """
    found = []
    for touch in touches:
        edges = tactile_ns[[touch.rise.start, touch.fall.stop - 1]]
        start, stop = np.searchsorted(width_ns, edges)
        if stop > start and np.ptp(width_m[start:stop]) < _STILL_M:
            found.append(touch)
    return found


def holding_time_s(time_ns: NDArray[np.int64], values: NDArray[np.floating]) -> float:
    """Return how stale a curve gets that is stored more often than its source is asked.

    Such a curve stands still and then jumps by many of its units. An encoder that counts slowly
    stands still as well, but moves by one unit: that is resolution, not age.

    Parameters
    ----------
    time_ns : (N,) int64
        Strictly increasing.
    values : (N,) float
        One curve.

    Returns
    -------
    float
        By how much the time between changes exceeds the sampling period, on average over the way
        that the curve goes; seconds.
    """
    step = np.abs(np.diff(values))
    changed = np.flatnonzero(step > 0)
    if len(changed) < 2:
        return 0.0
    size = step[changed[1:]]
    jump = size >= _JUMP_UNITS * step[changed].min()
    waited = np.diff(time_ns[changed + 1]) - np.median(np.diff(time_ns))
    return float(np.sum(np.maximum(waited, 0.0) * size * jump) / np.sum(size)) * 1e-9
