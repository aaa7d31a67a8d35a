"""Timestamps of a store, whose unit and origin the contract leaves open."""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from exumi_converters.image_stream import find_gaps, is_nominal
from exumi_data.errors import SourceError
from exumi_data.model import Clock, Gap
from exumi_data.standard import flags
from exumi_data.ticks import tick_times_ns
from exumi_data.time import NS_PER_S, format_rate, parse_rate, strictly_increasing

__all__ = ["Timeline", "Unit", "find_unit", "read_timeline"]

_NS: Mapping[str, int] = {"s": NS_PER_S, "ms": 1_000_000, "us": 1_000, "ns": 1}
_LONGEST = {"s": 2.0, "ms": 2e3, "us": 2e6, "ns": 2e9}
_SHORTEST_S = 5e-4
_YEAR_2000_NS = 946_684_800 * NS_PER_S
_NUDGED_SHARE = 0.1
_LIMIT_NS = 2.0**62
_MOST_DENOMINATOR = 1001
_EXACT_S = 1e-6
_ROUNDING_NS = 1  # of times that were counted from another one


@dataclass(frozen=True, slots=True)
class Unit:
    """What the numbers are.

    Attributes
    ----------
    name : str
        ``s``, ``ms``, ``us``, ``ns``, or ``number``.
    rate : str or None
        Steps a second, where they are numbers.
    assumed : str or None
        By what that was concluded; None where it was stated.
    from_start : bool
        Whether they count from the episode's start: then they are times as they are.
    """

    name: str
    rate: str | None = None
    assumed: str | None = None
    from_start: bool = False

    def json(self) -> dict[str, Any]:
        """Return it as JSON values."""
        return {
            "name": self.name,
            "rate": self.rate,
            "assumed": self.assumed,
            "from_start": self.from_start,
        }


@dataclass(frozen=True, slots=True)
class Timeline:
    """The times of an episode's steps.

    Attributes
    ----------
    time_ns : (T,) int64
        Strictly increasing.
    nudged : (T,) bool
        Where a stamp did not come after the one before, and was moved.
    start_ns : int or None
        UTC of the episode's start, where the stamps are dates.
    clock : Clock
    nominal_rate : str or None
    gaps : list of Gap
    """

    time_ns: np.ndarray
    nudged: np.ndarray
    start_ns: int | None
    clock: Clock
    nominal_rate: str | None
    gaps: list[Gap]

    def flags(self, valid: np.ndarray | None = None) -> np.ndarray | None:
        """Return the flags of samples at these steps; None where there are none."""
        bits = np.where(self.nudged, flags()["time_nudged"].mask, 0)
        if valid is not None:
            bits |= np.where(valid, 0, flags()["invalid"].mask)
        return bits.astype(np.uint32) if bits.any() else None

    def fields(self) -> dict[str, Any]:
        """Return what `EpisodeWriter.add_stream` takes."""
        found: dict[str, Any] = {"clock": self.clock}
        if self.nominal_rate is not None:
            found["nominal_rate"] = self.nominal_rate
        if self.gaps:
            found["gaps"] = self.gaps
        return found


def find_unit(stamps: np.ndarray, told: str, rate: str | None, stated: object) -> Unit:
    """Find out what timestamps are.

    Parameters
    ----------
    stamps : (T,) number
        Of an episode.
    told : str
        ``auto``, or what the user says.
    rate : str or None
        Steps a second, as the user says.
    stated : object
        The unit that the store states.

    Raises
    ------
    SourceError
        They count steps and nobody says how many a second, or nothing can be concluded.
    """
    if told == "number":
        return _number(rate, assumed=None)
    if told != "auto":
        return Unit(told)
    if isinstance(stated, str) and stated in _NS:
        return Unit(stated, from_start=True)
    steps = np.diff(stamps.astype(np.float64))
    if len(steps) and (steps == 1).all():
        return _number(rate, assumed="each is one more than the one before")
    period = float(np.median(steps)) if len(steps) else float("nan")
    for name, longest in _LONGEST.items():
        if _SHORTEST_S * (NS_PER_S / _NS[name]) <= period < longest:
            return Unit(name, assumed=f"they are {period:g} apart")
    raise SourceError(
        f"nothing tells the unit of the timestamps (they are {period:g} apart)",
        fix="Say -o timestamps=s (ms, us, ns), or -o timestamps=number and --rate.",
    )


def _number(rate: str | None, *, assumed: str | None) -> Unit:
    if rate is None:
        raise SourceError(
            "the timestamps only count steps, and nothing says how many a second there are",
            fix="Say so: --rate 30.",
        )
    return Unit("number", rate=format_rate(parse_rate(rate)), assumed=assumed)


def read_timeline(stamps: np.ndarray, unit: Unit) -> Timeline:
    """Turn timestamps into times.

    Parameters
    ----------
    stamps : (T,) number
    unit : Unit

    Raises
    ------
    SourceError
        They are no times.
    """
    if not np.isfinite(stamps).all():
        place = int(np.argmin(np.isfinite(stamps)))
        raise SourceError(f"the timestamp of step {place} is no number", fix=_FIX)
    if unit.name == "number":
        return _counted(stamps, parse_rate(str(unit.rate)))
    raw, start_ns = _nanoseconds(stamps, unit)
    time, nudged = strictly_increasing(raw)
    if np.count_nonzero(nudged) > max(1, _NUDGED_SHARE * len(time)):
        place = int(np.argmax(nudged))
        raise SourceError(
            f"{np.count_nonzero(nudged)} of {len(time)} timestamps do not come after the one "
            f"before, the first is that of step {place}",
            fix=_FIX,
        )
    rounding = 0.5 * _NS[unit.name] / NS_PER_S if stamps.dtype.kind in "iu" else 0.0
    return _described(time, nudged, start_ns, rounding)


_FIX = "Mend the store, or say -o timestamps=number and --rate: then steps are counted."


def _nanoseconds(stamps: np.ndarray, unit: Unit) -> tuple[np.ndarray, int | None]:
    """Return times since the episode's start, and the start where stamps are dates."""
    scale = _NS[unit.name]
    if np.abs(stamps.astype(np.float64)).max(initial=0.0) * scale >= _LIMIT_NS:
        raise SourceError("the timestamps lie more than 146 years apart from 1970", fix=_FIX)
    first = stamps[0]
    first_ns = int(first) * scale if stamps.dtype.kind in "iu" else round(float(first) * scale)
    zero = stamps.dtype.type(0) if unit.from_start else first
    if stamps.dtype.kind in "iu":
        time = (stamps.astype(np.int64) - np.int64(zero)) * scale
    else:
        time = np.rint((stamps.astype(np.float64) - float(zero)) * scale).astype(np.int64)
    dated = not unit.from_start and first_ns >= _YEAR_2000_NS
    return time, first_ns if dated else None


def _counted(stamps: np.ndarray, rate: Fraction) -> Timeline:
    """Return the times of numbered steps; where the numbers are none, steps are counted."""
    numbers = np.arange(len(stamps), dtype=np.int64)
    small = np.abs(stamps.astype(np.float64)).max(initial=0.0) < 2**40
    if (
        small
        and (stamps == np.floor(stamps)).all()
        and (np.diff(stamps.astype(np.int64)) > 0).all()
    ):
        numbers = stamps.astype(np.int64) - int(stamps[0])
    time = tick_times_ns(numbers, 1 / rate)
    return Timeline(
        time,
        np.zeros(len(time), bool),
        None,
        Clock(source="none", stamp_point="nominal_rate"),
        format_rate(rate),
        find_gaps(time, rate),
    )


def _described(
    time: np.ndarray, nudged: np.ndarray, start_ns: int | None, rounding_s: float
) -> Timeline:
    """Say whether times were measured: those of a rate, to the microsecond, were not."""
    clock = Clock(source="oxt", stamp_point="unknown")
    if len(time) > 2 and not nudged.any():
        period = float(np.median(np.diff(time)))
        if rounding_s:
            period = float(time[-1] - time[0]) / max(1, round((time[-1] - time[0]) / period))
        rate = Fraction(NS_PER_S / period).limit_denominator(_MOST_DENOMINATOR)
        if rate > 0 and is_nominal(time, rate, max(_EXACT_S, rounding_s)):
            clock = Clock(source="oxt", stamp_point="nominal_rate")
            time = _on_grid(time, rate)
            return Timeline(time, nudged, start_ns, clock, format_rate(rate), find_gaps(time, rate))
    return Timeline(time, nudged, start_ns, clock, None, [])


def _on_grid(time: np.ndarray, rate: Fraction) -> np.ndarray:
    """Undo what rounding the stamps did to the times of a rate: dates have 238 ns in float64."""
    numbers = np.rint((time - time[0]) * (float(rate) / NS_PER_S)).astype(np.int64)
    exact = np.asarray(time[0] + tick_times_ns(numbers, 1 / rate))
    return time if np.abs(exact - time).max() <= _ROUNDING_NS else exact
