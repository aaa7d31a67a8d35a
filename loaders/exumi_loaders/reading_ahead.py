"""The bytes of a batch, brought near before it is decoded: together, and while others are decoded.

On a local disk there is nothing to do.
"""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from exumi_data.errors import ExumiError, UnreachableError
from exumi_loaders.readers import FrameReaders

if TYPE_CHECKING:
    from exumi_data.store.remote.reading import Span

__all__ = ["parts_at_hand"]

_MOST_ROWS = 32
_SHARE = 3  # of the memory for blocks: two parts are there at once


def parts_at_hand(
    readers: FrameReaders, episodes: np.ndarray, wanted: Mapping[str, np.ndarray]
) -> Iterator[slice | np.ndarray]:
    """Yield which rows of a batch to read next; their bytes are at hand, or nearly so.

    Parameters
    ----------
    readers : FrameReaders
    episodes : (B,) int
        Of each row.
    wanted : mapping of str to (B, K) int
        Of each image stream the frames of each row; -1 is none.

    Yields
    ------
    slice or (R,) int64
        Together all rows, each once.

    Raises
    ------
    UnreachableError
        A server does not answer or does not let us in. What is wrong with one episode is said when
        it is read.
    """
    if not readers.is_remote:
        yield slice(None)
        return
    from exumi_data.store.remote.reading import reader

    readers.open_together(episodes, wanted)
    spans = [
        _spans(readers, episode, {name: frames[row] for name, frames in wanted.items()})
        for row, episode in enumerate(episodes.tolist())
    ]
    parts = _parts(episodes, spans, reader().memory_bytes // _SHARE)
    coming = None
    for number, part in enumerate(parts):
        if coming is None:
            coming = reader().prefetch_later(span for row in part for span in spans[row])
        _raise_unreachable(coming.result())
        coming = None
        if number + 1 < len(parts):
            following = parts[number + 1]
            coming = reader().prefetch_later(span for row in following for span in spans[row])
        yield np.array(part, dtype=np.int64)


def _spans(readers: FrameReaders, episode: int, wanted: Mapping[str, np.ndarray]) -> "list[Span]":
    """Return where the frames of one row are."""
    found = []
    for name, frames in wanted.items():
        there = np.unique(frames[frames >= 0]).tolist()
        if not there:
            continue
        try:
            source, _ = readers.get(episode, name)
            store = source.store
            found += [store.span(*range_) for range_ in source.ranges(there)]  # type: ignore[attr-defined]  # a remote one
        except UnreachableError:
            raise
        except (ExumiError, IndexError, FileNotFoundError):
            continue  # said when this row is read
    return found


def _parts(episodes: np.ndarray, spans: "list[list[Span]]", most: int) -> list[list[int]]:
    """Divide rows into parts of so many bytes; those of one episode stay together."""
    from exumi_data.store.remote.reading import bytes_of

    parts: list[list[int]] = []
    size = 0
    for row in np.argsort(episodes, kind="stable").tolist():
        length = bytes_of(spans[row])
        if not parts or len(parts[-1]) == _MOST_ROWS or size + length > most:
            parts.append([])
            size = 0
        parts[-1].append(row)
        size += length
    return parts


def _raise_unreachable(errors: list[Exception]) -> None:
    for error in errors:
        if isinstance(error, UnreachableError):
            raise error
