"""The common timeline: ticks, and how far a stream's samples may be from one.

Statistics and loaders judge by the same rules, so that a tick which `exumi stats` calls usable is
one that a window can be made at.
"""

from fractions import Fraction

import numpy as np
import numpy.typing as npt

__all__ = ["DEFAULT_TICK_S", "image_tolerance_ns", "max_gap_ns", "tick_times_ns"]

DEFAULT_TICK_S = Fraction(3 * 1001, 60000)
"""Three frames of 59.94 fps: 50.05 ms (exUMI)."""

_IMAGE_PERIODS = 0.6
_LOW_DIM_PERIODS = 2.5
_LOW_DIM_GAP_NS = 100_000_000

Times = npt.NDArray[np.int64]


def tick_times_ns(numbers: Times, tick_s: Fraction) -> Times:
    """Return the times of ticks, exact to the nanosecond however long the episode.

    Parameters
    ----------
    numbers : (M,) int64
        Ticks counted from 0, not negative.
    tick_s : fractions.Fraction
        Distance of two ticks.

    Returns
    -------
    (M,) int64
        Nanoseconds since tick 0; no sum of rounded ticks.
    """
    tick_ns = tick_s * 1_000_000_000
    whole, rest = divmod(tick_ns.numerator, tick_ns.denominator)
    numbers = numbers.astype(np.int64)
    part = (numbers * rest + tick_ns.denominator // 2) // tick_ns.denominator
    return np.asarray(numbers * whole + part, dtype=np.int64)


def image_tolerance_ns(time_ns: Times, tick_s: Fraction) -> int:
    """Return how far the nearest frame may be from a tick.

    One tick, or 0.6 of the stream's median frame interval if that is longer (so that a 10 fps
    stream has a frame at every tick).

    Parameters
    ----------
    time_ns : (N,) int64
        The stream's times.
    tick_s : fractions.Fraction
    """
    return round(max(float(tick_s) * 1e9, _IMAGE_PERIODS * _median_period_ns(time_ns)))


def max_gap_ns(time_ns: Times) -> int:
    """Return the longest stretch that a low-dimensional stream is interpolated over.

    0.1 s, or 2.5 of the stream's median sample intervals if that is longer.

    Parameters
    ----------
    time_ns : (N,) int64
        The stream's times.
    """
    return round(max(_LOW_DIM_GAP_NS, _LOW_DIM_PERIODS * _median_period_ns(time_ns)))


def _median_period_ns(time_ns: Times) -> float:
    if len(time_ns) < 2:
        return 0.0
    # np.median's own value, in a fifth of its time: this is asked for twice a stream of an episode.
    periods = np.sort(np.diff(time_ns))
    return float(periods[(len(periods) - 1) // 2]) / 2 + float(periods[len(periods) // 2]) / 2
