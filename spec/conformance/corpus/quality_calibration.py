"""Cases of signal quality: calibration."""

from collections.abc import Iterator

from corpus.case import Case

__all__ = ["calibration_cases"]


def calibration_cases() -> Iterator[Case]:
    """Return the cases."""
    yield from ()
