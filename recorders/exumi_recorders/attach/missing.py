"""Stretches of a session in which a hand was at work, and of which there is no clip."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from exumi_data.synchronisation.matching import Match
from exumi_data.synchronisation.motion import Turning

__all__ = ["Uncovered", "skipped_numbers", "uncovered"]

_SHARE_OF_CLIP = 0.6
_SHARE_OF_MOTION = 0.5
_LEAST_PAUSES = 3


@dataclass(frozen=True, slots=True)
class Uncovered:
    """A stretch without a clip.

    Attributes
    ----------
    start_s, stop_s : float
        Seconds of the session.
    """

    start_s: float
    stop_s: float


def uncovered(session: Turning, matches: Sequence[Match]) -> list[Uncovered]:
    """Find stretches that look as if a clip of them were missing.

    They are longer than what usually lies between two clips, by a short clip at least, and the hand
    turns in them about as much as it does in the clips.

    Parameters
    ----------
    session : Turning
    matches : sequence of Match
    """
    placed = sorted(
        (match for match in matches if match.placement is not None), key=lambda one: one.start_ns
    )
    if not placed or not len(session.time_ns):
        return []
    spans = [(match.start_ns, match.stop_ns) for match in placed]
    usual = float(np.median([stop - start for start, stop in spans]))
    motion = float(np.median([_motion(session, start, stop) for start, stop in spans]))
    first, last = int(session.time_ns[0]), int(session.time_ns[-1])
    edges = [first, *(edge for span in spans for edge in span), last]
    stretches = list(zip(edges[::2], edges[1::2], strict=True))
    between = [max(0, stop - start) for start, stop in stretches[1:-1]]
    pause = float(np.median(between)) if len(between) >= _LEAST_PAUSES else 0.0
    found = []
    for start, stop in stretches:
        if stop - start < pause + _SHARE_OF_CLIP * usual:
            continue
        if (
            _busiest(session, start, stop, round(_SHARE_OF_CLIP * usual))
            >= _SHARE_OF_MOTION * motion
        ):
            found.append(Uncovered(start * 1e-9, stop * 1e-9))
    return found


def _motion(session: Turning, start_ns: int, stop_ns: int) -> float:
    part = session.between(start_ns, stop_ns)
    return float(part.rad_per_s.mean()) if len(part.time_ns) else 0.0


def _busiest(session: Turning, start_ns: int, stop_ns: int, length_ns: int) -> float:
    """Return the mean motion of the liveliest part of this length."""
    step = max(1, length_ns // 4)
    starts = range(start_ns, max(stop_ns - length_ns, start_ns) + 1, step)
    return max(_motion(session, at, at + length_ns) for at in starts)


def skipped_numbers(matches: Sequence[Match]) -> list[int]:
    """Return recordings that the camera counted, between those that are here, and are not here.

    Parameters
    ----------
    matches : sequence of Match
    """
    placed = [m.clip.number[0] for m in matches if m.placement is not None and m.clip.number]
    present = {m.clip.number[0] for m in matches if m.clip.number}
    if not placed or max(placed) - min(placed) > 2 * len(placed) + 10:
        return []  # the count began anew, or other files lay between
    return [number for number in range(min(placed), max(placed)) if number not in present]
