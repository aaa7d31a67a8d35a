"""What every procedure gives: an item, what was found on the way, and why it is refused."""

from datetime import UTC, datetime

from exumi_data.errors import ExumiError

__all__ = ["LATENCY", "REFUSED_FIX", "CalibrationRefusedError", "now"]

LATENCY = "latency/"
"""A calibration item of this name and a stream's is its latency, in ns."""
REFUSED_FIX = "Record it again; nothing was written."


class CalibrationRefusedError(ExumiError):
    """The readings do not tell what they should: no item is made of them."""


def now() -> str:
    """Return the time of now, UTC, as calibration items state it."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
