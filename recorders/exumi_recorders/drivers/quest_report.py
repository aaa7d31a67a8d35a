"""What an operator is told about a headset."""

from exumi_recorders.drivers.quest_stream import QuestStream

__all__ = ["Reading", "problems_of", "readings_of"]

Reading = float | int | str | bool

_S_NS = 1_000_000_000
_SILENT_NS = _S_NS
_RECENT_NS = 5 * _S_NS
_FROZEN_S = 0.5
_REJECTED = {
    "decimal_comma": "The app writes numbers with a decimal comma: set the headset's language to "
    "English.",
    "sender": "More than one headset sends: only one is recorded.",
    "hand": "Poses come of another hand than that which is recorded: see the option `hand`.",
    "dialect": "Messages come of another dialect than that which is recorded: end the other app.",
}
_HARMLESS = {"twice", "trip"}


def readings_of(stream: QuestStream, now_ns: int) -> dict[str, Reading]:
    """Return what the operator may want to see.

    Parameters
    ----------
    stream : QuestStream
    now_ns : int
        CLOCK_MONOTONIC.
    """
    found: dict[str, Reading] = {
        "dialect": " or ".join(stream.dialects) or "unknown",
        "rate_hz": round(stream.rate.rate_hz(now_ns), 1),
        "received": stream.rate.count,
        "rejected": stream.rejected.total(),
        "world_frame": "world_frame" in stream.frames,
        "record_flag": stream.flag.on,
        "jumps": sum(watch.jumps for watch in stream.watches.values()),
        "late": stream.sequence.late,
        "restarts": stream.sequence.restarts,
    }
    if stream.sender.address is not None:
        found["sender"] = stream.sender.address
    if stream.rate.last_ns is not None:
        found["age_s"] = round((now_ns - stream.rate.last_ns) / _S_NS, 3)
    if stream.from_headset_m is not None:
        found["from_headset_m"] = round(stream.from_headset_m, 3)
    return found | stream.clock.readings(now_ns)


def problems_of(stream: QuestStream, opened_ns: int, now_ns: int) -> list[str]:
    """Return what the operator has to mend.

    Parameters
    ----------
    stream : QuestStream
    opened_ns : int
        CLOCK_MONOTONIC when the device was opened.
    now_ns : int
    """
    found = []
    last_ns = opened_ns if stream.rate.last_ns is None else stream.rate.last_ns
    if now_ns - last_ns > _SILENT_NS:
        found.append(
            f"No pose has come for {(now_ns - last_ns) / _S_NS:.0f} s: is the app running, is the "
            "headset worn, and does it send to this hub?"
        )
    elif stream.rate.count and "world_frame" not in stream.frames:
        found.append("The world frame has not come: set it in the app.")
    return found + _pose_problems(stream) + _rejection_problems(stream, now_ns)


def _pose_problems(stream: QuestStream) -> list[str]:
    found = []
    for name, watch in stream.watches.items():
        if watch.frozen_s > _FROZEN_S:
            found.append(
                f"{name} has been the same for {watch.frozen_s:.1f} s: is the controller awake, "
                "and in view of the headset?"
            )
        if watch.shifted_m > stream.options.jump_m:
            found.append(
                f"{name} has jumped by {watch.shifted_m:.2f} m: if the headset was recentred, set "
                "the world frame again."
            )
    distance_m, range_m = stream.from_headset_m, stream.options.range_m
    if distance_m is not None and distance_m > range_m:
        found.append(
            f"A controller is {distance_m:.1f} m from the headset: stay within {range_m:g} m."
        )
    return found


def _rejection_problems(stream: QuestStream, now_ns: int) -> list[str]:
    recent = {why for why, at_ns in stream.rejected_ns.items() if now_ns - at_ns < _RECENT_NS}
    found = [text for why, text in _REJECTED.items() if why in recent]
    broken = recent - _REJECTED.keys() - _HARMLESS
    if broken:
        found.append(f"Datagrams are refused: {', '.join(sorted(broken))}.")
    return found
