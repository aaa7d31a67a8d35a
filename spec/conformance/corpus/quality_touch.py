"""Cases of signal quality: touch."""

from collections.abc import Iterator

from corpus.case import Case

__all__ = ["touch_cases"]


def touch_cases() -> Iterator[Case]:
    """Return the cases."""
    yield from ()
