"""Cases of signal quality: motion."""

from collections.abc import Iterator

from corpus.case import Case

__all__ = ["motion_cases"]


def motion_cases() -> Iterator[Case]:
    """Return the cases."""
    yield from ()
