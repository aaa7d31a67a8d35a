"""Where in a long curve a short one fits: normalised cross-correlation with missing samples.

Both curves carry masks. For every lag the correlation is Pearson's over the samples that both have,
all lags at once by Fourier transforms.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Sampled", "SlidingCorrelation", "sampled"]

_LEAST_VARIANCE = 1e-9
_NO_FIT = -1.0


@dataclass(frozen=True, slots=True, eq=False)
class Sampled:
    """A curve on an even grid.

    Attributes
    ----------
    start_ns, step_ns : int
    values : (N,) float64
        0 where nothing is known.
    known : (N,) float64
        1 or 0.
    """

    start_ns: int
    step_ns: int
    values: NDArray[np.float64]
    known: NDArray[np.float64]


def sampled(
    time_ns: NDArray[np.int64], values: NDArray[np.float64], *, step_ns: int, max_gap_ns: int
) -> Sampled:
    """Put a curve on a grid of whole steps; nothing is interpolated across longer gaps.

    Parameters
    ----------
    time_ns : (N,) int64
        Strictly increasing, not empty.
    values : (N,) float64
    step_ns, max_gap_ns : int
    """
    start = int(time_ns[0]) // step_ns + 1
    stop = int(time_ns[-1]) // step_ns + 1
    grid = step_ns * np.arange(start, stop, dtype=np.int64)
    low = np.searchsorted(time_ns, grid, side="right") - 1
    high = np.minimum(low + 1, len(time_ns) - 1)
    known = (time_ns[high] - time_ns[low]) <= max_gap_ns
    at = np.interp(grid - time_ns[0], time_ns - time_ns[0], values)
    return Sampled(start * step_ns, step_ns, np.where(known, at, 0.0), known.astype(np.float64))


class SlidingCorrelation:
    """A long curve, transformed once, against which short ones are laid.

    Parameters
    ----------
    long : Sampled
    most : int
        Samples of the longest short curve.
    """

    def __init__(self, long: Sampled, most: int) -> None:
        from scipy import fft

        self._long = long
        self._most = most
        self._size = fft.next_fast_len(len(long.values) + 2 * most, real=True)
        # A curve far from zero would lose its digits in the differences of sums.
        self._middle = float(long.values.sum() / max(long.known.sum(), 1.0))
        values = (long.values - self._middle) * long.known
        self._known = fft.rfft(long.known, self._size)
        self._values = fft.rfft(values, self._size)
        self._squares = fft.rfft(values**2, self._size)

    def against(
        self, short: Sampled, *, overlap: float
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Correlate a short curve with the long one at every lag.

        Parameters
        ----------
        short : Sampled
            On a grid of the same step.
        overlap : float
            Least share of its known samples that the long curve has to know as well.

        Returns
        -------
        lag_ns : (L,) int64
            What to add to the short curve's times.
        correlation : (L,) float64
            -1 where the two do not overlap or one does not move.
        """
        from scipy import fft

        count = len(short.values)
        values = (short.values - self._middle) * short.known
        known = np.conj(fft.rfft(short.known, self._size))
        first = np.conj(fft.rfft(values, self._size))
        second = np.conj(fft.rfft(values**2, self._size))
        # Lags from "all but one sample before" to "all but one after" of the long curve.
        lags = np.arange(1 - count, len(self._long.values))

        def at(product: NDArray[np.complex128]) -> NDArray[np.float64]:
            return np.asarray(fft.irfft(product, self._size)[lags], np.float64)

        both = np.rint(at(self._known * known))
        enough = both >= max(2.0, overlap * float(short.known.sum()))
        number = np.where(enough, both, 1.0)
        sum_long, sum_short = at(self._values * known), at(self._known * first)
        spread_long = at(self._squares * known) - sum_long**2 / number
        spread_short = at(self._known * second) - sum_short**2 / number
        common = at(self._values * first) - sum_long * sum_short / number
        least = _LEAST_VARIANCE * number
        sound = enough & (spread_long > least) & (spread_short > least)
        scale = np.sqrt(np.where(sound, spread_long * spread_short, 1.0))
        correlation = np.where(sound, np.clip(common / scale, -1.0, 1.0), _NO_FIT)
        shift = self._long.start_ns - short.start_ns
        return shift + lags * np.int64(self._long.step_ns), correlation
