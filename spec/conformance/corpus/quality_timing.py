"""Cases of signal quality: timing."""

from collections.abc import Iterator

from corpus.case import Case

__all__ = ["timing_cases"]


def timing_cases() -> Iterator[Case]:
    """Return the cases."""
    yield from ()
