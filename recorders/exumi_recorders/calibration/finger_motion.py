"""When a camera sees the fingers move, against the encoder: what two frames differ by is their way.

For a lag, the way of the fingers from one frame to the next is read off the encoder's width, at the
frames' own times: so frames that come unevenly, or are lost, do no harm. It is fitted to what the
frames differ by with gain, offset and trend, for each lag of a dense grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from exumi_data.synchronisation.lags import lag_grid, vertex
from exumi_data.time import bracket_indices

__all__ = ["METHOD", "FingerLag", "finger_lag"]

METHOD = "exumi-finger-motion/1"

Float64Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]

_REACH_S, _STEP_S = 0.4, 0.005
# Around the best lag, for what parts of the recording say.
_NEAR = 12
_VERTEX_REACH = 3
_PARTS = 10
# An encoder's steps are as large as the fingers' way within a frame; a mean over both sides shifts
# nothing.
_SMOOTH_FRAMES, _LEAST_SMOOTH_NS = 2.0, 50e6
_GAP_PERIODS = 3.5
_LEAST_SHARE = 0.5
# Another minimum this close to the best one, measured from the highest, makes the lag ambiguous.
_AMBIGUOUS = 1.2


@dataclass(frozen=True, slots=True)
class FingerLag:
    """By how much frames are late.

    Attributes
    ----------
    lag_s : float
    sigma_s : float
        Standard deviation: a jackknife's over ten stretches of the recording.
    """

    lag_s: float
    sigma_s: float


def finger_lag(
    frame_ns: Int64Array,
    energy: NDArray[np.floating],
    width_ns: Int64Array,
    width_m: NDArray[np.floating],
) -> FingerLag | None:
    """Find by how much frames are late relative to the widths.

    Parameters
    ----------
    frame_ns : (N,) int64
        Strictly increasing.
    energy : (N - 1,) float
        By how much each frame differs from the one before it.
    width_ns : (M,) int64
        Strictly increasing.
    width_m : (M,) float

    Returns
    -------
    FingerLag or None
        None where they do not tell: no motion, the best lag at the end of 0.4 s, or two lags that
        are about as good.
    """
    width = _smoothed(
        width_ns, np.asarray(width_m, np.float64), float(np.median(np.diff(frame_ns)))
    )
    lags = lag_grid(_REACH_S, _STEP_S)
    ways = np.stack([_way(frame_ns, width_ns, width, float(lag)) for lag in lags])
    rows = np.ones(len(energy), np.bool_)
    left, gain = _fitted(ways, energy, rows)
    best = int(left.argmin())
    lag = _vertex(lags, left, best)
    if lag is None or gain[best] <= 0 or _is_ambiguous(left, best):
        return None
    near = slice(max(best - _NEAR, 0), best + _NEAR + 1)
    without = []
    for first, last in pairwise(np.linspace(0, len(energy), _PARTS + 1).astype(int)):
        kept = rows.copy()
        kept[first:last] = False
        part, _ = _fitted(ways[near], energy, kept)
        found = _vertex(lags[near], part, int(part.argmin()))
        if found is None:
            return None
        without.append(found)
    away = np.array(without) - np.mean(without)
    sigma = float(np.sqrt((_PARTS - 1) / _PARTS * np.sum(away**2)))
    return FingerLag(lag, sigma)


def _smoothed(time_ns: Int64Array, width_m: Float64Array, frame_ns: float) -> Float64Array:
    span_ns = max(_SMOOTH_FRAMES * frame_ns, _LEAST_SMOOTH_NS)
    half = int(0.5 * span_ns / float(np.median(np.diff(time_ns))))
    kernel = np.ones(2 * half + 1) / (2 * half + 1)
    return np.convolve(np.pad(width_m, half, mode="edge"), kernel, "valid")


def _way(
    frame_ns: Int64Array, width_ns: Int64Array, width_m: Float64Array, lag_s: float
) -> Float64Array:
    """Return the fingers' way from each frame to the next, at a lag; NaN where it is not known."""
    gap_ns = int(_GAP_PERIODS * float(np.median(np.diff(width_ns))))
    low, weight, known = bracket_indices(width_ns, frame_ns - round(lag_s * 1e9), gap_ns)
    high = np.minimum(low + 1, len(width_m) - 1)
    at = np.where(known, width_m[low] + weight * (width_m[high] - width_m[low]), np.nan)
    return np.abs(np.diff(at))


def _fitted(
    ways: Float64Array, energy: NDArray[np.floating], rows: NDArray[np.bool_]
) -> tuple[Float64Array, Float64Array]:
    """Return the mean square that each lag leaves, infinite without overlap, and its gain."""
    trend = np.linspace(-0.5, 0.5, len(energy))
    left, gain = np.full(len(ways), np.inf), np.zeros(len(ways))
    for i, way in enumerate(ways):
        known = rows & np.isfinite(way)
        if np.count_nonzero(known) < max(_LEAST_SHARE * np.count_nonzero(rows), _PARTS):
            continue
        columns = np.column_stack([way[known], np.ones(np.count_nonzero(known)), trend[known]])
        gains = np.linalg.lstsq(columns, energy[known], rcond=None)[0]
        left[i] = np.mean((energy[known] - columns @ gains) ** 2)
        gain[i] = gains[0]
    return left, gain


def _vertex(lags_s: Float64Array, left: Float64Array, best: int) -> float | None:
    for reach in range(_VERTEX_REACH, 0, -1):
        found = vertex(lags_s, left, best, reach=reach)
        if found is not None:
            return found
    return None


def _is_ambiguous(left: Float64Array, best: int) -> bool:
    inner = left[1:-1]
    minima = 1 + np.flatnonzero((inner <= left[:-2]) & (inner <= left[2:]))
    others = left[minima[np.abs(minima - best) > 1]]
    if not len(others):
        return False
    highest = left[np.isfinite(left)].max()
    return bool(highest - others.min() > (highest - left[best]) / _AMBIGUOUS)
