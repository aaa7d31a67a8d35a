"""Times, clocks, sequences, flags and gaps."""

import math
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import numpy as np

from exumi_data.model.clock import Clock
from exumi_data.model.streams import StreamModel, images_of
from exumi_data.standard import flags, units
from exumi_data.time import NS_PER_S, TIME_LIMIT_NS, apply_clock, parse_rate
from exumi_validators.context import EXUMI, ROOT, EpisodeContext
from exumi_validators.findings import problem
from exumi_validators.registry import check
from exumi_validators.report import Problem
from exumi_validators.sample_flags import flagged

__all__ = [
    "flags_fit",
    "gaps",
    "in_range",
    "increasing",
    "known_flags",
    "nominal_grid",
    "off_grid",
    "raw_scale",
    "raw_time",
    "sequences",
]

_ROUNDING_NS = 1


@check("TIME-001")
def increasing(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that time increases."""
    for name in episode.streams:
        path = f"streams/{name}/time"
        last: np.ndarray | None = None
        for start, (time,) in episode.blocks(path):
            joined = time if last is None else np.concatenate((last, time))
            wrong = joined[1:] <= joined[:-1]
            if wrong.any():
                row = int(wrong.argmax())
                expected, found = int(joined[row]), int(joined[row + 1])
                index = start + row + (last is None)
                yield problem("TIME-001", path, index=index, expected=expected, found=found)
                break
            last = time[-1:]


@check("TIME-002")
def in_range(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that times are small enough for their differences to be computed."""
    for name in episode.streams:
        path = f"streams/{name}/time"
        for start, (time,) in episode.blocks(path):
            wrong = (time <= -TIME_LIMIT_NS) | (time >= TIME_LIMIT_NS)
            if wrong.any():
                row = int(wrong.argmax())
                yield problem("TIME-002", path, index=start + row, found=int(time[row]))
                break


@check("TIME-003")
def raw_time(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that time follows from the raw time by the clock."""
    for name, stream in episode.streams.items():
        if stream.clock.raw_time is None:
            continue
        scale = raw_scale(stream, stream.clock.raw_time)
        if scale is None:
            continue
        path = f"streams/{name}/time"
        paths = [path, f"streams/{name}/{stream.clock.raw_time}"]
        if flags_fit(episode, name):
            paths.append(f"streams/{name}/flags")
        for start, (time, raw, *flag) in episode.blocks(*paths):
            expected = _corrected(raw, scale, stream.clock)
            if expected is None:
                found = int(time[0])
                yield problem(
                    "TIME-003", path, index=start, expected="a time out of range", found=found
                )
                break
            wrong = np.abs(time - expected) > _ROUNDING_NS
            if flag:
                wrong &= ~flagged(flag[0], "time_nudged")
            if wrong.any():
                row = int(wrong.argmax())
                yield problem(
                    "TIME-003",
                    path,
                    index=start + row,
                    expected=int(expected[row]),
                    found=int(time[row]),
                )
                break


def raw_scale(stream: StreamModel, array: str) -> int | None:
    """Nanoseconds a unit of a raw time; None when the unit is none of time.

    Parameters
    ----------
    stream : StreamModel
    array : {"time_host", "time_device"}
    """
    if array == "time_device":
        unit = units().get(stream.time_device_unit or "")
        return None if unit is None else unit.ns
    return 1


def flags_fit(episode: EpisodeContext, name: str) -> bool:
    """Whether a stream has flags, one for each sample.

    Parameters
    ----------
    episode : EpisodeContext
    name : str
        Of the stream.
    """
    reader = episode.reader(f"streams/{name}/flags")
    return reader is not None and reader.shape[0] == episode.count(name)


def _corrected(raw: np.ndarray, scale: int, clock: Clock) -> np.ndarray | None:
    if max(abs(int(raw.min())), abs(int(raw.max()))) >= TIME_LIMIT_NS // scale:
        return None
    try:
        return apply_clock(
            raw * np.int64(scale),
            t_ref=clock.t_ref_ns,
            drift_ppm=clock.drift_ppm,
            offset_ns=clock.offset_ns,
            latency_ns=clock.latency_ns,
        )
    except ValueError:
        return None


@check("TIME-004")
def nominal_grid(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that nominal times are whole periods apart, lost samples allowed."""
    for name, stream in episode.streams.items():
        if stream.clock.stamp_point != "nominal_rate" or stream.nominal_rate is None:
            continue
        rate = parse_rate(stream.nominal_rate)
        # The first time was rounded as well.
        tolerance = 2 * _ROUNDING_NS + _time_base_ns(stream)
        path = f"streams/{name}/time"
        origin: int | None = None
        for start, (time,) in episode.blocks(path):
            origin = int(time[0]) if origin is None else origin
            off = np.asarray(off_grid(time, origin, rate) > tolerance, dtype=bool)
            if off.any():
                row = int(off.argmax())
                expected = f"{stream.nominal_rate} Hz from {origin} ns on"
                found = int(time[row])
                index = start + row
                yield problem("TIME-004", path, index=index, expected=expected, found=found)
                break


def _time_base_ns(stream: StreamModel) -> int:
    """Return the longest time base: containers can only write times that are whole units of it."""
    files = getattr(images_of(stream), "files", [])
    bases = [Fraction(file.time_base) * NS_PER_S for file in files]
    return math.ceil(max(bases, default=Fraction(0)))


def off_grid(time: np.ndarray, origin: int, rate: Fraction) -> np.ndarray:
    """Return the distance of each time to the nearest whole number of periods, exact.

    Parameters
    ----------
    time : (N,) int64
        Nanoseconds.
    origin : int
        A time on the grid, nanoseconds.
    rate : Fraction
        Samples a second.

    Returns
    -------
    (N,) int64 or object
        Nanoseconds.
    """
    steps, unit = rate.numerator, NS_PER_S * rate.denominator
    largest = max(abs(int(time.min()) - origin), abs(int(time.max()) - origin)) + 1
    fits = 2 * largest * steps + 2 * unit < 1 << 62
    elapsed: Any = time - np.int64(origin) if fits else time.astype(object) - origin
    count = (2 * elapsed * steps + unit) // (2 * unit)
    return np.asarray(np.abs(elapsed - (2 * count * unit + steps) // (2 * steps)))


@check("SEQ-001")
def sequences(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that a counter that goes back says so."""
    for name, stream in episode.streams.items():
        if "sequence" not in stream.arrays:
            continue
        path = f"streams/{name}/sequence"
        has_flags = flags_fit(episode, name)
        paths = (path, f"streams/{name}/flags") if has_flags else (path,)
        last: np.ndarray | None = None
        for start, (sequence, *flag) in episode.blocks(*paths):
            back = np.zeros(len(sequence), dtype=bool)
            back[1:] = sequence[1:] <= sequence[:-1]
            before = np.concatenate((sequence[:1] if last is None else last, sequence[:-1]))
            back[0] = last is not None and bool(sequence[0] <= last[0])
            if has_flags:
                back &= ~flagged(flag[0], "out_of_order")
            if back.any():
                row = int(back.argmax())
                expected, found = int(before[row]), int(sequence[row])
                index = start + row
                yield problem("SEQ-001", path, index=index, expected=expected, found=found)
                break
            last = sequence[-1:]


@check("FLAG-001")
def known_flags(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that flags are registered; a newer version may know more."""
    known = np.uint32(sum(flag.mask for flag in flags().values()))
    for name, stream in episode.streams.items():
        if "flags" not in stream.arrays or episode.newer:
            continue
        path = f"streams/{name}/flags"
        for start, (values,) in episode.blocks(path):
            unknown = values & ~known
            if unknown.any():
                row = int((unknown != 0).argmax())
                found = f"{int(unknown[row]):#x}"
                yield problem("FLAG-001", path, index=start + row, found=found)
                break


@check("GAP-001")
def gaps(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that recorded gaps lie within the stream, in order."""
    for name, stream in episode.streams.items():
        count = episode.count(name)
        last = -2
        for index, gap in enumerate(stream.gaps or []):
            mistake = None
            if count is not None and gap.after >= count:
                mistake = f"but there are {count}"
            elif gap.after <= last:
                mistake = f"which does not come after sample {last}"
            if mistake:
                pointer = (*EXUMI, "streams", name, "gaps", index, "after")
                yield problem(
                    "GAP-001", ROOT, pointer=pointer, index=index, found=gap.after, detail=mistake
                )
            last = gap.after
