"""Pose and width: what a hand and a gripper cannot do."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from exumi_data.model.description import CalibrationItem
from exumi_data.model.streams import PoseStream, RawData, WidthStream
from exumi_data.raw_to_data import read_range
from exumi_validators.context import EpisodeContext
from exumi_validators.findings import problem
from exumi_validators.motion import (
    Break,
    Change,
    Reach,
    Steps,
    Still,
    StillLimits,
    find_breaks,
    find_still,
)
from exumi_validators.registry import Finding, check
from exumi_validators.report import Problem, Skipped
from exumi_validators.series import BoolArray, Float64Array, Series, read_series, typical_step_s

__all__ = ["pose_motion", "width_in_calibration", "width_motion"]

# A file that is nothing but breaks is not worth the time to count them all.
_MOST = 1000
# Fast steps of a width this close together are one event, such as a reading out and back.
_NEAR = 2


# -------------------------------------------------------------------------------------------- pose


@dataclass(slots=True)
class _Track:
    """What was found in a stream of poses so far.

    Attributes
    ----------
    breaks : list
        With the first sample of each.
    still : list
    changed : bool
        Some two poses differ.
    steps, too_far : int
        Steps that were judged, and those of them that go further than a hand.
    """

    breaks: list[tuple[int, Break]] = field(default_factory=list)
    still: list[Still] = field(default_factory=list)
    changed: bool = False
    steps: int = 0
    too_far: int = 0


@check("POSE-003", "POSE-004", "POSE-005")
def pose_motion(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that poses move as a hand can, and that the tracking lives."""
    for name, stream in episode.streams.items():
        count = episode.count(name)
        if isinstance(stream, PoseStream) and count is not None:
            path = f"streams/{name}/data"
            track = _track(episode, name, count)
            if isinstance(track, str):
                for code in ("POSE-003", "POSE-004", "POSE-005"):
                    yield Skipped(code, track, path)
            else:
                yield from _broken(episode, path, track)
                yield from _frozen(episode, path, stream, track)


def _track(episode: EpisodeContext, name: str, count: int) -> _Track | str:
    """Read a stream of poses; return what is in it, or why that cannot be said."""
    still = StillLimits(
        episode.limit("POSE-005", "still_s"),
        int(episode.limit("POSE-005", "samples")),
        *_reaches(episode, "POSE-005"),
    )
    linear, angular = _reaches(episode, "POSE-004")
    if count < episode.limit("POSE-003", "samples"):
        return "too few poses"
    track, since, least_s = _Track(), None, 0.0
    last = 0
    for series in read_series(episode, name, "data"):
        least_s = least_s or typical_step_s(series)
        if least_s <= 0:
            break
        poses, step_s = series.values[0], series.step_s(least_s)
        steps = Steps.of(poses, step_s, series.joined)
        since = since or Change(series.start, int(series.time[0]))
        found, since = find_still(series, steps, since, still)
        track.still += found[: _MOST - len(track.still)]
        last = int(series.time[-1])
        judged = steps.joined[series.own]
        track.steps += int(np.count_nonzero(judged))
        reach_m = linear.speed * steps.step_s[series.own]
        track.too_far += int(np.count_nonzero(judged & (steps.moved[series.own] > reach_m)))
        # Where a track that stood still goes on, it leaps: that is one defect.
        leaps = [run.end - 1 - series.start for run in found]
        steps = replace(steps, joined=steps.joined & ~np.isin(np.arange(len(step_s)), leaps))
        left = _MOST - len(track.breaks)
        for item in find_breaks(poses, steps, linear, angular, most=left):
            if series.own.start < item.index <= series.own.stop:
                track.breaks.append((series.start + item.index, item))
    if since is None:
        return "no two poses to compare"
    track.changed = since.index > 0
    tail = Still(since.index, count, (last - since.time) * 1e-9, since.abrupt, leapt=False)
    if tail.seconds >= still.seconds and count - tail.index >= still.samples:
        track.still.append(tail)
    return track


def _reaches(episode: EpisodeContext, code: str) -> tuple[Reach, Reach]:
    """Return the limits of a rule in metres and in radians."""
    return (
        Reach(
            episode.limit("POSE-003", "speed_m_per_s"),
            episode.limit(code, "step_m"),
            episode.limit(code, "acceleration_m_per_s2"),
        ),
        Reach(
            episode.limit("POSE-003", "turn_rad_per_s"),
            math.radians(episode.limit(code, "step_deg")),
            episode.limit(code, "acceleration_rad_per_s2"),
        ),
    )


def _broken(episode: EpisodeContext, path: str, track: _Track) -> Iterator[Problem]:
    fast = [(index, item) for index, item in track.breaks if item.kind != "jump"]
    jumps = [(index, item) for index, item in track.breaks if item.kind == "jump"]
    if fast:
        index, item = fast[0]
        found, expected = _in_words(episode, item)
        detail = f"places: {_counted(len(fast))}"
        if track.too_far > episode.limit("POSE-003", "unit_share") * track.steps:
            detail = f"{track.too_far} of {track.steps} steps, as in another unit than metres"
        yield problem("POSE-003", path, index=index, expected=expected, found=found, detail=detail)
    if jumps:
        index, item = jumps[0]
        found = f"{item.moved:.3g} m and {math.degrees(item.turned):.3g} degrees"
        count = _counted(len(jumps))
        yield problem("POSE-004", path, index=index, found=found, count=count)


def _counted(number: int) -> str:
    return f"{number} or more" if number >= _MOST else str(number)


def _in_words(episode: EpisodeContext, item: Break) -> tuple[str, str]:
    """Return what was found and what was expected."""
    speed = episode.limit("POSE-003", "speed_m_per_s")
    turn = episode.limit("POSE-003", "turn_rad_per_s")
    if item.kind == "fast":
        if item.moved > speed:
            return f"{item.moved:.3g} m/s", f"{speed:g} m/s"
        return f"{item.turned:.3g} rad/s", f"{turn:g} rad/s"
    if item.moved:
        return f"{item.moved:.3g} m out and back", f"{episode.limit('POSE-004', 'step_m'):g} m"
    degrees = math.degrees(item.turned)
    expected = f"{episode.limit('POSE-004', 'step_deg'):g} degrees"
    return f"{degrees:.3g} degrees out and back", expected


def _frozen(
    episode: EpisodeContext, path: str, stream: PoseStream, track: _Track
) -> Iterator[Finding]:
    if stream.clock.stamp_point == "nominal_rate":
        yield Skipped("POSE-005", "times were not measured", path)
        return
    # A simulated hand may halt at once; a real one, or its tracker's noise, does not.
    may_halt = stream.clock.stamp_point == "simulated"
    # What a tracker measures has noise, whatever the hand does.
    source = episode.section("source")
    tracked = source is not None and source.type == "recorded" and not may_halt
    rest_s = episode.limit("POSE-005", "rest_s") if tracked else math.inf
    frozen = [
        run
        for run in track.still
        if run.leapt or (run.halted and not may_halt) or run.seconds >= rest_s
    ]
    if frozen:
        found, count = round(frozen[0].seconds, 3), _counted(len(frozen))
        yield problem("POSE-005", path, index=frozen[0].index, found=found, count=count)
    elif not track.changed:
        yield Skipped("POSE-005", "the pose never changes", path)
    elif track.still:
        yield Skipped("POSE-005", "the pose stands still, and does not tell why", path)


# ------------------------------------------------------------------------------------------- width


@check("WIDTH-003", "WIDTH-005")
def width_motion(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that widths change as a gripper can move, also where its encoder wraps."""
    for name, stream in episode.streams.items():
        if not isinstance(stream, WidthStream) or episode.count(name) is None:
            continue
        path = f"streams/{name}/data"
        if (episode.count(name) or 0) < episode.limit("WIDTH-005", "samples"):
            yield Skipped("WIDTH-003", "too few widths", path)
            yield Skipped("WIDTH-005", "too few widths", path)
            continue
        yield from _fast_widths(episode, name, stream.raw)


def _fast_widths(episode: EpisodeContext, name: str, raw: RawData | None) -> Iterator[Finding]:
    path = f"streams/{name}/data"
    limit = episode.limit("WIDTH-005", "speed_m_per_s")
    there = episode.reader(f"streams/{name}/raw") is not None
    counted = raw is not None and raw.unit == "count" and there
    if not counted:
        yield Skipped("WIDTH-003", "there are no counts", path)
    places: dict[str, list[tuple[int, float]]] = {"WIDTH-003": [], "WIDTH-005": []}
    least_s = 0.0
    for series in read_series(episode, name, "data", *(("raw",) if counted else ())):
        least_s = least_s or typical_step_s(series)
        if least_s <= 0:
            yield Skipped("WIDTH-005", "no two widths to compare", path)
            return
        speed = _speed(series, least_s)
        fast = speed > limit
        if not fast.any():
            continue
        wrapped = np.zeros(len(fast), dtype=bool)
        if raw is not None and counted:
            least = episode.limit("WIDTH-003", "least_modulus")
            wrapped = fast & _wraps(series.values[1], raw.modulus, least)
        for code, steps in (("WIDTH-003", wrapped), ("WIDTH-005", fast & ~_beside(wrapped))):
            at = np.flatnonzero(steps[series.own])[:_MOST] + series.own.start
            places[code] += [(series.start + step + 1, float(speed[step])) for step in at.tolist()]
    for code, found in places.items():
        if found:
            index, worst = found[0]
            apart = [b[0] - a[0] > _NEAR for a, b in itertools.pairwise(found)]
            count = _counted(1 + sum(apart))
            shown = round(worst, 3)
            yield problem(code, path, index=index, expected=limit, found=shown, count=count)


def _speed(series: Series, least_s: float) -> Float64Array:
    with np.errstate(all="ignore"):
        steps = np.abs(np.diff(series.values[0].astype(np.float64)))
    return np.asarray(np.where(series.joined, steps / series.step_s(least_s), 0.0))


def _wraps(counts: np.ndarray, modulus: int | None, least: float) -> BoolArray:
    """Return the steps at which a counter goes over its end.

    Where nobody says what the end is, it is taken for the next power of two, at least `least`.
    """
    flat = counts.reshape(len(counts), -1)[:, 0].astype(np.float64)
    if modulus is None:
        top = float(np.nanmax(flat, initial=0.0))
        modulus = 1 << int(top).bit_length() if 0 <= top < 1 << 53 else 0
        if modulus < max(least, 1):
            return np.zeros(len(flat) - 1, dtype=bool)
    with np.errstate(all="ignore"):
        return np.asarray(np.abs(np.diff(flat)) > modulus / 2, dtype=bool)


def _beside(steps: BoolArray) -> BoolArray:
    """Return steps, and those within a few samples of them: a wrap to and fro is one event."""
    near = steps.copy()
    for shift in range(1, _NEAR + 1):
        near[shift:] |= steps[:-shift]
        near[:-shift] |= steps[shift:]
    return near


@check("WIDTH-004")
def width_in_calibration(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that widths lie where their calibration holds, or say that they do not."""
    items = {pointer[-1]: item for pointer, item in episode.parts(CalibrationItem, "calibration")}
    for name, stream in episode.streams.items():
        if not isinstance(stream, WidthStream):
            continue
        path = f"streams/{name}/data"
        item = items.get((stream.raw.transform or "") if stream.raw else "")
        if item is None:
            yield Skipped("WIDTH-004", "the width has no calibration", path)
            continue
        bounds = read_range(item.value)
        if bounds is None:
            yield Skipped("WIDTH-004", "the calibration states no `range_m`", path)
            continue
        yield from _out_of_range(episode, name, bounds)


def _out_of_range(
    episode: EpisodeContext, name: str, bounds: tuple[float, float]
) -> Iterator[Problem]:
    path = f"streams/{name}/data"
    tolerance = episode.limit("WIDTH-004", "tolerance_m")
    low, high = bounds
    first: tuple[int, float] | None = None
    count = 0
    for series in read_series(episode, name, "data"):
        widths = series.values[0]
        outside = series.usable & ((widths < low - tolerance) | (widths > high + tolerance))
        own = series.own_samples
        count += int(outside[own].sum())
        if first is None and outside[own].any():
            row = own.start + int(outside[own].argmax())
            first = series.start + row, float(widths[row])
    if first is not None:
        index, width = first
        found, expected = f"{width:.4g}", f"{low:g} to {high:g} m"
        yield problem("WIDTH-004", path, index=index, expected=expected, found=found, count=count)
