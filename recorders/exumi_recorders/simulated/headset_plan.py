"""All datagrams of a simulated headset, and when each is sent."""

from dataclasses import dataclass, replace

import numpy as np

from exumi_data.simulation import Truth
from exumi_recorders.simulated.headset_messages import frame_message, poses_message
from exumi_recorders.simulated.headset_options import HeadsetOptions
from exumi_recorders.simulated.headset_poses import Tracked, track

__all__ = ["Planned", "plan"]

S_NS = 1_000_000_000
_STALLED = 3
_FRAME_AGAIN_NS = S_NS


@dataclass(frozen=True, slots=True)
class Planned:
    """A datagram to be sent.

    Attributes
    ----------
    send_ns : int
        When, since the epoch.
    data : bytes
    index : int
        Which of the display's frames it belongs to.
    pose_ns : int or None
        Of which time its poses are, since the epoch; None of a datagram without.
    """

    send_ns: int
    data: bytes
    index: int
    pose_ns: int | None = None


def plan(options: HeadsetOptions, truth: Truth) -> list[Planned]:
    """Return all datagrams in the order in which they are sent; echoes are not among them.

    The same options and truth give the same datagrams.

    Parameters
    ----------
    options : HeadsetOptions
    truth : Truth
        What the hand does.
    """
    count = int(options.duration_s * options.rate_hz)
    frames_ns = np.arange(count, dtype=np.int64) * S_NS // options.rate_hz
    tracked = track(options, truth, frames_ns / S_NS)
    sent = [
        planned
        for index, time_ns in enumerate(frames_ns.tolist())
        for planned in _frame(options, tracked, index, time_ns)
    ]
    return _on_the_way(options, sent)


def _frame(options: HeadsetOptions, tracked: Tracked, index: int, time_ns: int) -> list[Planned]:
    """Return what one display loop of the app sends."""
    comma = options.faults.decimal_comma
    pressed = sum(at_s * S_NS <= time_ns for at_s in options.toggles_s)
    flag = pressed % 2 == 1
    pose_ns = time_ns - round(options.lag_s * S_NS)
    message = poses_message(
        options.dialect,
        flag=flag,
        side=options.hand,
        hands=_hands(options, tracked, index),
        head=tracked.head[index],
        sequence=index,
        time_device_ns=options.device_time_ns(pose_ns),
        decimal_comma=comma,
    )
    found = [Planned(time_ns, message.encode("ascii"), index, pose_ns)]
    if _sends_frame(options, index, time_ns):
        frame = frame_message(options.dialect, options.world_frame, decimal_comma=comma)
        found.insert(0, Planned(time_ns, frame.encode("ascii"), index))
    if options.dialect == "a":
        found += _arcap_command(options, tracked, index, time_ns, flag=flag)
    return found


def _hands(options: HeadsetOptions, tracked: Tracked, index: int) -> list[np.ndarray]:
    if options.hand != "both":
        return [tracked.hand[index]]
    return [tracked.other[index], tracked.hand[index]]


def _sends_frame(options: HeadsetOptions, index: int, time_ns: int) -> bool:
    """Whether the world frame goes out now: once, and again every second in dialect d."""
    if options.world_frame_at_s is None:
        return False
    period_ns = S_NS // options.rate_hz
    since_ns = time_ns - round(options.world_frame_at_s * S_NS)
    if options.dialect != "d" or since_ns < 0:
        return 0 <= since_ns < period_ns or (index == 0 and since_ns > 0)
    return since_ns % _FRAME_AGAIN_NS < period_ns


def _arcap_command(
    options: HeadsetOptions, tracked: Tracked, index: int, time_ns: int, *, flag: bool
) -> list[Planned]:
    """``Start`` when recording begins, ``Stop`` again and again while there is none."""
    before_ns = (index - 1) * S_NS // options.rate_hz
    began = any(before_ns < at_s * S_NS <= time_ns for at_s in options.toggles_s)
    if flag and not began:
        return []
    text = "Stop"
    if flag:
        comma = options.faults.decimal_comma
        text = "Start:" + frame_message("b", tracked.head[index], decimal_comma=comma)[len("WF,") :]
    return [Planned(time_ns, text.encode("ascii"), index)]


def _on_the_way(options: HeadsetOptions, sent: list[Planned]) -> list[Planned]:
    """Put datagrams through a bad network, which spares world frames and commands."""
    faults, period_ns = options.faults, S_NS // options.rate_hz
    rng = np.random.default_rng((options.seed, 2))
    chances = rng.random((len(sent), 3))
    delays = rng.integers(1, _STALLED + 1, (len(sent), 2))
    found = []
    for planned, (lost, late, twice), (by, again) in zip(sent, chances, delays, strict=True):
        if planned.pose_ns is None:
            found.append(planned)
            continue
        if lost < faults.lost:
            continue
        if late < faults.late:
            found.append(_delayed(planned, int(by) * period_ns + period_ns // 2))
        else:
            found.append(planned)
        if twice < faults.twice:
            found.append(_delayed(found[-1], (int(again) - 1) * period_ns + 1_000_000))
    if faults.burst_s:
        burst_ns = round(faults.burst_s * S_NS)
        found = [_delayed(each, -each.send_ns % burst_ns) for each in found]
    return sorted(found, key=lambda planned: planned.send_ns)


def _delayed(planned: Planned, by_ns: int) -> Planned:
    return replace(planned, send_ns=planned.send_ns + by_ns)
