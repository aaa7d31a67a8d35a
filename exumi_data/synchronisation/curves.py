"""The lag between two curves of the same motion, found by trying lags.

For each lag of a dense grid the second curve is fitted to the first with gain, offset and trend;
the lag with the least residual, refined by a parabola, is the estimate. A coarse grid that zooms
in falls into the wrong basin on periodic sweeps; a plain cross-correlation is led astray by
missing samples and trends.
"""

import numpy as np
from numpy.typing import NDArray

from exumi_data.synchronisation.estimate import LatencyEstimate
from exumi_data.time import bracket_indices

__all__ = ["LAG_METHOD", "search_lag"]

LAG_METHOD = "exumi-lag-search/1"

Float64Array = NDArray[np.float64]

_LEAST_SAMPLES = 16
_LEAST_OVERLAP = 0.5
# Longer than this many median periods is a gap, across which nothing is interpolated.
_GAP_PERIODS = 3.5
# A second minimum this close to the first one makes the lag ambiguous.
_AMBIGUOUS = 1.2
_MOST_CORRELATION = 0.98


def search_lag(
    time_a_ns: NDArray[np.int64],
    a: NDArray[np.floating],
    time_b_ns: NDArray[np.int64],
    b: NDArray[np.floating],
    *,
    max_lag_s: float = 0.5,
    step_s: float = 0.005,
) -> LatencyEstimate | None:
    """Estimate by how much curve `a` is late relative to curve `b`.

    Parameters
    ----------
    time_a_ns : (N,) int64
        Strictly increasing.
    a : (N,) float
        Such as the motion energy of a camera's frames.
    time_b_ns : (M,) int64
        Strictly increasing, of the same clock.
    b : (M,) float
        Such as the speed of a tracker. Gain, offset and a linear trend against `a` do not matter.
    max_lag_s : float, optional
        Lags to try, both ways, seconds.
    step_s : float, optional
        Step of the grid, seconds: well below the shortest period of the motion.

    Returns
    -------
    LatencyEstimate or None
        None where the curves do not tell: too few samples, too little overlap, the best lag at
        the end of the range, or two lags that are about as good.

    Raises
    ------
    ValueError
        If the lengths do not fit, or range or step is not positive.
    """
    if len(time_a_ns) != len(a) or len(time_b_ns) != len(b):
        raise ValueError("a curve needs one time for each value")
    if not 0 < step_s <= max_lag_s:
        raise ValueError(f"step_s ({step_s}) and max_lag_s ({max_lag_s}) must be positive")
    if min(len(a), len(b)) < _LEAST_SAMPLES:
        return None
    count = int(np.ceil(max_lag_s / step_s))
    lags = step_s * np.arange(-count, count + 1)
    max_gap_ns = int(_GAP_PERIODS * np.median(np.diff(time_b_ns)))
    curves = _Curves(time_a_ns, np.asarray(a, np.float64), time_b_ns, np.asarray(b, np.float64))
    left = np.array([curves.unexplained(lag, max_gap_ns) for lag in lags])
    best = int(left.argmin())
    if best in (0, len(lags) - 1) or not np.isfinite(left[best - 1 : best + 2]).all():
        return None
    if _is_ambiguous(left, best):
        return None
    below, at, above = left[best - 1 : best + 2]
    bend = below - 2.0 * at + above
    if bend <= 0:
        return None
    offset = float(lags[best] + 0.5 * step_s * (below - above) / bend)
    sigma = curves.sigma_s(offset, max_gap_ns)
    if sigma is None:
        return None
    return LatencyEstimate(offset_s=offset, sigma_s=sigma, n_events=1, method=LAG_METHOD)


class _Curves:
    """Two curves, the second one fitted to the first at any lag."""

    def __init__(
        self,
        time_a_ns: NDArray[np.int64],
        a: Float64Array,
        time_b_ns: NDArray[np.int64],
        b: Float64Array,
    ) -> None:
        self._time_a, self._a = time_a_ns, a
        self._time_b, self._b = time_b_ns, b
        span = max(int(time_a_ns[-1] - time_a_ns[0]), 1)
        self._trend = (time_a_ns - time_a_ns[0]) / span - 0.5

    def _shifted(self, lag_s: float, max_gap_ns: int) -> tuple[Float64Array, NDArray[np.bool_]]:
        """Return `b` at the times of `a`, and where it is known."""
        ticks = self._time_a - round(lag_s * 1e9)
        low, weight, valid = bracket_indices(self._time_b, ticks, max_gap_ns)
        high = np.minimum(low + 1, len(self._b) - 1)
        return (1.0 - weight) * self._b[low] + weight * self._b[high], valid

    def _fitted(
        self, lag_s: float, max_gap_ns: int
    ) -> tuple[Float64Array, Float64Array, NDArray[np.bool_]] | None:
        """Return the factors (gain, offset, trend), what is left of `a`, and where."""
        shifted, valid = self._shifted(lag_s, max_gap_ns)
        if np.count_nonzero(valid) < max(_LEAST_SAMPLES, _LEAST_OVERLAP * len(self._a)):
            return None
        columns = np.stack([shifted, np.ones_like(shifted), self._trend], axis=1)[valid]
        factors = np.linalg.lstsq(columns, self._a[valid], rcond=None)[0]
        return factors, self._a[valid] - columns @ factors, valid

    def unexplained(self, lag_s: float, max_gap_ns: int) -> float:
        """Return the mean square of what is left of `a`; infinite without enough overlap."""
        fitted = self._fitted(lag_s, max_gap_ns)
        return float("inf") if fitted is None else float(np.mean(fitted[1] ** 2))

    def sigma_s(self, lag_s: float, max_gap_ns: int) -> float | None:
        """Return the uncertainty of a lag: what is left over the slope, seconds."""
        fitted = self._fitted(lag_s, max_gap_ns)
        if fitted is None:
            return None
        (gain, _, _), left, valid = fitted
        slope = np.gradient(self._b, self._time_b * 1e-9)
        at = np.interp(self._time_a[valid] - round(lag_s * 1e9), self._time_b, slope)
        strength = gain * gain * float(np.sum((at - at.mean()) ** 2))
        if strength <= 0:
            return None
        # Errors that follow each other count as fewer.
        power = float(np.mean(left**2))
        alike = float(np.mean(left[1:] * left[:-1])) / power if power > 0 else 0.0
        alike = min(max(alike, 0.0), _MOST_CORRELATION)
        return float(np.sqrt(power / strength * (1.0 + alike) / (1.0 - alike)))


def _is_ambiguous(left: Float64Array, best: int) -> bool:
    """Whether another minimum is nearly as low as the best one, measured from the highest."""
    inner = left[1:-1]
    minima = 1 + np.flatnonzero((inner <= left[:-2]) & (inner <= left[2:]))
    others = left[minima[np.abs(minima - best) > 1]]
    if not len(others):
        return False
    finite = left[np.isfinite(left)]
    # With noise the best lag leaves something too: compare what the lags explain.
    explained = finite.max() - left[best]
    return bool(finite.max() - others.min() > explained / _AMBIGUOUS)
