"""Cases of signal quality: sync."""

from collections.abc import Iterator

from corpus.case import Case

__all__ = ["sync_cases"]


def sync_cases() -> Iterator[Case]:
    """Return the cases."""
    yield from ()
