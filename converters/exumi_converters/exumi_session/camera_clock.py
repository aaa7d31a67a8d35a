"""Which time zone the camera's clock shows: stated, or that in which its clips fit the hub's time.

The clock and time zone of the machine that converts have no part in it.
"""

import re
from collections.abc import Sequence
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from exumi_data.errors import UsageError
from exumi_data.synchronisation.matching import CommonClock

__all__ = ["camera_clock", "infer_zone_s", "stated_zone_s", "zone_name"]

_DAY_S = 86_400
_STEP_S = 900
_EAST_S, _WEST_S = 14 * 3600, -12 * 3600
_OFFSET = re.compile(r"(?:UTC|GMT)?([+-])(\d{1,2}):?(\d\d)?")
# How far clocks that somebody set are off.
_OFF_S = 90.0
_SCATTER_S = _OFF_S / 5.0


def stated_zone_s(text: str, unix_s: float) -> int:
    """Return what a stated time zone is ahead of UTC, seconds.

    Parameters
    ----------
    text : str
        ``UTC``, an offset such as ``+08:00``, or a name such as ``Asia/Shanghai``.
    unix_s : float
        When: names have summer time.

    Raises
    ------
    UsageError
        It is no time zone.
    """
    from datetime import UTC, datetime

    if text.upper() in {"UTC", "GMT", "Z"}:
        return 0
    match = _OFFSET.fullmatch(text)
    if match is not None:
        seconds = 3600 * int(match[2]) + 60 * int(match[3] or 0)
        if seconds <= _EAST_S:
            return seconds if match[1] == "+" else -seconds
    try:
        offset = datetime.fromtimestamp(unix_s, UTC).astimezone(ZoneInfo(text)).utcoffset()
    except (ZoneInfoNotFoundError, ValueError, OSError):
        offset = None
    if offset is None:
        raise UsageError(
            f"Invalid timezone ({text})",
            fix="Give an offset such as +08:00, UTC, or a name such as Asia/Shanghai.",
        )
    return round(offset.total_seconds())


def infer_zone_s(clips: Sequence[tuple[float, float]], span_s: tuple[float, float]) -> int | None:
    """Find the time zone in which all clips fall into the hub's recording.

    Parameters
    ----------
    clips : sequence of (float, float)
        When each began by the camera's clock, seconds of the day, and its duration.
    span_s : (float, float)
        Unix times of the hub's first and last reading.

    Returns
    -------
    int or None
        Seconds ahead of UTC; None where no time zone or more than one will do.
    """
    if not clips:
        return None
    fitting = [
        zone
        for zone in range(_WEST_S, _EAST_S + 1, _STEP_S)
        if all(_fits(clock - zone, length, span_s) for clock, length in clips)
    ]
    # Half and quarter hours are rare: whole hours come first where both would do.
    whole = [zone for zone in fitting if zone % 3600 == 0]
    for zones in (whole, fitting):
        if len({zone % _DAY_S for zone in zones}) == 1:
            return zones[0]
        if zones:
            return None
    return None


def _fits(utc_of_day_s: float, length_s: float, span_s: tuple[float, float]) -> bool:
    """Whether a clip can lie within a span, on any day, with a clock that is somewhat off."""
    first, last = span_s[0] - _OFF_S, span_s[1] + _OFF_S
    after = (utc_of_day_s - first) % _DAY_S
    return after + length_s <= last - first


def camera_clock(zone_s: int, epoch_s: float) -> CommonClock:
    """Return what a time zone says of the camera's clock, against the session's time.

    Parameters
    ----------
    zone_s : int
    epoch_s : float
        Unix time of the session's second 0.
    """
    return CommonClock((epoch_s + zone_s) % _DAY_S, _SCATTER_S, 0)


def zone_name(zone_s: int) -> str:
    """Return a time zone as ``UTC+08:00``."""
    minutes = abs(zone_s) // 60
    return f"UTC{'-' if zone_s < 0 else '+'}{minutes // 60:02d}:{minutes % 60:02d}"


def off_zone_s(ahead_s: float, epoch_s: float) -> tuple[int, float]:
    """Return the time zone that a clock is in by what it is ahead, and what it is off in it.

    Parameters
    ----------
    ahead_s : float
        Of the session's time, modulo a day.
    epoch_s : float
        Unix time of the session's second 0.
    """
    ahead = (ahead_s - epoch_s + _DAY_S / 2) % _DAY_S - _DAY_S / 2
    zone = round(ahead / _STEP_S) * _STEP_S
    return zone, ahead - zone
