"""Streams against each other: latency estimated from the data, against the declared one.

What is estimated is what the declared correction has left: `time` is compared with `time`.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from exumi_data.synchronisation import (
    LatencyEstimate,
    estimate_tap_latency,
    estimate_touch_latency,
    find_touches,
    still_touches,
)
from exumi_validators.context import EXUMI, ROOT, EpisodeContext
from exumi_validators.findings import problem
from exumi_validators.registry import Finding, check
from exumi_validators.report import Problem, Skipped
from exumi_validators.sample_flags import flagged

__all__ = ["latency"]

# A latency is the same all along: the first hour at 1 kHz tells enough.
_MOST_SAMPLES = 1 << 22
_COMPARED = ("tactile", "width", "pose")


@dataclass(frozen=True, slots=True)
class _Curve:
    """A stream's valid samples."""

    time_ns: NDArray[np.int64]
    values: NDArray[np.floating]


@check("SYNC-001", "SYNC-002")
def latency(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge by grasps that tactile streams are in step with the width, and poses by taps."""
    if len(episode.streams) < 2:  # one stream has nothing to be in step with
        return
    tactile = _of_kind(episode, "tactile")
    if not tactile:
        yield from _skipped("no tactile stream", ROOT)
    trusted = []
    for name in tactile:
        found = list(_against_width(episode, name))
        yield from found
        if not any(isinstance(finding, Problem) for finding in found):
            trusted.append(name)
    for name in _of_kind(episode, "pose"):
        if tactile:
            yield from _against_touch(episode, name, trusted)
    for name, stream in episode.streams.items():
        if stream.kind not in _COMPARED:
            reason = f"a stream of kind {stream.kind} is compared with no other"
            yield from _skipped(reason, f"streams/{name}")


def _of_kind(episode: EpisodeContext, kind: str) -> list[str]:
    return [name for name, stream in episode.streams.items() if stream.kind == kind]


def _against_width(episode: EpisodeContext, name: str) -> Iterator[Finding]:
    """Judge a tactile stream by the grasps; the encoder, which has hardly any, is believed."""
    path = f"streams/{name}"
    other = _width_of(episode, name)
    if other is None:
        yield from _skipped("no width of the same gripper", path)
        return
    touch = _activity(episode, name)
    width = _curve(episode, other, f"streams/{other}/data")
    if isinstance(touch, str) or isinstance(width, str):
        yield from _skipped(touch if isinstance(touch, str) else str(width), path)
        return
    found = estimate_touch_latency(touch.time_ns, touch.values, width.time_ns, width.values)
    if found is None:
        yield from _skipped("no grasp that tells", path)
    else:
        yield from _judged(episode, name, other, found, "grasp")


def _against_touch(episode: EpisodeContext, name: str, tactile: list[str]) -> Iterator[Finding]:
    """Judge a pose by the taps that a tactile stream felt."""
    path = f"streams/{name}"
    pose = _curve(episode, name, f"{path}/data")
    if isinstance(pose, str):
        yield from _skipped(pose, path)
        return
    for other in tactile:
        found = _by_taps(episode, other, pose)
        if found is not None:
            yield from _judged(episode, name, other, found, "tap")
            return
    yield from _skipped("no tap that tells", path)


def _by_taps(episode: EpisodeContext, name: str, pose: _Curve) -> LatencyEstimate | None:
    """Return by how much a pose is late relative to a tactile stream."""
    touch = _activity(episode, name)
    if isinstance(touch, str):
        return None
    touches = find_touches(touch.time_ns, touch.values)
    other = _width_of(episode, name)
    if other is not None:
        width = _curve(episode, other, f"streams/{other}/data")
        if isinstance(width, str):
            return None
        touches = still_touches(touches, touch.time_ns, width.time_ns, width.values)
    elif _may_grasp(episode):
        return None
    found = estimate_tap_latency(
        touch.time_ns, touch.values, pose.time_ns, pose.values[:, :3], touches
    )
    return None if found is None else replace(found, offset_s=-found.offset_s)


def _may_grasp(episode: EpisodeContext) -> bool:
    embodiment = episode.section("embodiment")
    return embodiment is None or embodiment.gripper != "none"


def _judged(
    episode: EpisodeContext, name: str, other: str, found: LatencyEstimate, event: str
) -> Iterator[Problem]:
    away = abs(found.offset_s)
    sign = "late" if found.offset_s > 0 else "early"
    for code in ("SYNC-001", "SYNC-002"):
        sigmas = episode.limit(code, "sigmas")
        if away > max(episode.limit(code, "offset_s"), sigmas * found.sigma_s):
            declared = episode.streams[name].clock.latency_ns * 1e-6
            yield problem(
                code,
                ROOT,
                pointer=(*EXUMI, "streams", name, "clock"),
                expected="in step",
                found=f"{away * 1e3:.1f} ± {found.sigma_s * 1e3:.1f} ms {sign}",
                stream=name,
                reference=other,
                declared=f"{declared:.1f} ms",
                events=f"{found.n_events} {event}{'s' * (found.n_events > 1)}",
            )
            return


def _skipped(reason: str, path: str) -> Iterator[Skipped]:
    for code in ("SYNC-001", "SYNC-002"):
        yield Skipped(code, f"not estimable: {reason}", path)


def _width_of(episode: EpisodeContext, name: str) -> str | None:
    """Return the width stream of the gripper that a sensor sits on.

    The only one, or the one whose name ends like the sensor's: ``width_left``, ``tactile_left``.
    """
    widths = _of_kind(episode, "width")
    if len(widths) > 1:
        ending = name.rpartition("_")[2]
        widths = [width for width in widths if width.rpartition("_")[2] == ending]
    return widths[0] if len(widths) == 1 else None


def _activity(episode: EpisodeContext, name: str) -> _Curve | str:
    path = f"{name}/activity"
    if path not in episode.derived:
        return "no stored activity"
    return _curve(episode, name, f"derived/{path}")


def _curve(episode: EpisodeContext, name: str, path: str) -> _Curve | str:
    """Return the valid samples of a stream, or why they cannot be used."""
    stream = episode.streams[name]
    if stream.clock.stamp_point == "nominal_rate":
        return "times are nominal"
    paths = [f"streams/{name}/time", path]
    if "flags" in stream.arrays:
        paths.append(f"streams/{name}/flags")
    times, values, count = [], [], 0
    for _, rows in episode.blocks(*paths):
        time, value, *flag = (column[: _MOST_SAMPLES - count] for column in rows)
        good = np.isfinite(value.reshape(len(value), -1)).all(axis=1)
        if flag:
            good &= ~flagged(flag[0], "invalid")
        times.append(time[good])
        values.append(value[good])
        count += len(time)
        if count >= _MOST_SAMPLES:
            break
    if not count:
        return "arrays cannot be read"
    joined = np.concatenate(times)
    if not (joined[1:] > joined[:-1]).all():
        return "times do not increase"
    return _Curve(joined, np.concatenate(values))
