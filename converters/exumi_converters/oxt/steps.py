"""The steps of an episode: one timeline for all streams, cut where one has nothing to say."""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from exumi_converters.oxt.options import OxtOptions
from exumi_converters.oxt.places import Place
from exumi_data.episode import Episode, StreamView
from exumi_data.standard import flags
from exumi_data.ticks import image_tolerance_ns, max_gap_ns
from exumi_data.time import (
    DEFAULT_GAP_FACTOR,
    bracket_indices,
    nearest_indices,
    nominal_times,
    parse_rate,
)

__all__ = ["Samples", "Steps", "find_steps"]

_SHORTEST = 2
_NS = 1_000_000_000
_NEAREST = ("camera", "tactile", "taxels")


@dataclass(frozen=True, slots=True)
class Samples:
    """The samples of a stream that hold a value: those that are not flagged invalid.

    Attributes
    ----------
    index : (n,) int64
        Their places in the stream.
    time_ns : (n,) int64
    gap_ns : int
        The longest stretch that is interpolated over.
    """

    index: np.ndarray
    time_ns: np.ndarray
    gap_ns: int

    @classmethod
    def of(cls, stream: StreamView) -> "Samples":
        """Read times and flags of a stream."""
        time = stream.time
        index = np.arange(len(time))
        if stream.flags is not None:
            index = index[stream.flags & flags()["invalid"].mask == 0]
        return cls(index, time[index], max_gap_ns(time))


@dataclass(frozen=True, slots=True)
class Steps:
    """The steps that an episode is written with.

    Attributes
    ----------
    time_ns : (T,) int64
        Since the episode's start.
    ends : tuple of int
        One past the last step of each piece that the episode is cut into.
    left_out : int
        Steps between the first and the last that a stream has no value for.
    reasons : dict of str to int
        Stream to how many of these are its own.
    """

    time_ns: np.ndarray
    ends: tuple[int, ...]
    left_out: int
    reasons: dict[str, int]


def find_steps(episode: Episode, places: list[Place], told: OxtOptions) -> Steps:
    """Find the steps of an episode. Reads times and flags only.

    Parameters
    ----------
    episode : Episode
    places : list of Place
    told : OxtOptions

    Returns
    -------
    Steps
        Without any, where the streams do not overlap.
    """
    samples = {name: Samples.of(episode[name]) for place in places for name in place.streams}
    ticks, tick_s = _ticks(episode, places, samples, told)
    valid = np.ones(len(ticks), bool)
    missing: dict[str, np.ndarray] = {}
    for place in places:
        for name in place.streams:
            has = _has_value(samples[name], place, ticks, tick_s)
            missing[name] = ~has
            valid &= has
    runs = _runs(ticks, valid)
    if not runs:
        return Steps(np.empty(0, np.int64), (), 0, {})
    first, last = runs[0][0], runs[-1][1]
    inside = {name: int(np.count_nonzero(gone[first:last])) for name, gone in missing.items()}
    kept = [np.arange(start, stop) for start, stop in runs]
    return Steps(
        ticks[np.concatenate(kept)],
        tuple(np.cumsum([len(run) for run in kept]).tolist()),
        last - first - sum(map(len, kept)),
        {name: count for name, count in inside.items() if count},
    )


def _ticks(
    episode: Episode, places: list[Place], samples: dict[str, Samples], told: OxtOptions
) -> tuple[np.ndarray, Fraction]:
    """Return the times of all steps that there might be, and their distance."""
    if told.rate:
        rate = parse_rate(told.rate)
        if any(not len(found.time_ns) for found in samples.values()):
            return np.empty(0, np.int64), 1 / rate
        start = max(int(found.time_ns[0]) for found in samples.values())
        stop = min(int(found.time_ns[-1]) for found in samples.values())
        count = max(0, int(Fraction(stop - start, _NS) * rate) + 1) if stop >= start else 0
        return start + nominal_times(count, rate), 1 / rate
    name = timeline_stream(places, told)
    time = samples[name].time_ns if name in samples else episode[name].time
    period = int(np.median(np.diff(time))) if len(time) > 1 else _NS
    return time, Fraction(max(period, 1), _NS)


def timeline_stream(places: list[Place], told: OxtOptions) -> str:
    """Return the name of the stream whose times are the steps."""
    if told.timeline:
        return told.timeline
    cameras = [place for place in places if place.kind == "camera"]
    wrist = [place for place in cameras if "wrist" in place.key]
    return (wrist or cameras)[0].streams[0]


def _has_value(samples: Samples, place: Place, ticks: np.ndarray, tick_s: Fraction) -> np.ndarray:
    if not len(samples.time_ns):
        return np.zeros(len(ticks), bool)
    if place.kind in _NEAREST:
        found = nearest_indices(samples.time_ns, ticks, image_tolerance_ns(samples.time_ns, tick_s))
        return np.asarray(found >= 0)
    return np.asarray(bracket_indices(samples.time_ns, ticks, samples.gap_ns).valid)


def _runs(ticks: np.ndarray, valid: np.ndarray) -> list[tuple[int, int]]:
    """Return the stretches of steps that follow each other, all of them valid."""
    if len(ticks) < _SHORTEST:
        return []
    distance = np.diff(ticks)
    apart = distance > DEFAULT_GAP_FACTOR * np.median(distance)
    begins = valid & np.concatenate(([True], ~valid[:-1] | apart))
    stops = valid & np.concatenate((~valid[1:] | apart, [True]))
    pairs = zip(np.flatnonzero(begins), np.flatnonzero(stops), strict=True)
    return [(int(a), int(b) + 1) for a, b in pairs if b + 1 - a >= _SHORTEST]
