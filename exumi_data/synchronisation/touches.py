"""Tactile activity against a gripper's width, by grasps.

A gel that is pressed in by so much shows so much, whether the gripper is closing or opening. So
activity is one function of the width, and where it seems to be two, one for closing and one for
opening, the two streams are not in step: the delay is the one that makes them one again. Neither
the threshold at which activity begins nor the softness of gel and object matters, for they are the
same on both ways. A gel that comes back slowly looks late, though.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exumi_data.synchronisation.estimate import LatencyEstimate, combine
from exumi_data.synchronisation.events import Touch, find_touches, holding_time_s

__all__ = ["TOUCH_METHOD", "estimate_touch_latency", "touch_delay"]

TOUCH_METHOD = "exumi-touch-latency/1"

Float64Array = NDArray[np.float64]

_MOST_TOUCHES = 32
_REACH_S = 1.0
_COARSE_S = 0.01
_FINE_S = 0.001
_NEAR_NS = 1_100_000_000
_CONTACT_STEPS = 14
_EARLY_S = 0.01
# How activity grows with the indentation: two curves, one bent more than the other.
_BENDS = np.array((0.5, 3.0))
_RIDGE = 1e-4
# Errors of a frame's activity in parts of the touch's level: constant, and by its own value.
_ERROR, _ERROR_SHARE = 0.01, 0.3
# What the model leaves in units of these errors: at least, as few frames show little of it; and at
# most, as beyond it activity is no function of the width.
_LEAST_RESIDUAL, _MOST_RESIDUAL = 0.2, 0.6
_LEAST_TRAVEL_M = 2e-4
# Gel and object do not come back quite the way they went. Both numbers are calibrated with
# benchmarks/sync_check.py.
_MISMATCH_M = 5e-5
_FLOOR_S = 2e-3
_MOST_SIGMA_S = 0.1


def estimate_touch_latency(
    tactile_ns: NDArray[np.int64],
    activity: NDArray[np.floating],
    width_ns: NDArray[np.int64],
    width_m: NDArray[np.floating],
) -> LatencyEstimate | None:
    """Estimate by how much tactile activity is late relative to a gripper's width.

    Parameters
    ----------
    tactile_ns : (N,) int64
        Strictly increasing.
    activity : (N,) float
        Share of active pixels, 0 to 1.
    width_ns : (M,) int64
        Strictly increasing, of the same clock.
    width_m : (M,) float
        Metres.

    Returns
    -------
    LatencyEstimate or None
        None where no grasp tells: the curves never rise and fall together.
    """
    touches = find_touches(tactile_ns, activity)
    if not touches or len(width_ns) < 2:
        return None
    chosen = np.unique(np.linspace(0, len(touches) - 1, _MOST_TOUCHES).round().astype(int))
    found = [touch_delay(tactile_ns, activity, width_ns, width_m, touches[i]) for i in chosen]
    return combine(found, floor_s=_FLOOR_S, method=TOUCH_METHOD)


def touch_delay(
    tactile_ns: NDArray[np.int64],
    activity: NDArray[np.floating],
    width_ns: NDArray[np.int64],
    width_m: NDArray[np.floating],
    touch: Touch,
) -> LatencyEstimate | None:
    """Estimate the latency by one touch.

    Parameters
    ----------
    tactile_ns : (N,) int64
    activity : (N,) float
    width_ns : (M,) int64
    width_m : (M,) float
    touch : Touch
        Of this activity.

    Returns
    -------
    LatencyEstimate or None
        None where the width hardly moves or does not explain the activity.
    """
    fit = _prepared(tactile_ns, activity, width_ns, width_m, touch)
    if fit is None:
        return None
    lags = _around(0.0, _REACH_S, _COARSE_S)
    best = int(fit.costs(lags).argmin())
    if best in (0, len(lags) - 1):
        return None
    lags = _around(float(lags[best]), 2 * _COARSE_S, _FINE_S)
    costs = fit.costs(lags)
    offset, curvature = _vertex(lags, costs)
    residual = float(np.sqrt(costs.min() / len(fit.level)))
    speed = fit.speed(offset)
    if curvature <= 0 or residual > _MOST_RESIDUAL or speed <= 0:
        return None
    sigma = np.hypot(
        np.sqrt(2.0 / curvature) * np.hypot(residual, _LEAST_RESIDUAL), _MISMATCH_M / speed
    )
    sigma = float(np.hypot(sigma, fit.stale_s))
    if sigma > _MOST_SIGMA_S:
        return None
    return LatencyEstimate(offset_s=offset, sigma_s=sigma, n_events=1, method=TOUCH_METHOD)


@dataclass(frozen=True, slots=True)
class _Fit:
    """What is fitted to one touch. Times are seconds from its first active frame.

    Attributes
    ----------
    frame_s, level : (n,) float64
        Frames of rise and fall, and their activity in parts of the touch's level.
    rise_frames : int
        How many of them are of the rise.
    quiet_s : (float, float)
        The last quiet frame before the touch, and the first after it.
    width_s, width_m : (m,) float64
    stale_s : float
        How old the widths are on average, beyond their times.
    """

    frame_s: Float64Array
    level: Float64Array
    rise_frames: int
    quiet_s: tuple[float, float]
    width_s: Float64Array
    width_m: Float64Array
    stale_s: float

    def width_at(self, time_s: Float64Array) -> Float64Array:
        return np.interp(time_s, self.width_s, self.width_m)

    def costs(self, lags: Float64Array) -> Float64Array:
        """Return how badly activity is one function of the width, for each lag of the frames.

        The contact begins somewhere between the last quiet and the first active frame. For each
        such moment the function is fitted by least squares; the best one counts.
        """
        contact_s = np.linspace(self.quiet_s[0] - _EARLY_S, 0.0, _CONTACT_STEPS)
        contact_m = self.width_at(contact_s - lags[:, None])
        width_m = self.width_at(self.frame_s - lags[:, None])
        depth = np.maximum(contact_m[:, :, None] - width_m[:, None], 0.0)
        depth /= depth.max(axis=-1, keepdims=True) + 1e-9
        weight = 1.0 / (_ERROR + _ERROR_SHARE * self.level)
        shown = self.level * weight
        curves = depth[..., None] * (1.0 + _BENDS) / (depth[..., None] + _BENDS) * weight[:, None]
        turned = curves.swapaxes(-1, -2)
        normal = turned @ curves + _RIDGE * len(shown) * np.eye(len(_BENDS))
        factors = np.linalg.solve(normal, turned @ shown[:, None])
        missed = (curves @ factors)[..., 0] - shown
        return np.asarray((missed**2).sum(axis=-1).min(axis=-1))

    def speed(self, lag: float) -> float:
        """Return the gripper's mean speed while activity rises and falls, m/s; 0 if it rests."""
        last, first = self.rise_frames - 1, self.rise_frames
        rise_s = np.array([self.quiet_s[0], self.frame_s[last]])
        fall_s = np.array([self.frame_s[first], self.quiet_s[1]])
        closed = -float(np.diff(self.width_at(rise_s - lag))[0])
        opened = float(np.diff(self.width_at(fall_s - lag))[0])
        if min(closed, opened) < _LEAST_TRAVEL_M:
            return 0.0
        return 0.5 * (closed / float(np.ptp(rise_s)) + opened / float(np.ptp(fall_s)))


def _prepared(
    tactile_ns: NDArray[np.int64],
    activity: NDArray[np.floating],
    width_ns: NDArray[np.int64],
    width_m: NDArray[np.floating],
    touch: Touch,
) -> _Fit | None:
    """Return the fit of a touch; None where there is no width."""
    frames = np.r_[touch.rise, touch.fall]
    origin = int(tactile_ns[touch.first])
    edges = tactile_ns[frames[[0, -1]]] + np.array([-_NEAR_NS, _NEAR_NS])
    start, stop = np.searchsorted(width_ns, edges)
    if stop - start < 2:
        return None
    return _Fit(
        frame_s=np.asarray((tactile_ns[frames] - origin) * 1e-9, np.float64),
        level=np.asarray(activity[frames], np.float64) / touch.level,
        rise_frames=touch.rise.stop - touch.rise.start,
        quiet_s=(
            float(tactile_ns[touch.first - 1] - origin) * 1e-9,
            float(tactile_ns[touch.last + 1] - origin) * 1e-9,
        ),
        width_s=np.asarray((width_ns[start:stop] - origin) * 1e-9, np.float64),
        width_m=np.asarray(width_m[start:stop], np.float64),
        stale_s=holding_time_s(width_ns[start:stop], width_m[start:stop]),
    )


def _around(centre: float, reach: float, step: float) -> Float64Array:
    count = round(reach / step)
    return np.asarray(centre + step * np.arange(-count, count + 1), np.float64)


def _vertex(lags: Float64Array, costs: Float64Array) -> tuple[float, float]:
    """Return where the parabola through the lowest costs has its minimum, and its curvature."""
    best = int(costs.argmin())
    near = slice(max(0, best - 6), best + 7)
    away = lags[near] - lags[best]
    square, slope, _ = np.polyfit(away, costs[near], 2)
    if square <= 0:
        return float(lags[best]), 0.0
    move = float(np.clip(-0.5 * slope / square, away[0], away[-1]))
    return float(lags[best]) + move, 2.0 * float(square)
