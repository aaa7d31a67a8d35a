"""Curves fitted to each other at trial lags: the mathematics of every search for a lag.

For a lag, the second group of curves is interpolated at the times of the first one, less the lag,
and each curve of the first group is fitted by all of the second with gains, offset and trend.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exumi_data.time import bracket_indices

__all__ = ["Curves", "Fitted", "lag_grid", "vertex"]

Float64Array = NDArray[np.float64]

_LEAST_SAMPLES = 16
_LEAST_OVERLAP = 0.5
# Longer than this many median periods is a gap, across which nothing is interpolated.
_GAP_PERIODS = 3.5
_MOST_CORRELATION = 0.98
_SLOPE_REACH_NS = 20_000_000
# Of the columns' length: keeps a curve that does not move from making the equations singular.
_RIDGE = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """The first curves as the second ones explain them, at one lag.

    Attributes
    ----------
    model : (N, C) float64
        What the fit says; NaN where the second curves are not known.
    left : (N, C) float64
        The first curves less the model; NaN likewise.
    valid : (N,) bool
        Where the second curves are known.
    gains : (K, C) float64
        How much of each second curve is in each first one.
    """

    model: Float64Array
    left: Float64Array
    valid: NDArray[np.bool_]
    gains: Float64Array

    @property
    def power(self) -> Float64Array:
        """Mean square of what is left of each first curve, (C,) float64."""
        return np.asarray(np.mean(self.left[self.valid] ** 2, axis=0))


class Curves:
    """Two groups of curves of the same motion, the second fitted to the first at any lag.

    Parameters
    ----------
    time_a_ns : (N,) int64
        Strictly increasing.
    a : (N,) or (N, C) float
        The curves to explain.
    time_b_ns : (M,) int64
        Strictly increasing, of the same clock.
    b : (M,) or (M, K) float
        The curves that explain them.

    Raises
    ------
    ValueError
        If lengths do not fit.
    """

    def __init__(
        self,
        time_a_ns: NDArray[np.int64],
        a: NDArray[np.floating],
        time_b_ns: NDArray[np.int64],
        b: NDArray[np.floating],
    ) -> None:
        if len(time_a_ns) != len(a) or len(time_b_ns) != len(b):
            raise ValueError("a curve needs one time for each value")
        self.time_a_ns, self.time_b_ns = time_a_ns, time_b_ns
        self.a = np.asarray(a, np.float64).reshape(len(a), -1)
        self.b = np.asarray(b, np.float64).reshape(len(b), -1)
        self._max_gap_ns = 0
        if self.enough:
            self._max_gap_ns = int(_GAP_PERIODS * np.median(np.diff(time_b_ns)))
            span = max(int(time_a_ns[-1] - time_a_ns[0]), 1)
            self._trend = (time_a_ns - time_a_ns[0]) / span - 0.5

    @property
    def enough(self) -> bool:
        """Whether there are samples enough to fit anything."""
        return min(len(self.a), len(self.b)) >= _LEAST_SAMPLES

    def part(self, start: int, stop: int) -> Curves:
        """Return the fit of some samples of the first curves, `start` to before `stop`."""
        rows = slice(start, stop)
        return Curves(self.time_a_ns[rows], self.a[rows], self.time_b_ns, self.b)

    def _at(self, values: Float64Array, lag_s: float) -> tuple[Float64Array, NDArray[np.bool_]]:
        """Return curves at the times of the first group, and where they are known."""
        ticks = self.time_a_ns - round(lag_s * 1e9)
        low, weight, valid = bracket_indices(self.time_b_ns, ticks, self._max_gap_ns)
        high = np.minimum(low + 1, len(values) - 1)
        return values[low] + weight[:, None] * (values[high] - values[low]), valid

    def _columns(self, lag_s: float) -> tuple[Float64Array, NDArray[np.bool_]] | None:
        """Return the explaining columns where they are known: curves, one, trend."""
        shifted, valid = self._at(self.b, lag_s)
        if np.count_nonzero(valid) < max(_LEAST_SAMPLES, _LEAST_OVERLAP * len(self.a)):
            return None
        columns = np.column_stack([shifted, np.ones(len(shifted)), self._trend])[valid]
        return columns, valid

    def fitted(self, lag_s: float) -> Fitted | None:
        """Return the fit at a lag; None where less than half of the samples overlap.

        Parameters
        ----------
        lag_s : float
            By how much the first curves are late, seconds.
        """
        found = self._columns(lag_s)
        if found is None:
            return None
        columns, valid = found
        gains = _least_squares(columns, self.a[valid])
        model = np.full(self.a.shape, np.nan)
        model[valid] = columns @ gains
        return Fitted(model, self.a - model, valid, gains[: self.b.shape[1]])

    def profile(self, lags_s: Float64Array) -> Float64Array:
        """Return the mean square of what each lag leaves of each first curve.

        Parameters
        ----------
        lags_s : (L,) float64

        Returns
        -------
        (L, C) float64
            Infinite without enough overlap.
        """
        fits = (self.fitted(float(lag)) for lag in lags_s)
        nothing = np.full(self.a.shape[1], np.inf)
        return np.stack([nothing if fit is None else fit.power for fit in fits])

    def sigma_s(self, lag_s: float) -> float | None:
        """Return the uncertainty of a lag by what it leaves: what is left over the slope.

        Parameters
        ----------
        lag_s : float
            The best lag, seconds.

        Returns
        -------
        float or None
            Standard deviation, seconds; None where the curves do not move.
        """
        fit, found = self.fitted(lag_s), self._columns(lag_s)
        if fit is None or found is None:
            return None
        columns, valid = found
        moving = (self._at(self._slope(), lag_s)[0] @ fit.gains)[valid]
        # What the gains, the offset and the trend could make up for tells nothing of the lag.
        moving -= columns @ _least_squares(columns, moving)
        left = fit.left[valid]
        # Every column that is fitted takes a part of the noise along.
        free = max(len(left) - columns.shape[1], 1)
        power = np.sum(left**2, axis=0) / free
        known = power > 0
        if not known.any():
            return 0.0 if float(np.sum(moving**2)) > 0 else None
        # Errors that follow each other count as fewer.
        alike = np.sum(left[1:] * left[:-1], axis=0)[known] / (free * power[known])
        alike = np.clip(alike, 0.0, _MOST_CORRELATION)
        strength = np.sum(moving**2, axis=0)[known] / power[known]
        told = float(np.sum(strength * (1.0 - alike) / (1.0 + alike)))
        return 1.0 / float(np.sqrt(told)) if told > 0 else None

    def _slope(self) -> Float64Array:
        """Return how fast the second curves move, (M, K), by differences over a short time.

        From one sample to the next, noise would pass for motion that tells of the lag.
        """
        period_ns = float(np.median(np.diff(self.time_b_ns)))
        reach = max(1, round(_SLOPE_REACH_NS / max(period_ns, 1.0)))
        at = np.arange(len(self.b))
        low, high = np.maximum(at - reach, 0), np.minimum(at + reach, len(at) - 1)
        span_s = (self.time_b_ns[high] - self.time_b_ns[low]) * 1e-9
        return np.asarray((self.b[high] - self.b[low]) / span_s[:, None], np.float64)


def _least_squares(columns: Float64Array, wanted: Float64Array) -> Float64Array:
    """Solve by the normal equations: ten times as fast as by a decomposition of the columns."""
    length = np.sqrt(np.sum(columns**2, axis=0))
    scaled = columns / np.where(length > 0, length, 1.0)
    normal = scaled.T @ scaled + _RIDGE * np.eye(columns.shape[1])
    factors = np.linalg.solve(normal, scaled.T @ wanted)
    return np.asarray(factors / np.where(length > 0, length, 1.0)[:, None])


def lag_grid(reach_s: float, step_s: float, *, middle_s: float = 0.0) -> Float64Array:
    """Return evenly spaced lags: the middle, and as many on each side as reach at least so far.

    Parameters
    ----------
    reach_s, step_s : float
        Seconds, positive.
    middle_s : float, optional

    Returns
    -------
    (L,) float64
    """
    count = int(np.ceil(reach_s / step_s))
    return np.asarray(middle_s + step_s * np.arange(-count, count + 1), np.float64)


def vertex(lags_s: Float64Array, left: Float64Array, best: int, *, reach: int = 1) -> float | None:
    """Return the lag at the vertex of the parabola through a minimum and its neighbours.

    Parameters
    ----------
    lags_s : (L,) float64
        Evenly spaced.
    left : (L,) float64
    best : int
        Index of the minimum.
    reach : int, optional
        How many neighbours on each side; the parabola is fitted by least squares to more than one.

    Returns
    -------
    float or None
        None where the minimum is at an end, beside a lag that is not known, or flat.
    """
    near = slice(best - reach, best + reach + 1)
    if best < reach or best + reach >= len(lags_s) or not np.isfinite(left[near]).all():
        return None
    steps = np.arange(-reach, reach + 1)
    bend, slope, _ = np.polyfit(steps, left[near], 2)
    if bend <= 0 or abs(slope) > 2.0 * reach * bend:
        return None
    return float(lags_s[best] - 0.5 * (lags_s[1] - lags_s[0]) * slope / bend)
