"""How fast something turns: of a hand by its poses, of a camera by its gyroscope.

The size of an angular velocity is the same about any axes, so a camera and a tracker on one hand
need not be aligned, nor be known to be. Both are averaged over the same short time.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exumi_data.clips.gpmf import GyroTrack
from exumi_data.episode import StreamView
from exumi_data.standard import flags

__all__ = ["SPAN_S", "Turning", "of_gyro", "of_pose_stream", "of_poses"]

RowReader = Callable[[str, int, int], np.ndarray]

SPAN_S = 0.05
"""Time over which angular velocity is averaged: less shows a tracker's noise, more hides motion."""

_MOST_SPANS = 2.0
# Faster than a hand turns: the tracker was lost, or its world was set anew.
_FASTEST_RAD_PER_S = 20.0
_BLOCK = 1 << 16


@dataclass(frozen=True, slots=True, eq=False)
class Turning:
    """How fast something turns, over time.

    Attributes
    ----------
    time_ns : (N,) int64
        Strictly increasing.
    rad_per_s : (N,) float64
    """

    time_ns: NDArray[np.int64]
    rad_per_s: NDArray[np.float64]

    def between(self, start_ns: int, stop_ns: int) -> "Turning":
        """Return the part with ``start_ns <= time_ns < stop_ns``."""
        first, last = np.searchsorted(self.time_ns, [start_ns, stop_ns])
        return Turning(self.time_ns[first:last], self.rad_per_s[first:last])


def of_poses(time_ns: NDArray[np.int64], poses: NDArray[np.float64]) -> Turning:
    """Return how fast a tracked body turns.

    Parameters
    ----------
    time_ns : (N,) int64
        Strictly increasing.
    poses : (N, 7) float64
        x y z qx qy qz qw.

    Returns
    -------
    Turning
        Without the places where poses are missing or jump.
    """
    last = np.searchsorted(time_ns, time_ns + round(SPAN_S * 1e9))
    first = np.flatnonzero(last < len(time_ns))
    last = last[first]
    span_ns = time_ns[last] - time_ns[first]
    near = span_ns <= _MOST_SPANS * SPAN_S * 1e9
    first, last, span_ns = first[near], last[near], span_ns[near]
    # Both signs of a quaternion are the same rotation. The chord of two that are an angle apart is
    # twice the sine of a quarter of it.
    chord = np.minimum(
        np.linalg.norm(poses[last, 3:] - poses[first, 3:], axis=1),
        np.linalg.norm(poses[last, 3:] + poses[first, 3:], axis=1),
    )
    speed = 4.0 * np.arcsin(np.minimum(0.5 * chord, 1.0)) / (span_ns * 1e-9)
    middle = time_ns[first] + span_ns // 2
    # Times that were nudged lie a nanosecond apart.
    sound = (np.diff(middle, prepend=middle[:1] - 1) > 0) & (speed < _FASTEST_RAD_PER_S)
    return Turning(middle[sound], speed[sound])


def of_pose_stream(stream: StreamView, reader: RowReader) -> Turning:
    """Return how fast the body of a pose stream turns; memory stays at some numbers a pose.

    Parameters
    ----------
    stream : StreamView
        Of kind ``pose``. Samples that are flagged ``invalid`` are left out.
    reader : callable
        Gives rows of its arrays: name, first and last.
    """
    time = stream.time
    has_flags = "flags" in stream.metadata.arrays
    invalid = np.uint32(flags()["invalid"].mask)
    found: list[Turning] = []
    for start in range(0, len(time), _BLOCK):
        stop = min(start + _BLOCK, len(time))
        # A span that begins in this block may end in the next one.
        end = int(np.searchsorted(time, time[stop - 1] + round(_MOST_SPANS * SPAN_S * 1e9))) + 1
        end = min(end, len(time))
        poses = reader("data", start, end)
        kept = np.isfinite(poses).all(axis=1)
        if has_flags:
            kept &= (reader("flags", start, end) & invalid) == 0
        part = of_poses(time[start:end][kept], poses[kept])
        after = found[-1].time_ns[-1] if found and len(found[-1].time_ns) else time[0] - 1
        found.append(part.between(int(after) + 1, 1 << 62))
    if not found:
        return Turning(np.empty(0, np.int64), np.empty(0))
    return Turning(
        np.concatenate([part.time_ns for part in found]),
        np.concatenate([part.rad_per_s for part in found]),
    )


def of_gyro(gyro: GyroTrack) -> Turning:
    """Return how fast a camera turns, on its container's clock.

    Parameters
    ----------
    gyro : GyroTrack
    """
    time_s, values = gyro.time_s, gyro.rad_per_s
    angle = np.zeros((len(time_s), 3))
    angle[1:] = np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time_s)[:, None], axis=0)
    inside = (time_s >= time_s[0] + 0.5 * SPAN_S) & (time_s <= time_s[-1] - 0.5 * SPAN_S)
    middle = time_s[inside]
    turned = np.stack(
        [
            np.interp(middle + 0.5 * SPAN_S, time_s, angle[:, axis])
            - np.interp(middle - 0.5 * SPAN_S, time_s, angle[:, axis])
            for axis in range(3)
        ],
        axis=1,
    )
    return Turning(np.rint(middle * 1e9).astype(np.int64), np.linalg.norm(turned, axis=1) / SPAN_S)
