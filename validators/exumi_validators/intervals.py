"""The intervals between the samples of a stream: what is regular, and what stands out.

Median, jitter and gaps are those of `exumi_data.time.rate_statistics`, so that `exumi validate`
and `exumi stats` never disagree on them.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from exumi_data.time import DEFAULT_GAP_FACTOR, NS_PER_S, RateStatistics, rate_statistics

__all__ = ["MIN_INTERVALS", "Intervals", "intervals_of"]

MIN_INTERVALS = 20
"""Fewer have no rhythm that could be judged."""

_STEADY = 0.2
"""Jitter, in medians, up to which intervals are regular each for itself."""
_RUN = 16
_STEADY_RUNS = 0.1
"""Spread of the mean interval of runs of sixteen, in jitters, up to which a clock made them. Stamps
that are off one by one make it a sixteenth, independent intervals a quarter."""
_CLUSTERS = 2.0
"""Time that a sample takes within runs, in medians, above which samples come in clusters."""
_STEADY_CLUSTERS = 0.05
"""Spread of runs, relative, up to which clusters are bursts of regular samples."""
_MIN_RUNS = 200
_MAD_TO_SIGMA = 1.4826
_OFF_BY_SIGMAS = 3.0

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Intervals:
    """The intervals of a stretch of samples; made by `intervals_of`.

    Attributes
    ----------
    time : (N,) int64
        Nanoseconds.
    statistics : RateStatistics
        As ``exumi stats`` has them.
    """

    time: npt.NDArray[np.int64]
    statistics: RateStatistics

    @cached_property
    def periods(self) -> npt.NDArray[np.int64]:
        """Nanoseconds from each sample to the next, (N-1,) int64."""
        return np.diff(self.time)

    @property
    def median_ns(self) -> float:
        """Median interval, nanoseconds."""
        return (self.statistics.period_median_s or 0.0) * NS_PER_S

    @property
    def jitter(self) -> float:
        """Jitter relative to the median interval."""
        return (self.statistics.jitter_s or 0.0) * NS_PER_S / self.median_ns

    def jitter_beside(self, known: Mask) -> float:
        """Return the jitter relative to the median interval, some intervals left out.

        Parameters
        ----------
        known : (N-1,) bool
            Intervals in which samples are known to be missing: where they are many, the jitter of
            all would be theirs.
        """
        others = self.periods[~known]
        if not len(others):
            return 0.0
        median = float(np.median(others))
        return _MAD_TO_SIGMA * float(np.median(np.abs(others - median))) / median

    @cached_property
    def pace_ns(self) -> float:
        """Median time that a sample takes within runs of sixteen.

        Of samples that arrive in bursts this is not the short interval within a burst.
        """
        return float(np.median(self._paces))

    @cached_property
    def _paces(self) -> npt.NDArray[np.float64]:
        run = max(1, min(_RUN, len(self.time) // 4))
        return np.asarray((self.time[run:] - self.time[:-run]) / run)

    @property
    def is_regular(self) -> bool:
        """Whether the samples come at a rate, and not whenever something happens.

        They do where the intervals are alike, or where runs of them are much more alike than they
        are: what was measured by a clock may arrive late or in bursts, but catches up.
        """
        in_clusters = self.pace_ns > _CLUSTERS * self.median_ns
        if self.jitter <= _STEADY and not in_clusters:
            return True
        if len(self.periods) < _MIN_RUNS:
            return False
        spread_ns = _MAD_TO_SIGMA * float(np.median(np.abs(self._paces - self.pace_ns)))
        if in_clusters:
            return spread_ns <= _STEADY_CLUSTERS * self.pace_ns
        return spread_ns <= _STEADY_RUNS * self.jitter * self.median_ns

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
    return Intervals(time_ns, statistics)
