"""Streams against each other: latency estimated from the data, against the declared one.

What is estimated is what the declared correction has left: `time` is compared with `time`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from exumi_data.synchronisation import (
    LatencyEstimate,
    estimate_tap_latency,
    estimate_touch_latency,
    find_touches,
    still_touches,
)
from exumi_validators.checks.clocks import other_clocks
from exumi_validators.checks.timing import rhythm
from exumi_validators.context import EXUMI, ROOT, EpisodeContext
from exumi_validators.curves import Curve, activity_of, curve_of, of_kind, width_of
from exumi_validators.findings import problem
from exumi_validators.registry import Finding, check
from exumi_validators.report import Problem, Skipped

__all__ = ["latency"]

_COMPARED = ("tactile", "width", "pose")
_CODES = ("SYNC-001", "SYNC-002")
_STEPS = "its clock steps"


@dataclass(frozen=True, slots=True)
class _Pair:
    """How late a stream is relative to another one.

    Attributes
    ----------
    stream, reference : str
    found : LatencyEstimate
    event : str
        What it was estimated from: grasp or tap.
    touch : Curve
        The activity that the events are in.
    estimate : callable
        Estimates from a part of that activity.
    """

    stream: str
    reference: str
    found: LatencyEstimate
    event: str
    touch: Curve = field(repr=False)
    estimate: Callable[[Curve], LatencyEstimate | None] = field(repr=False)


@check("SYNC-001", "SYNC-002")
def latency(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge by grasps that tactile streams are in step with the width, and poses by taps."""
    if len(episode.streams) < 2:  # one stream has nothing to be in step with
        return
    tactile = of_kind(episode, "tactile")
    if not tactile:
        yield from _skipped("no tactile stream", ROOT)
    trusted: list[str] = []
    yield from _against_width(episode, tactile, trusted)
    for name in of_kind(episode, "pose"):
        if tactile:
            yield from _against_touch(episode, name, trusted)
    for name, stream in episode.streams.items():
        if stream.kind not in _COMPARED:
            reason = f"a stream of kind {stream.kind} is compared with no other"
            yield from _skipped(reason, f"streams/{name}")


def _against_width(
    episode: EpisodeContext, tactile: list[str], trusted: list[str]
) -> Iterator[Finding]:
    """Judge tactile streams by the grasps; adds those that are not out of step to `trusted`."""
    pairs: dict[str, _Pair] = {}
    for name in tactile:
        found = _by_grasps(episode, name)
        if isinstance(found, _Pair):
            pairs[name] = found
        else:
            yield from _skipped(found, f"streams/{name}")
    off = {name: pair for name, pair in pairs.items() if _broken(episode, pair)}
    trusted += [name for name in tactile if name not in off]
    for width in dict.fromkeys(pair.reference for pair in off.values()):
        fingers = [pair for pair in pairs.values() if pair.reference == width]
        late = _late_width(episode, fingers)
        if late is None:
            for pair in fingers:
                if pair.stream in off:
                    yield from _judged(episode, pair)
        else:
            yield from _judged(episode, late)
            trusted += [pair.stream for pair in fingers]


def _against_touch(episode: EpisodeContext, name: str, tactile: list[str]) -> Iterator[Finding]:
    """Judge a pose by the taps that a tactile stream felt."""
    path = f"streams/{name}"
    pose = curve_of(episode, name, f"{path}/data")
    if isinstance(pose, str):
        yield from _skipped(pose, path)
        return
    for other in tactile:
        pair = _by_taps(episode, name, other, pose)
        if pair is not None:
            if _broken(episode, pair):
                yield from _judged(episode, pair)
            return
    yield from _skipped("no tap that tells", path)


# ------------------------------------------------------------------------------------- estimates


def _by_grasps(episode: EpisodeContext, name: str) -> _Pair | str:
    """Compare a tactile stream with the width of its gripper; else return why it cannot be."""
    other = width_of(episode, name)
    if other is None:
        return "no width of the same gripper"
    touch = activity_of(episode, name)
    width = curve_of(episode, other, f"streams/{other}/data")
    if isinstance(touch, str):
        return touch
    if isinstance(width, str):
        return width

    def estimate(part: Curve) -> LatencyEstimate | None:
        return estimate_touch_latency(part.time_ns, part.values, width.time_ns, width.values)

    found = estimate(touch)
    if found is None:
        return "no grasp that tells"
    return _Pair(name, other, found, "grasp", touch, estimate)


def _by_taps(episode: EpisodeContext, name: str, other: str, pose: Curve) -> _Pair | None:
    """Compare a pose with a tactile stream; None where no tap tells."""
    touch = activity_of(episode, other)
    if isinstance(touch, str):
        return None
    gripper = width_of(episode, other)
    width = None if gripper is None else curve_of(episode, gripper, f"streams/{gripper}/data")
    if isinstance(width, str) or (width is None and _may_grasp(episode)):
        return None

    def estimate(part: Curve) -> LatencyEstimate | None:
        touches = find_touches(part.time_ns, part.values)
        if width is not None:
            touches = still_touches(touches, part.time_ns, width.time_ns, width.values)
        found = estimate_tap_latency(
            part.time_ns, part.values, pose.time_ns, pose.values[:, :3], touches
        )
        return None if found is None else replace(found, offset_s=-found.offset_s)

    found = estimate(touch)
    return None if found is None else _Pair(name, other, found, "tap", touch, estimate)


def _may_grasp(episode: EpisodeContext) -> bool:
    embodiment = episode.section("embodiment")
    return embodiment is None or embodiment.gripper != "none"


# --------------------------------------------------------------------------------------- judging


def _broken(episode: EpisodeContext, pair: _Pair) -> str | None:
    """Return the rule that a pair breaks, if any."""
    away = abs(pair.found.offset_s)
    for code in _CODES:
        sigmas = episode.limit(code, "sigmas")
        if away > max(episode.limit(code, "offset_s"), sigmas * pair.found.sigma_s):
            return code
    return None


def _judged(episode: EpisodeContext, pair: _Pair) -> Iterator[Finding]:
    """Report a pair that is out of step, unless a clock steps: then it has no one latency."""
    if _steps(episode, pair):
        yield from _skipped(_STEPS, f"streams/{pair.stream}")
        return
    code, found = _broken(episode, pair), pair.found
    assert code is not None  # noqa: S101  # only such pairs come here
    sign = "late" if found.offset_s > 0 else "early"
    declared = episode.streams[pair.stream].clock.latency_ns * 1e-6
    yield problem(
        code,
        ROOT,
        pointer=(*EXUMI, "streams", pair.stream, "clock"),
        expected="in step",
        found=f"{abs(found.offset_s) * 1e3:.1f} ± {found.sigma_s * 1e3:.1f} ms {sign}",
        stream=pair.stream,
        reference=pair.reference,
        declared=f"{declared:.1f} ms",
        events=f"{found.n_events} {pair.event}{'s' * (found.n_events > 1)}",
    )


def _late_width(episode: EpisodeContext, fingers: list[_Pair]) -> _Pair | None:
    """Return the width against its fingers, where these agree with a pose and not with it.

    Parameters
    ----------
    episode : EpisodeContext
    fingers : list of _Pair
        All of the gripper's tactile streams that tell, against the width.
    """
    best = min(fingers, key=lambda pair: pair.found.sigma_s)
    if not all(_broken(episode, pair) and _same(episode, pair, best) for pair in fingers):
        return None
    witnesses = []
    for name in of_kind(episode, "pose"):
        pose = curve_of(episode, name, f"streams/{name}/data")
        pairs = (
            []
            if isinstance(pose, str)
            else [_by_taps(episode, name, pair.stream, pose) for pair in fingers]
        )
        for pair in pairs:
            if pair is None:
                continue
            if _broken(episode, pair) or not _differ(episode, pair.found, _turned(best.found)):
                return None
            witnesses.append(name)
    if not witnesses:
        return None
    names = [pair.stream for pair in fingers] + list(dict.fromkeys(witnesses))
    reference = ", ".join(names[:-1]) + f" and {names[-1]}"
    return replace(best, stream=best.reference, reference=reference, found=_turned(best.found))


def _turned(found: LatencyEstimate) -> LatencyEstimate:
    return replace(found, offset_s=-found.offset_s)


def _same(episode: EpisodeContext, pair: _Pair, other: _Pair) -> bool:
    return not _differ(episode, pair.found, other.found)


def _differ(episode: EpisodeContext, a: LatencyEstimate, b: LatencyEstimate) -> bool:
    sigma = float(np.hypot(a.sigma_s, b.sigma_s))
    return abs(a.offset_s - b.offset_s) > episode.limit("SYNC-002", "sigmas") * sigma


# --------------------------------------------------------------------------------- clocks that step


def _steps(episode: EpisodeContext, pair: _Pair) -> bool:
    """Whether the latency changes where another rule finds that time leaps."""
    for name in (pair.stream, pair.reference):
        for at_ns in _leaps(episode, name):
            before, after = (pair.estimate(part) for part in pair.touch.cut(at_ns))
            if before is not None and after is not None and _differ(episode, before, after):
                return True
    return False


def _leaps(episode: EpisodeContext, name: str) -> Iterator[int]:
    """Go through the times at which a stream is found to step, or to be silent without a gap."""
    reader = episode.reader(f"streams/{name}/time")
    for judge, code in ((other_clocks, "CLOCK-005"), (rhythm, "TIME-006")):
        for found in judge(episode) if reader is not None else ():
            if not isinstance(found, Problem) or found.code != code:
                continue
            place = found.location
            if reader is not None and place.index and place.path.split("/")[1] == name:
                yield int(reader.rows(place.index, place.index + 1)[0])


def _skipped(reason: str, path: str) -> Iterator[Skipped]:
    for code in _CODES:
        yield Skipped(code, f"not estimable: {reason}", path)
