"""The lag between two curves of the same motion, found by trying lags.

For each lag of a dense grid the second curve is fitted to the first with gain, offset and trend;
the lag with the least residual, refined by a parabola, is the estimate. A coarse grid that zooms
in falls into the wrong basin on periodic sweeps; a plain cross-correlation is led astray by
missing samples and trends.
"""

import numpy as np
from numpy.typing import NDArray

from exumi_data.synchronisation.estimate import LatencyEstimate
from exumi_data.synchronisation.lags import Curves, lag_grid, vertex

__all__ = ["LAG_METHOD", "search_lag"]

LAG_METHOD = "exumi-lag-search/1"

Float64Array = NDArray[np.float64]

# A second minimum this close to the first one makes the lag ambiguous.
_AMBIGUOUS = 1.2


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
    if not 0 < step_s <= max_lag_s:
        raise ValueError(f"step_s ({step_s}) and max_lag_s ({max_lag_s}) must be positive")
    curves = Curves(time_a_ns, a, time_b_ns, b)
    if not curves.enough:
        return None
    lags = lag_grid(max_lag_s, step_s)
    left = curves.profile(lags)[:, 0]
    best = int(left.argmin())
    offset = vertex(lags, left, best)
    if offset is None or _is_ambiguous(left, best):
        return None
    sigma = curves.sigma_s(offset)
    if sigma is None:
        return None
    return LatencyEstimate(offset_s=offset, sigma_s=sigma, n_events=1, method=LAG_METHOD)


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
