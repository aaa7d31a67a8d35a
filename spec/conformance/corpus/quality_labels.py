"""Cases of signal quality: labels."""

from collections.abc import Iterator

from corpus.case import Case

__all__ = ["labels_cases"]


def labels_cases() -> Iterator[Case]:
    """Return the cases."""
    yield from ()
