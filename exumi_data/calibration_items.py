"""What every procedure gives: an item, what was found on the way, and why it is refused."""

from datetime import UTC, datetime

from exumi_data.errors import ExumiError
from exumi_data.model.description import CalibrationItem

__all__ = ["LATENCY", "REFUSED_FIX", "CalibrationRefusedError", "moment_of", "now"]

LATENCY = "latency/"
"""A calibration item of this name and a stream's is its latency, in ns."""
REFUSED_FIX = "Record it again; nothing was written."


class CalibrationRefusedError(ExumiError):
    """The readings do not tell what they should: no item is made of them."""


def now() -> str:
    """Return the time of now, UTC, as calibration items state it."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def moment_of(item: CalibrationItem) -> datetime | None:
    """Return when an item was calibrated; None where it says nothing, or a day that cannot be.

    Parameters
    ----------
    item : CalibrationItem
    """
    if item.time is None:
        return None
    day_and_minute, second = item.time[:17], min(int(item.time[17:19]), 59)  # a leap second
    try:
        return datetime.fromisoformat(f"{day_and_minute}{second:02d}+00:00")
    except ValueError:
        return None
