"""How two clocks run against each other: steps and drift of what lies between them."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

__all__ = ["Drift", "Step", "Thinned", "drift_of", "steps_of"]

_WINDOW_NS = 5e9
_WINDOWS_PER_EDGE = 5
_MIN_EDGE = 10
_SCANS_PER_WINDOW = 16
_MAD_TO_SIGMA = 1.4826
_MEDIAN_TO_MEAN = 1.2533

Float64Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Step:
    """A step: the first sample after it, and its size in nanoseconds."""

    index: int
    size_ns: float


@dataclass(frozen=True, slots=True)
class Drift:
    """The rate of one clock against another, parts per million, with its standard deviation."""

    ppm: float
    sigma_ppm: float


def steps_of(
    time_ns: npt.NDArray[np.int64], difference_ns: Float64Array, limit_ns: float
) -> list[Step]:
    """Find where the difference of two clocks steps and stays there.

    The median of the five seconds after a step is compared with that of the five before, so that
    neither a late stamp nor a second of late stamps is a step; nor is drift, which comes slowly.
    A step within the first or last second (or ten samples) cannot be told from a late stamp.

    Parameters
    ----------
    time_ns : (N,) int64
        Increasing times.
    difference_ns : (N,) float64
        One clock minus the other.
    limit_ns : float
        Smaller steps are none.

    Returns
    -------
    list of Step
        In order of time.
    """
    count = len(time_ns)
    if count < 2 * _MIN_EDGE:
        return []
    level = difference_ns - _slope(time_ns, difference_ns) * (time_ns - time_ns[0])
    if not (np.abs(np.diff(level)) > limit_ns / 2).any():
        return []
    interval = float(np.median(np.diff(time_ns)))
    window = max(_WINDOWS_PER_EDGE * _MIN_EDGE, int(_WINDOW_NS / max(interval, 1.0)))
    edge = window // _WINDOWS_PER_EDGE
    stride = max(1, window // _SCANS_PER_WINDOW)
    places = np.arange(edge, count - edge + 1, stride)
    shift = np.array([_shift(level, int(place), window) for place in places])
    high = np.abs(shift) > limit_ns
    bounds = np.flatnonzero(np.diff(np.concatenate(([0], high.astype(np.int8), [0]))))
    found = []
    for start, stop in bounds.reshape(-1, 2):
        highest = start + int(np.abs(shift[start:stop]).argmax())
        step = _located(level, int(places[highest]), window, limit_ns)
        if step is not None and edge <= step.index <= count - edge:
            found.append(step)
    return found


def _slope(time_ns: npt.NDArray[np.int64], difference_ns: Float64Array) -> float:
    """Return the median slope over a sixth of the stretch, which one step cannot change."""
    lag = max(1, len(time_ns) // 6)
    rise = difference_ns[lag:] - difference_ns[:-lag]
    return float(np.median(rise / (time_ns[lag:] - time_ns[:-lag])))


def _sides(level: Float64Array, place: int, window: int) -> tuple[Float64Array, Float64Array]:
    return level[max(0, place - window) : place], level[place : place + window]


def _shift(level: Float64Array, place: int, window: int) -> float:
    before, after = _sides(level, place, window)
    return float(np.median(after) - np.median(before))


def _located(level: Float64Array, place: int, window: int, limit_ns: float) -> Step | None:
    """Find the sample at which the level changes; None where it does not change at once."""
    before, after = _sides(level, place, window)
    around = np.concatenate((before, after))
    # Where the samples before fit the level before best, and those after that after.
    misfit = np.abs(around - np.median(before)) - np.abs(around - np.median(after))
    index = max(0, place - window) + int(np.concatenate(([0.0], misfit.cumsum())).argmin())
    if not 0 < index < len(level):
        return None
    before, after = _sides(level, index, window)
    size = float(np.median(after) - np.median(before))
    sign = 1.0 if size > 0 else -1.0
    apart = float(np.quantile(sign * after, 0.25) - np.quantile(sign * before, 0.75))
    at_once = abs(float(np.median(after[:3]) - np.median(before[-3:])))
    # Both sides stay at their level, and the change takes no more than a sample or two.
    steady = max(_tilt(before), _tilt(after)) < abs(size) / 2
    if abs(size) <= limit_ns or min(apart, at_once) <= abs(size) / 2 or not steady:
        return None
    return Step(index, size)


def _tilt(side: Float64Array) -> float:
    """Return how much the level changes from the first half to the second."""
    half = len(side) // 2
    return abs(float(np.median(side[half:]) - np.median(side[:half]))) if half else 0.0


class Thinned:
    """Times and differences of a stream of any length, thinned to some ten thousands.

    Attributes
    ----------
    count : int
        Samples seen.
    """

    _MOST = 1 << 15

    def __init__(self) -> None:
        self.count = 0
        self._stride = 1
        self._time: list[npt.NDArray[np.int64]] = []
        self._difference: list[Float64Array] = []

    def add(self, time_ns: npt.NDArray[np.int64], difference_ns: Float64Array) -> None:
        """Add samples that come after those before.

        Parameters
        ----------
        time_ns : (N,) int64
        difference_ns : (N,) float64
        """
        first = -self.count % self._stride
        self._time.append(time_ns[first :: self._stride].copy())
        self._difference.append(difference_ns[first :: self._stride].copy())
        self.count += len(time_ns)
        while sum(map(len, self._time)) > 2 * self._MOST:
            self._stride *= 2
            self._time = [np.concatenate(self._time)[::2]]
            self._difference = [np.concatenate(self._difference)[::2]]

    @property
    def samples(self) -> tuple[npt.NDArray[np.int64], Float64Array]:
        """The samples that were kept: (K,) int64 and (K,) float64."""
        if not self._time:
            return np.zeros(0, np.int64), np.zeros(0)
        return np.concatenate(self._time), np.concatenate(self._difference)


def drift_of(
    time_ns: npt.NDArray[np.int64], difference_ns: Float64Array, wander_ns: float
) -> Drift | None:
    """Estimate the drift between two clocks from the first and the last third.

    Parameters
    ----------
    time_ns : (N,) int64
    difference_ns : (N,) float64
    wander_ns : float
        How much the latency of the stamps may change by itself meanwhile: no number of samples
        makes a drift known better than that.

    Returns
    -------
    Drift or None
        None for fewer than 30 samples, or of no length.
    """
    third = len(time_ns) // 3
    if third < _MIN_EDGE:
        return None
    first, last = slice(None, third), slice(-third, None)
    apart = float(np.median(time_ns[last]) - np.median(time_ns[first]))
    if apart <= 0:
        return None
    slope = float(np.median(difference_ns[last]) - np.median(difference_ns[first])) / apart
    rest = difference_ns - slope * (time_ns - time_ns[0])
    noise = _MAD_TO_SIGMA * float(np.median(np.abs(rest - np.median(rest))))
    sigma = np.hypot(wander_ns, _MEDIAN_TO_MEAN * noise * np.sqrt(2.0 / third)) / apart
    return Drift(slope * 1e6, float(sigma) * 1e6)
