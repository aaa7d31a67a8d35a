"""Time of streams: nominal timelines, clock models, order, resampling indices, rate statistics.

All times are int64 nanoseconds. Sums and differences of times are integer arithmetic; only
interpolation weights and statistics are floating point. Times must lie within ±2**62 ns
(±146 years), so that no difference of two times can overflow.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

__all__ = [
    "DEFAULT_GAP_FACTOR",
    "Brackets",
    "Gap",
    "RateStatistics",
    "apply_clock",
    "bracket_indices",
    "format_rate",
    "format_utc",
    "nearest_indices",
    "nominal_times",
    "parse_rate",
    "parse_utc",
    "rate_statistics",
    "strictly_increasing",
]

Int64Array = npt.NDArray[np.int64]

NS_PER_S = 1_000_000_000
TIME_LIMIT_NS = 2**62

DEFAULT_GAP_FACTOR = 2.5
"""A period longer than this many median periods is a gap.

One lost sample doubles a period, and so does one late stamp followed by an early one; the two
cannot be told apart from times alone (sequence numbers can). 2.5 counts neither and counts two
consecutive losses for certain.
"""

_RATE = re.compile(r"([0-9]{1,18})(?:/([0-9]{1,18}))?")
_UTC = re.compile(
    r"(?P<minutes>[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2})"
    r":(?P<seconds>[0-9]{2})(\.(?P<fraction>[0-9]{1,9}))?Z"
)
_SPLIT_BITS = 31


class Brackets(NamedTuple):
    """Where ticks lie between samples; see `bracket_indices`."""

    lo: npt.NDArray[np.int32]
    weight: npt.NDArray[np.float64]
    valid: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Gap:
    """A hole in a stream: between samples `index` and `index + 1`, `length_s` seconds long."""

    index: int
    length_s: float


@dataclass(frozen=True, kw_only=True)
class RateStatistics:
    """How regularly a stream was sampled; made by `rate_statistics`.

    Attributes
    ----------
    n
        Number of samples.
    duration_s
        Last time minus first time; 0 for fewer than two samples.
    rate_hz
        Inverse of the median period; None for fewer than two samples.
    period_median_s, period_max_s
        Median and longest period; None for fewer than two samples.
    jitter_s
        1.4826 x median absolute deviation of the periods from their median: the standard
        deviation where periods are normally distributed, and blind to gaps. None for fewer than
        two samples.
    gaps
        Periods longer than the gap factor x median, in time order.
    """

    n: int
    duration_s: float
    rate_hz: float | None
    period_median_s: float | None
    period_max_s: float | None
    jitter_s: float | None
    gaps: tuple[Gap, ...]

    @property
    def gap_count(self) -> int:
        """Number of gaps."""
        return len(self.gaps)


def parse_rate(text: str) -> Fraction:
    """Read a rational sampling rate in hertz.

    Parameters
    ----------
    text
        ``"60000/1001"``, ``"25/1"`` or ``"25"``: positive decimal integers.

    Returns
    -------
    Fraction
        The rate, in lowest terms.

    Raises
    ------
    ValueError
        If the text is anything else; decimals are refused because 29.97 is not 30000/1001.
    """
    match = _RATE.fullmatch(text)
    numerator = int(match[1]) if match else 0
    denominator = int(match[2] or 1) if match else 0
    if numerator == 0 or denominator == 0:
        raise ValueError(
            f"invalid rate {text!r}: write it as a positive rational number, "
            'for example "25" or "60000/1001"'
        )
    return Fraction(numerator, denominator)


def format_rate(rate: Fraction) -> str:
    """Write a rational rate as ``"60000/1001"`` or ``"25/1"``, the inverse of `parse_rate`.

    Raises
    ------
    ValueError
        If the rate is not positive.
    """
    if rate <= 0:
        raise ValueError(f"invalid rate {rate}: it must be positive")
    return f"{rate.numerator}/{rate.denominator}"


def format_utc(utc_ns: int) -> str:
    """Write a time as a timestamp of the format (RFC 3339, UTC), exact to the nanosecond.

    Parameters
    ----------
    utc_ns : int
        Nanoseconds since 1970.
    """
    seconds, rest = divmod(utc_ns, NS_PER_S)
    return f"{np.datetime_as_string(np.datetime64(seconds, 's'))}.{rest:09d}Z"


def parse_utc(text: str) -> int:
    """Read a timestamp of the format; a leap second counts as the second after it.

    Parameters
    ----------
    text : str
        Such as ``2026-03-01T10:20:30.5Z``.

    Returns
    -------
    int
        Nanoseconds since 1970.

    Raises
    ------
    ValueError
        It is no such timestamp.
    """
    found = _UTC.fullmatch(text)
    if found is None:
        msg = f"{text!r} is no UTC timestamp"
        raise ValueError(msg)
    minutes = int(np.datetime64(found["minutes"], "m").astype(np.int64))
    whole = minutes * 60 + int(found["seconds"])
    return whole * NS_PER_S + int((found["fraction"] or "0").ljust(9, "0"))


def nominal_times(n: int, rate: Fraction) -> Int64Array:
    """Make the times of `n` samples of a source that is known only by its nominal rate.

    Parameters
    ----------
    n
        Number of samples.
    rate
        Samples a second.

    Returns
    -------
    (n,) int64
        ``round(i * 10**9 / rate)`` nanoseconds, exact (ties to even), starting at 0.

    Raises
    ------
    ValueError
        If `n` is negative, the rate is not positive, or a time would not fit.
    """
    if n < 0:
        raise ValueError(f"invalid number of samples {n}: it must not be negative")
    if rate <= 0:
        raise ValueError(f"invalid rate {rate}: it must be positive")
    whole, rest = divmod(NS_PER_S * rate.denominator, rate.numerator)
    if max(n, 1) * max(whole + 1, rate.numerator) >= TIME_LIMIT_NS:
        raise ValueError(f"{n} samples at {rate} Hz do not fit into 64-bit nanoseconds")
    index = np.arange(n, dtype=np.int64)
    quotient, remainder = np.divmod(index * rest, np.int64(rate.numerator))
    times = index * whole + quotient
    twice = 2 * remainder
    round_up = (twice > rate.numerator) | ((twice == rate.numerator) & (times % 2 == 1))
    return np.asarray(times + round_up, np.int64)


def apply_clock(
    raw_ns: npt.ArrayLike,
    *,
    t_ref: int,
    drift_ppm: float,
    offset_ns: int,
    latency_ns: int,
) -> Int64Array:
    """Turn raw clock readings into episode time.

    ``time = round((raw - t_ref) * (1 + drift_ppm * 1e-6)) + offset_ns - latency_ns``

    The result is the exact value of this formula rounded to the nearest nanosecond; only where
    the exact value lies within 1e-6 ns of a tie either neighbour may be returned.

    Parameters
    ----------
    raw_ns
        (N,) integers: raw times in nanoseconds.
    t_ref
        Raw time at which the drift is zero, nanoseconds.
    drift_ppm
        Rate error of the raw clock in parts per million, at most one million.
    offset_ns, latency_ns
        Added and subtracted, nanoseconds.

    Returns
    -------
    (N,) int64
        Nanoseconds since the episode's start.

    Raises
    ------
    ValueError
        If a time or a parameter is out of range, or the raw times are not integers.
    """
    if not abs(drift_ppm) <= 1e6:  # also refuses NaN
        raise ValueError(f"invalid drift {drift_ppm} ppm: it must be at most 1,000,000 ppm")
    raw = _as_times(raw_ns, "raw times")
    if raw.size == 0:
        return raw.copy()
    drift = Fraction(drift_ppm) / 1_000_000
    shift = int(offset_ns) - int(latency_ns)
    if max(abs(int(t_ref)), abs(shift)) >= TIME_LIMIT_NS:
        raise ValueError(
            f"t_ref={t_ref} ns and offset_ns - latency_ns = {shift} ns must lie within ±2**62 ns"
        )
    for extreme in (int(raw.min()), int(raw.max())):
        delta = extreme - int(t_ref)
        if abs(delta) >= TIME_LIMIT_NS or abs(delta + delta * drift + shift) >= TIME_LIMIT_NS:
            raise ValueError(
                f"raw time {extreme} ns is out of range after the clock correction (t_ref={t_ref}, "
                f"drift_ppm={drift_ppm}, offset_ns={offset_ns}, latency_ns={latency_ns})"
            )
    delta_ns = raw - np.int64(t_ref)
    # In this order no partial sum leaves int64: |delta + drift part| may reach 2**63 only before
    # an opposite shift, and wrapping int64 sums are exact whenever the final result is in range.
    return delta_ns + _scaled(delta_ns, drift) + np.int64(shift)


def _scaled(delta_ns: Int64Array, factor: Fraction) -> Int64Array:
    """Round ``delta_ns * factor`` for |factor| <= 1 without float64's loss at large values.

    delta = high * 2**31 + low; high * 2**31 * factor splits into an integer part (exact) and a
    fraction below `high`, so that nothing larger than 2**33 is ever rounded as a float.
    """
    high = delta_ns >> _SPLIT_BITS
    low = delta_ns & ((1 << _SPLIT_BITS) - 1)
    step = factor * (1 << _SPLIT_BITS)
    step_whole = step.numerator // step.denominator
    fraction = high * float(step - step_whole) + low * float(factor)
    return high * np.int64(step_whole) + np.rint(fraction).astype(np.int64)


def strictly_increasing(time_ns: npt.ArrayLike) -> tuple[Int64Array, npt.NDArray[np.bool_]]:
    """Make times strictly increasing, keeping the order of arrival.

    A time that is not later than the one before it becomes that one + 1 ns; all others stay.
    One stamp far in the future therefore drags the following ones along: `nudged` shows them.

    Parameters
    ----------
    time_ns
        (N,) integers: times in order of arrival, nanoseconds.

    Returns
    -------
    time_ns : (N,) int64
        Strictly increasing times.
    nudged : (N,) bool
        Where a time was changed.

    Raises
    ------
    ValueError
        If the times are not integers in range.
    """
    time = _as_times(time_ns, "times")
    index = np.arange(time.size, dtype=np.int64)
    out = np.maximum.accumulate(time - index) + index
    return out, out != time


def nearest_indices(
    time_ns: npt.ArrayLike, ticks_ns: npt.ArrayLike, tolerance_ns: int
) -> npt.NDArray[np.int32]:
    """Find the sample nearest to each tick.

    Parameters
    ----------
    time_ns
        (N,) strictly increasing integers: sample times.
    ticks_ns
        (M,) integers: wanted times, in any order.
    tolerance_ns
        A sample further away than this does not count.

    Returns
    -------
    (M,) int32
        Index of the nearest sample (of two equally near, the earlier), or -1.

    Raises
    ------
    ValueError
        If times are not integers in range or the tolerance is negative.
    """
    if tolerance_ns < 0:
        raise ValueError(f"invalid tolerance {tolerance_ns} ns: it must not be negative")
    time, ticks = _as_times(time_ns, "times"), _as_times(ticks_ns, "ticks")
    if time.size == 0:
        return np.full(ticks.shape, -1, np.int32)
    index, distance = _nearest(time, ticks)
    return np.where(distance <= tolerance_ns, index, -1).astype(np.int32)


def bracket_indices(time_ns: npt.ArrayLike, ticks_ns: npt.ArrayLike, max_gap_ns: int) -> Brackets:
    """Find the two samples around each tick, for interpolation.

    The value at a valid tick is ``(1 - weight) * x[lo] + weight * x[lo + 1]``; where `weight` is
    0, ``lo + 1`` may lie beyond the end and is not to be read. A tick exactly on a sample is
    always valid. A tick outside the samples, or between two that are more than `max_gap_ns`
    apart, is not: its `lo` is the nearest sample and its `weight` 0, so that it holds that value.

    Parameters
    ----------
    time_ns
        (N,) strictly increasing integers: sample times, N >= 1.
    ticks_ns
        (M,) integers: wanted times, in any order.
    max_gap_ns
        The longest period to interpolate across.

    Returns
    -------
    Brackets
        lo (M,) int32, weight (M,) float64 in [0, 1), valid (M,) bool.

    Raises
    ------
    ValueError
        If there are no samples, times are not integers in range, or the gap is negative.
    """
    if max_gap_ns < 0:
        raise ValueError(f"invalid maximum gap {max_gap_ns} ns: it must not be negative")
    time, ticks = _as_times(time_ns, "times"), _as_times(ticks_ns, "ticks")
    if time.size == 0:
        raise ValueError("cannot interpolate a stream without samples")
    lo = np.clip(np.searchsorted(time, ticks, side="right") - 1, 0, time.size - 1)
    hi = np.minimum(lo + 1, time.size - 1)
    elapsed, period = ticks - time[lo], time[hi] - time[lo]
    exact = elapsed == 0
    inside = (elapsed > 0) & (elapsed < period) & (period <= max_gap_ns)
    weight = np.where(inside, elapsed / np.maximum(period, 1), 0.0)
    # a weight that rounds up to 1 would promise `hi`; keep the half-open interval
    weight = np.minimum(weight, np.nextafter(1.0, 0.0))
    held = ~(inside | exact)
    if held.any():
        lo = np.where(held, _nearest(time, ticks)[0], lo)
    return Brackets(lo.astype(np.int32), weight, ~held)


def rate_statistics(
    time_ns: npt.ArrayLike, *, gap_factor: float = DEFAULT_GAP_FACTOR
) -> RateStatistics:
    """Measure rate, jitter and gaps of a stream from its times.

    Parameters
    ----------
    time_ns
        (N,) strictly increasing integers: sample times.
    gap_factor
        A period longer than this many median periods is a gap (`DEFAULT_GAP_FACTOR`).

    Returns
    -------
    RateStatistics
        See there; the rate comes from the median period, so gaps do not lower it.

    Raises
    ------
    ValueError
        If times are not strictly increasing integers in range, or the factor is not above 1.
    """
    if not gap_factor > 1:
        raise ValueError(f"invalid gap factor {gap_factor}: it must be above 1")
    time = _as_times(time_ns, "times")
    if time.size < 2:
        return RateStatistics(
            n=time.size,
            duration_s=0.0,
            rate_hz=None,
            period_median_s=None,
            period_max_s=None,
            jitter_s=None,
            gaps=(),
        )
    period = np.diff(time)
    if period.min() <= 0:
        raise ValueError(
            f"times are not strictly increasing at sample {int((period <= 0).argmax()) + 1}"
        )
    median = float(np.median(period))
    jitter = 1.4826 * float(np.median(np.abs(period - median)))
    late = np.flatnonzero(period > gap_factor * median)
    return RateStatistics(
        n=time.size,
        duration_s=int(time[-1] - time[0]) / NS_PER_S,
        rate_hz=NS_PER_S / median,
        period_median_s=median / NS_PER_S,
        period_max_s=int(period.max()) / NS_PER_S,
        jitter_s=jitter / NS_PER_S,
        gaps=tuple(Gap(int(i), int(period[i]) / NS_PER_S) for i in late),
    )


def _nearest(time: Int64Array, ticks: Int64Array) -> tuple[npt.NDArray[np.intp], Int64Array]:
    """Index of and distance to the sample nearest to each tick; ties go to the earlier."""
    right = np.clip(np.searchsorted(time, ticks), 0, time.size - 1)
    left = np.maximum(right - 1, 0)
    to_left, to_right = np.abs(ticks - time[left]), np.abs(time[right] - ticks)
    earlier = to_left <= to_right
    return np.where(earlier, left, right), np.where(earlier, to_left, to_right)


def _as_times(values: npt.ArrayLike, what: str) -> Int64Array:
    """Check that values are one-dimensional integers within ±2**62 and return them as int64."""
    array: npt.NDArray[Any] = np.asarray(values)
    if array.ndim != 1:
        raise ValueError(f"{what} must be one-dimensional, not of shape {array.shape}")
    if array.size == 0:
        return array.astype(np.int64)
    if array.dtype.kind not in "iu":
        raise ValueError(f"{what} must be integers (nanoseconds), not {array.dtype}")
    if int(array.min()) <= -TIME_LIMIT_NS or int(array.max()) >= TIME_LIMIT_NS:
        raise ValueError(f"{what} must lie within ±2**62 ns")
    return array.astype(np.int64, copy=False)
