"""The intervals between the samples of a stream: what is regular, and what stands out.

Median, jitter and gaps are those of `exumi_data.time.rate_statistics`, so that `exumi validate`
and `exumi stats` never disagree on them.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exumi_data.time import DEFAULT_GAP_FACTOR, NS_PER_S, RateStatistics, rate_statistics

__all__ = ["MIN_INTERVALS", "Intervals", "intervals_of"]

MIN_INTERVALS = 20
"""Fewer have no rhythm that could be judged."""

_STEADY = 0.3
"""Jitter, in medians, up to which intervals are regular each for itself."""
_RUN = 16
_STEADY_RUN = 0.1
"""Spread, in means, up to which runs of sixteen intervals are regular; that of independent events
is a quarter."""
_MIN_RUNS = 64
_MAD_TO_SIGMA = 1.4826
_OFF_BY_SIGMAS = 3.0

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class Intervals:
    """The intervals of a stretch of samples; made by `intervals_of`.

    Attributes
    ----------
    periods : (N-1,) int64
        Nanoseconds from each sample to the next.
    statistics : RateStatistics
        As ``exumi stats`` has them.
    pace_ns : float
        Median time that a sample takes within runs of sixteen: of samples that arrive in bursts,
        not the short interval within a burst.
    pace_spread : float
        Robust standard deviation of that, relative to it.
    """

    periods: npt.NDArray[np.int64]
    statistics: RateStatistics
    pace_ns: float
    pace_spread: float

    @property
    def median_ns(self) -> float:
        """Median interval, nanoseconds."""
        return (self.statistics.period_median_s or 0.0) * NS_PER_S

    @property
    def jitter(self) -> float:
        """Jitter relative to the median interval."""
        return (self.statistics.jitter_s or 0.0) * NS_PER_S / self.median_ns

    @property
    def is_regular(self) -> bool:
        """Whether the samples come at a rate, and not whenever something happens.

        They do where the intervals are alike, or where runs of them take equally long, as of
        samples that are measured regularly and arrive in bursts.
        """
        steady = self.jitter <= _STEADY
        return steady or (len(self.periods) >= _MIN_RUNS and self.pace_spread <= _STEADY_RUN)

    def crowded(self, fraction: float) -> Mask:
        """Find intervals that are too short for two measurements.

        Parameters
        ----------
        fraction : float
            Of the time that a sample takes.

        Returns
        -------
        (N-1,) bool
        """
        return np.asarray(self.periods < fraction * max(self.median_ns, self.pace_ns))

    def gap_positions(self) -> npt.NDArray[np.int64]:
        """Return the intervals that are gaps, (K,) int64."""
        return np.array([gap.index for gap in self.statistics.gaps], dtype=np.int64)

    def is_off(self, rate_hz: float, tolerance: float, known: Mask) -> bool:
        """Whether the stretch was surely sampled at another rate.

        Two measures must say so: the median interval, which lost samples do not lengthen, and the
        mean of the intervals that are no gaps, which stamps of coarse resolution do not distort.

        Parameters
        ----------
        rate_hz : float
        tolerance : float
            Relative.
        known : (N-1,) bool
            Intervals in which samples are known to be missing.
        """
        ordinary = ~known
        ordinary[self.gap_positions()] = False
        count = int(ordinary.sum())
        if not count:
            return False
        expected = NS_PER_S / rate_hz
        mean = float(self.periods[ordinary].mean())
        # Only the jitter of the two ends counts, and that beside every interval left out.
        ends = 1 + len(ordinary) - count
        sigma = self.jitter * float(np.sqrt(ends)) / count
        allowed = tolerance + _OFF_BY_SIGMAS * sigma
        off = (self.median_ns / expected - 1.0, mean / expected - 1.0)
        return min(abs(off[0]), abs(off[1])) > allowed and off[0] * off[1] > 0.0


def intervals_of(
    time_ns: npt.NDArray[np.int64], *, gap_factor: float = DEFAULT_GAP_FACTOR
) -> Intervals | None:
    """Measure the intervals of a stretch of samples.

    Parameters
    ----------
    time_ns : (N,) int64
        Times.
    gap_factor : float, optional
        A longer interval, in medians, is a gap.

    Returns
    -------
    Intervals or None
        None for fewer than two samples, and where times do not increase or are out of range.
    """
    if len(time_ns) < 2:
        return None
    try:
        statistics = rate_statistics(time_ns, gap_factor=gap_factor)
    except ValueError:
        return None
    run = max(1, min(_RUN, len(time_ns) // 4))
    paces = (time_ns[run:] - time_ns[:-run]) / run
    pace = float(np.median(paces))
    spread = _MAD_TO_SIGMA * float(np.median(np.abs(paces - pace)))
    return Intervals(
        periods=np.diff(time_ns),
        statistics=statistics,
        pace_ns=pace,
        pace_spread=spread / pace,
    )
