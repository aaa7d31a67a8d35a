"""Many clips against one session: which belong to it, and where.

Each clip is placed by itself first. The clips that are certain take their time, for a camera films
one clip at a time, and tell what the camera's clock is off by. The doubtful ones are looked for
again in what is left, near where the clock would have them. Nothing is placed by a clock alone.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from exumi_data.synchronisation.motion import Turning
from exumi_data.synchronisation.placing import (
    Fit,
    Placement,
    SessionCurve,
    place,
    still,
)
from exumi_data.synchronisation.sweep import MarkerTrack
from exumi_data.synchronisation.sweep_search import SessionPoses, place_sweep

__all__ = ["Candidate", "CommonClock", "Match", "match_clips"]

_NO_GYRO = "it has no gyroscope"
_SURE = 0.9
_LIKELY = 0.6
# How much more the next best place has to leave unexplained: demonstrations of a task are alike.
_DISTINCT = 3.0
# A clip that fits so many times worse than the others do, and not well either, is of another hand.
_WORSE, _NOT_WELL = 8.0, 0.05
_MOST_SIGMA_S = 0.01
_TOUCH_NS = 200_000_000
_DAY_S = 86_400.0
_ALIKE_S = 2.0
_LEAST_CLOCKS = 3
_LEAST_SCATTER_S = 0.05
_WINDOW_SIGMAS = 5.0
_LEAST_WINDOW_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A clip to be placed.

    Attributes
    ----------
    name : str
    turning : Turning or None
        On the clip's own clock; None where it has no gyroscope.
    start_ns, stop_ns : int
        First frame, and end of the last one, on the clip's clock.
    clock_s : float or None
        When it began by the camera's clock, seconds of some day.
    number : tuple of int or None
        The camera's own count.
    marker : MarkerTrack, str or None
        Of a clip without a gyroscope, the sweep that it shows, on the clip's own clock; or why
        there is none.
    """

    name: str
    turning: Turning | None
    start_ns: int
    stop_ns: int
    clock_s: float | None = None
    number: tuple[int, int] | None = None
    marker: MarkerTrack | str | None = None


@dataclass(slots=True)
class Match:
    """What became of a clip.

    Attributes
    ----------
    clip : Candidate
    placement : Placement or None
        None where it was not placed.
    fit : Fit or None
        The best place by its coarse shape.
    reason : str
        Why it was not placed; empty where it was.
    doubts : list of str
        What speaks against a place that was accepted.
    again : bool
        Whether it was found only with what is known of the others.
    """

    clip: Candidate
    placement: Placement | None = None
    fit: Fit | None = None
    reason: str = ""
    doubts: list[str] = field(default_factory=list)
    again: bool = False

    @property
    def start_ns(self) -> int:
        """First frame, in the session's time."""
        assert self.placement is not None  # noqa: S101  # asked of placed clips only
        return self.placement.to_session(self.clip.start_ns)

    @property
    def stop_ns(self) -> int:
        """End of the last frame, in the session's time."""
        assert self.placement is not None  # noqa: S101  # asked of placed clips only
        return self.placement.to_session(self.clip.stop_ns)

    def refuse(self, reason: str) -> None:
        """Take the place away again."""
        self.placement, self.reason = None, reason


@dataclass(frozen=True, slots=True)
class CommonClock:
    """What the camera's clock is off by, as the clips that are certain say.

    Attributes
    ----------
    ahead_s : float
        Of the session's time, modulo a day: time zones and midnight play no part.
    scatter_s : float
    clips : int
        How many agree; 0 where it is known otherwise.
    """

    ahead_s: float
    scatter_s: float
    clips: int

    def away_s(self, clock_s: float, session_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return by how much places of a clip differ from what its clock says, seconds."""
        return _around_zero(np.asarray(clock_s - session_ns * 1e-9 - self.ahead_s, np.float64))

    @property
    def window_s(self) -> float:
        """How far from the clock's word to look."""
        return max(_LEAST_WINDOW_S, _WINDOW_SIGMAS * self.scatter_s)


def match_clips(
    session: Turning,
    clips: Sequence[Candidate],
    poses: SessionPoses | None = None,
    clock: CommonClock | None = None,
) -> tuple[list[Match], CommonClock | None]:
    """Place clips in a session.

    Parameters
    ----------
    session : Turning
    clips : sequence of Candidate
    poses : SessionPoses, optional
        Of the session: what clips without a gyroscope are placed by.
    clock : CommonClock, optional
        What is known of the camera's clock: where doubtful clips are looked for again if the
        certain ones do not say.

    Returns
    -------
    matches : list of Match
        One a clip, in their order.
    clock : CommonClock or None
        None where the clips' clocks do not agree on one, and none is known.
    """
    longest = max((len_s(clip.turning) for clip in clips if clip.turning), default=0.0)
    if len(session.time_ns) < 2:
        reason = "the session's poses say nothing"
        return [Match(clip, reason=reason) for clip in clips], None
    curve = SessionCurve(session, longest)
    matches = [_alone(curve, clip) if clip.turning else _by_sweep(poses, clip) for clip in clips]
    _refuse_worse(matches)
    clock = _common_clock(matches) or clock
    taken = [(match.start_ns, match.stop_ns) for match in _placed(matches)]
    for match in matches:
        if match.placement is None and match.fit is not None:
            _once_more(curve, match, clock, taken)
    _refuse_worse(matches)
    _refuse_overlaps(matches, clock)
    _note_clocks(matches, clock)
    _note_order(matches)
    return matches, clock


def len_s(turning: Turning) -> float:
    """Return how long a curve is, seconds."""
    return float(turning.time_ns[-1] - turning.time_ns[0]) * 1e-9 if len(turning.time_ns) else 0.0


def _alone(curve: SessionCurve, clip: Candidate) -> Match:
    """Place a clip by itself, if that leaves no doubt."""
    assert clip.turning is not None  # noqa: S101  # the caller looked
    silent = still(clip.turning)
    if silent:
        return Match(clip, reason=silent)
    fit = curve.fit(clip.turning)
    match = Match(clip, fit=fit)
    if fit is None:
        match.reason = "the session is too short for it"
    elif fit.correlation < _LIKELY:
        match.reason = f"nothing in the session moves like it (correlation {fit.correlation:.2f})"
    elif fit.distinct < _DISTINCT:
        match.reason = (
            f"no place stands out (correlation {fit.correlation:.2f}, the next {fit.second:.2f})"
        )
    else:
        _refine(curve, match, fit, _SURE)
    return match


def _by_sweep(poses: SessionPoses | None, clip: Candidate) -> Match:
    """Place a clip without a gyroscope by the sweep that it shows."""
    if poses is None or not isinstance(clip.marker, MarkerTrack):
        return Match(clip, reason=clip.marker if isinstance(clip.marker, str) else _NO_GYRO)
    found = place_sweep(poses, clip.marker)
    if isinstance(found, str):
        return Match(clip, reason=found)
    return Match(clip, placement=found)


def _refine(curve: SessionCurve, match: Match, fit: Fit, least: float) -> None:
    turning = match.clip.turning
    assert turning is not None  # noqa: S101  # it was fitted
    found = place(curve.turning, turning, fit.offset_ns)
    if found is None:
        match.reason = "its motion does not tell the moment"
    elif found.correlation < least:
        match.reason = f"its motion is not that of the hand (correlation {found.correlation:.2f})"
    elif found.sigma_s > _MOST_SIGMA_S:
        match.reason = f"its motion tells the moment to {1e3 * found.sigma_s:.0f} ms only"
    elif not found.agrees:
        match.reason = f"its parts disagree by {1e3 * found.disagreement_s:.0f} ms"
    else:
        match.placement, match.fit, match.reason = found, fit, ""


def _refuse_worse(matches: Sequence[Match]) -> None:
    """Refuse the clips that fit much worse than most of the certain ones do."""
    by_gyro = [match for match in _placed(matches) if match.fit is not None]
    left = [1.0 - m.placement.correlation for m in by_gyro if m.placement and not m.again]
    if len(left) < _LEAST_CLOCKS:
        return
    limit = max(_NOT_WELL, _WORSE * float(np.median(left)))
    for match in by_gyro:
        if match.placement is not None and 1.0 - match.placement.correlation > limit:
            match.refuse(
                f"it fits much worse than the others do (correlation "
                f"{match.placement.correlation:.2f})"
            )


def _once_more(
    curve: SessionCurve,
    match: Match,
    clock: CommonClock | None,
    taken: Sequence[tuple[int, int]],
) -> None:
    """Look for a doubtful clip where no other is, and near its time where the clock is known."""
    clip = match.clip
    if clip.turning is None:
        return
    timed = clock is not None and clip.clock_s is not None

    def allowed(offset_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
        start, stop = offset_ns + clip.start_ns, offset_ns + clip.stop_ns
        free = np.ones(len(offset_ns), dtype=bool)
        for first, last in taken:
            free &= (start >= last - _TOUCH_NS) | (stop <= first + _TOUCH_NS)
        if clock is not None and clip.clock_s is not None:
            free &= np.abs(clock.away_s(clip.clock_s, start)) <= clock.window_s
        return free

    fit = curve.fit(clip.turning, allowed)
    where = "near its time by the camera's clock" if timed else "where no other clip is"
    if fit is None or fit.correlation < _LIKELY:
        match.reason += f"; nor {where}"
    elif fit.distinct < _DISTINCT:
        match.reason += f"; nor does one stand out {where}"
    else:
        _refine(curve, match, fit, _LIKELY)
        if match.placement is not None:
            match.again = True
            match.doubts.append(f"places move alike; this is the one that is left {where}")


def _common_clock(matches: Sequence[Match]) -> CommonClock | None:
    """Return what most of the placed clips' clocks agree on."""
    ahead = np.array(
        [_ahead_s(match) for match in _placed(matches) if match.clip.clock_s is not None]
    )
    if len(ahead) < _LEAST_CLOCKS:
        return None
    apart = np.abs(_around_zero(ahead[:, None] - ahead[None, :])) <= _ALIKE_S
    chosen = apart[int(apart.sum(axis=1).argmax())]
    if np.count_nonzero(chosen) < max(_LEAST_CLOCKS, 0.5 * len(ahead)):
        return None
    some = float(ahead[chosen][0])
    away = _around_zero(ahead[chosen] - some)
    middle = float(np.median(away))
    scatter = 1.4826 * float(np.median(np.abs(away - middle)))
    return CommonClock(
        (some + middle) % _DAY_S, max(scatter, _LEAST_SCATTER_S), int(np.count_nonzero(chosen))
    )


def _ahead_s(match: Match) -> float:
    return ((match.clip.clock_s or 0.0) - match.start_ns * 1e-9) % _DAY_S


def _around_zero(seconds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return times of a day from -12 h to 12 h."""
    return np.asarray((seconds + 0.5 * _DAY_S) % _DAY_S - 0.5 * _DAY_S, np.float64)


def _placed(matches: Sequence[Match]) -> Iterator[Match]:
    return (match for match in matches if match.placement is not None)


def _refuse_overlaps(matches: Sequence[Match], clock: CommonClock | None) -> None:
    """Leave one of two clips that claim the same time: a camera records one at a time."""
    by_trust = sorted(_placed(matches), key=lambda match: (match.again, -_trust(match, clock)))
    kept: list[Match] = []
    for match in by_trust:
        other = next((one for one in kept if _overlap(match, one)), None)
        if other is None:
            kept.append(match)
        else:
            match.refuse(f"its place is that of {other.clip.name}, which fits as well or better")


def _trust(match: Match, clock: CommonClock | None) -> float:
    assert match.placement is not None  # noqa: S101  # the caller chose placed ones
    off = _off_clock_s(match, clock)
    contradicted = off is not None and clock is not None and abs(off) > clock.window_s
    return match.placement.correlation - float(contradicted)


def _overlap(one: Match, other: Match) -> bool:
    return one.start_ns < other.stop_ns - _TOUCH_NS and other.start_ns < one.stop_ns - _TOUCH_NS


def _off_clock_s(match: Match, clock: CommonClock | None) -> float | None:
    if clock is None or match.clip.clock_s is None or match.placement is None:
        return None
    return float(clock.away_s(match.clip.clock_s, np.array([match.start_ns]))[0])


def _note_clocks(matches: Sequence[Match], clock: CommonClock | None) -> None:
    for match in _placed(matches):
        off = _off_clock_s(match, clock)
        if off is not None and clock is not None and abs(off) > clock.window_s:
            match.doubts.append(
                f"by the camera's clock, {_known_by(clock)}, it should be "
                f"{abs(off):.1f} s {'later' if off > 0 else 'earlier'}"
            )


def _known_by(clock: CommonClock) -> str:
    return f"which {clock.clips} clips agree on" if clock.clips else "as far as it is known"


def _note_order(matches: Sequence[Match]) -> None:
    """Doubt the clips that come in another order than the camera counted them."""
    placed = sorted(
        (match for match in _placed(matches) if match.clip.number is not None),
        key=lambda match: match.start_ns,
    )
    numbers = [match.clip.number for match in placed]
    for index in set(range(len(placed))) - _longest_rise([n for n in numbers if n is not None]):
        placed[index].doubts.append("it comes out of the order in which the camera counted")


def _longest_rise(numbers: Sequence[tuple[int, int]]) -> set[int]:
    """Return the indices of a longest rising part."""
    length = [1] * len(numbers)
    before = [-1] * len(numbers)
    for i, number in enumerate(numbers):
        for j in range(i):
            if numbers[j] < number and length[j] + 1 > length[i]:
                length[i], before[i] = length[j] + 1, j
    at = max(range(len(numbers)), key=length.__getitem__, default=-1)
    chosen = set()
    while at >= 0:
        chosen.add(at)
        at = before[at]
    return chosen
