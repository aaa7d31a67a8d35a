"""The hub's own clock: whether its date can be believed, and whether NTP keeps it right."""

import ctypes
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from exumi_data.calibration_items import moment_of
from exumi_data.model.description import CalibrationItem
from exumi_recorders.rig.gate import Gate

__all__ = ["ClockState", "clock_gates", "read_clock_state"]

# No recorder of this kind ran before. A board without a clock of its own begins in 1970, or where
# it was switched off.
_FIRST = datetime(2025, 1, 1, tzinfo=UTC)
_AHEAD = timedelta(minutes=10)
_UNSYNCHRONISED = 0x0040  # STA_UNSYNC
_FIX = "Connect the hub to a network with a time server, or set its clock: sudo date -s ..."


@dataclass(frozen=True, slots=True)
class ClockState:
    """What the kernel knows of the clock.

    Attributes
    ----------
    is_synchronised : bool
        Whether a time server, or GPS, keeps it right.
    most_error_s : float
        How far off it may be, by the kernel's own estimate.
    """

    is_synchronised: bool
    most_error_s: float


class _Timex(ctypes.Structure):
    """``struct timex`` of Linux, up to what is needed; the rest is room for the kernel to write."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("frequency", ctypes.c_long),
        ("max_error_us", ctypes.c_long),
        ("estimated_error_us", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_char * 256),
    )


def read_clock_state() -> ClockState | None:
    """Ask the kernel; None where it does not say."""
    if not sys.platform.startswith("linux"):
        return None
    timex = _Timex()  # no modes: nothing is set
    try:
        if ctypes.CDLL(None).adjtimex(ctypes.byref(timex)) < 0:
            return None
    except (OSError, AttributeError):
        return None
    return ClockState(not timex.status & _UNSYNCHRONISED, timex.max_error_us / 1e6)


def clock_gates(
    now: datetime, state: ClockState | None, items: Iterable[CalibrationItem]
) -> list[Gate]:
    """Judge the clock that says when an episode began.

    Parameters
    ----------
    now : datetime
        UTC, as the hub has it.
    state : ClockState, optional
    items : iterable of CalibrationItem
        None of them can be of tomorrow.
    """
    times = [moment for moment in map(moment_of, items) if moment is not None]
    first = max(_FIRST, max([_FIRST, *times]) - _AHEAD)
    found = now.strftime("%Y-%m-%d %H:%M UTC")
    if now < first:
        expected = f"after {first:%Y-%m-%d %H:%M}"
        date = Gate("clock", "", "fail", found, expected, _FIX)
    else:
        date = Gate("clock", "", "pass", found, "a date that can be")
    expected = "kept by a time server"
    if state is None:
        sync = Gate("clock_sync", "", "skipped", "the system does not say", expected)
    elif state.is_synchronised:
        found = f"within {1e3 * state.most_error_s:.0f} ms"
        sync = Gate("clock_sync", "", "pass", found, expected)
    else:
        fix = f"{_FIX} Times within an episode do not depend on it; dates and other devices do."
        sync = Gate("clock_sync", "", "warn", "not synchronised", expected, fix)
    return [date, sync]
