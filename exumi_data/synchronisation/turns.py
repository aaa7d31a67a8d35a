"""The lag between a tracked hand and a gyroscope on it, by how far both turn within a short time.

Angular speed (see `motion`) finds the place; but of poses it is a difference of two that lie close
together, and noisy. Over longer spans the turns stand out: each is a fixed mixture of those that a
gyroscope adds up to, whatever way it is mounted, and a bias is a constant. The lag is the one at
which least is left.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from exumi_data.clips.gpmf import GyroTrack
from exumi_data.synchronisation.estimate import LatencyEstimate
from exumi_data.synchronisation.lags import lag_grid, vertex

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

__all__ = ["TURNS_METHOD", "search_turns"]

TURNS_METHOD = "exumi-turns/1"

Float64Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]

_SPAN_S = 0.4
_MOST_SPAN_S = 0.6
_REACH_S, _STEP_S = 0.03, 0.005
_LONGEST_S = 60.0
_FEWEST = 30
_LEAST_RAD = 0.02
_EXPLAINED = 0.9
# Each pose is in two spans: their errors are not each its own.
_SHARED = 2.0**0.5


def search_turns(
    time_ns: Int64Array, poses: Float64Array, gyro: GyroTrack, offset_ns: int
) -> LatencyEstimate | None:
    """Estimate by how much poses are later than an offset says.

    Parameters
    ----------
    time_ns : (N,) int64
        Strictly increasing.
    poses : (N, 7) float64
        x y z qx qy qz qw.
    gyro : GyroTrack
        On the clip's clock.
    offset_ns : int
        What to add to the clip's times, right to some hundredths of a second.

    Returns
    -------
    LatencyEstimate or None
        To be added to the offset. None where the turns do not tell.
    """
    from scipy.spatial.transform import Rotation

    turned = _Turned.of(gyro)
    clip_s = (time_ns - offset_ns) * 1e-9
    margin = _REACH_S + 2 * _STEP_S
    inside = (clip_s >= turned.time_s[0] + margin) & (clip_s <= turned.time_s[-1] - margin)
    clip_s, poses = clip_s[inside], poses[inside]
    later = np.searchsorted(clip_s, clip_s + _SPAN_S)
    first = np.flatnonzero(later < len(clip_s))
    later = later[first]
    near = clip_s[later] - clip_s[first] <= _MOST_SPAN_S
    first, later = first[near], later[near]
    if len(first) < _FEWEST:
        return None
    hand = Rotation.from_quat(poses[:, 3:].copy())
    seen = np.asarray((hand[first].inv() * hand[later]).as_rotvec(), np.float64)
    if float(np.sqrt(np.mean(seen**2))) < _LEAST_RAD:
        return None
    lags = lag_grid(_REACH_S, _STEP_S)
    left = np.array([_left(seen, turned, clip_s, first, later, lag).var() for lag in lags])
    best = int(left.argmin())
    lag = vertex(lags, left, best)
    if lag is None or left[best] > (1.0 - _EXPLAINED) * float(seen.var()):
        return None
    # What a change of the lag would leave, less what the mixture makes up for.
    change = _left(seen, turned, clip_s, first, later, lag + _STEP_S)
    change -= _left(seen, turned, clip_s, first, later, lag - _STEP_S)
    strength = float(np.sum((change / (2 * _STEP_S)) ** 2))
    noise = float(np.sum(_left(seen, turned, clip_s, first, later, lag) ** 2))
    free = 3 * len(first) - 13
    if strength <= 0 or free <= 0:
        return None
    return LatencyEstimate(
        offset_s=lag,
        sigma_s=_SHARED * float(np.sqrt(noise / free / strength)),
        n_events=1,
        method=TURNS_METHOD,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Turned:
    """How far a gyroscope has turned since its first sample."""

    time_s: Float64Array
    quaternions: Float64Array

    @classmethod
    def of(cls, gyro: GyroTrack) -> _Turned:
        """Add up the middle of a recording, a minute at most."""
        from scipy.spatial.transform import Rotation

        middle = 0.5 * float(gyro.time_s[0] + gyro.time_s[-1])
        part = gyro.between(middle - 0.5 * _LONGEST_S, middle + 0.5 * _LONGEST_S) or gyro
        speed = 0.5 * (part.rad_per_s[1:] + part.rad_per_s[:-1])
        steps = Rotation.from_rotvec(speed * np.diff(part.time_s)[:, None]).as_quat()
        return cls(part.time_s, _products(np.asarray(steps, np.float64)))

    def at(self, time_s: Float64Array) -> Rotation:
        """Return how far it has turned at some times."""
        from scipy.spatial.transform import Rotation

        high = np.clip(np.searchsorted(self.time_s, time_s), 1, len(self.time_s) - 1)
        share = (time_s - self.time_s[high - 1]) / (self.time_s[high] - self.time_s[high - 1])
        before, after = self.quaternions[high - 1], self.quaternions[high]
        # Two samples are some milliseconds apart: the chord is the arc.
        return Rotation.from_quat(before + share[:, None] * (after - before))


def _products(steps: Float64Array) -> Float64Array:
    """Return the running products of unit quaternions xyzw, beginning with none, (N + 1, 4)."""
    out = np.empty((len(steps) + 1, 4))
    x, y, z, w = 0.0, 0.0, 0.0, 1.0
    out[0] = x, y, z, w
    for row, (a, b, c, d) in enumerate(steps.tolist(), start=1):
        x, y, z, w = (
            w * a + x * d + y * c - z * b,
            w * b - x * c + y * d + z * a,
            w * c + x * b - y * a + z * d,
            w * d - x * a - y * b - z * c,
        )
        out[row] = x, y, z, w
    return out


def _left(  # what is compared, and at which lag
    seen: Float64Array,
    turned: _Turned,
    clip_s: Float64Array,
    first: NDArray[np.intp],
    later: NDArray[np.intp],
    lag_s: float,
) -> Float64Array:
    """Return what is left of the hand's turns at a lag, (N, 3), radians."""
    at = turned.at(clip_s - lag_s)
    own = (at[first].inv() * at[later]).as_rotvec()
    columns = np.hstack([own, np.ones((len(own), 1))])
    factors = np.linalg.lstsq(columns, seen, rcond=None)[0]
    return np.asarray(seen - columns @ factors, np.float64)
