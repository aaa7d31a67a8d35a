"""A replay buffer: arrays of one length in a folder or a zip, and where each episode ends."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from exumi_converters.zarr2_files.chunks import Chunks
from exumi_converters.zarr2_files.documents import EPISODE_ENDS, Documents, open_documents
from exumi_converters.zarr2_files.metadata import MAX_ROWS, ArrayMeta
from exumi_converters.zarr2_files.rows import Rows
from exumi_data.errors import ExumiError, LimitError, MissingExtraError, SourceError

__all__ = ["Buffer", "EpisodeRows", "open_buffer"]

_MAX_EPISODES = 100_000
_MAX_NAME = 200


class EpisodeRows(NamedTuple):
    """Which rows are an episode.

    Attributes
    ----------
    start, stop : int
    fault : str or None
        Why it cannot be converted.
    """

    start: int
    stop: int
    fault: str | None


@dataclass(frozen=True, slots=True)
class Buffer:
    """A replay buffer.

    Attributes
    ----------
    path : pathlib.Path
    arrays : dict of str to ArrayMeta
        Those of ``data`` that can be read, by name, in order.
    refused : dict of str to str
        Those that cannot, with the reason.
    ends : (E,) int64
        One past the last row of each episode.
    attributes : dict
        The root's ``.zattrs``.
    """

    path: Path
    arrays: dict[str, ArrayMeta]
    refused: dict[str, str]
    ends: np.ndarray
    attributes: dict[str, Any]
    _chunks: dict[str, Chunks] = field(repr=False)

    def episodes(self, arrays: Sequence[str]) -> Iterator[EpisodeRows]:
        """Yield the rows of each episode.

        Parameters
        ----------
        arrays : sequence of str
            Names of those that are read.
        """
        shortest = min(arrays, key=lambda name: self.arrays[name].shape[0])
        count = self.arrays[shortest].shape[0]
        start = highest = 0
        for stop in self.ends.tolist():
            fault = None
            if start < 0 or stop <= start:
                fault = f"{EPISODE_ENDS} gives it rows {start} to {stop}"
            elif start < highest:
                fault = (
                    f"{EPISODE_ENDS} gives it rows {start} to {stop}, but an episode before it "
                    f"ends at {highest}"
                )
            elif stop > count:
                fault = f"data/{shortest} has {count} rows, this episode is rows {start} to {stop}"
            yield EpisodeRows(start, stop, fault)
            start, highest = stop, max(highest, stop)

    def rows(self, name: str, start: int, stop: int) -> Rows:
        """Return some rows of an array."""
        meta = self.arrays[name]
        first, last = start // meta.chunks[0], max(start, stop - 1) // meta.chunks[0]
        return Rows(meta, start, stop, self._chunks[name].part(first, last))


def open_buffer(path: Path) -> Buffer:
    """Open a replay buffer: a folder or a zip, whatever it is called. No frame is read.

    Raises
    ------
    SourceError
        It is none, or damaged.
    UnsupportedError, LimitError
        It cannot be read safely.
    MissingExtraError
        imagecodecs is not installed.
    """
    store = open_documents(path)
    names = store.arrays()
    arrays: dict[str, ArrayMeta] = {}
    refused: dict[str, str] = {}
    for name in sorted(names):
        if not name.isprintable() or name != name.strip() or len(name) > _MAX_NAME:
            refused[ascii(name[:_MAX_NAME])] = "its name is no plain text"
            continue
        try:
            arrays[name] = store.meta(f"data/{name}")
        except MissingExtraError:
            raise
        except ExumiError as error:
            refused[name] = error.reason
    ends = _read_ends(store)
    chunks = {name: store.chunks(meta) for name, meta in arrays.items()}
    return Buffer(path, arrays, refused, ends, store.attributes(), chunks)


def _read_ends(store: Documents) -> np.ndarray:
    meta = store.meta(EPISODE_ENDS)
    where = f"{store.path}: {EPISODE_ENDS}"
    if len(meta.shape) != 1 or meta.dtype.kind not in "iu":
        raise SourceError(
            f"it is {meta.shape} {meta.dtype}, expected one whole number an episode", where=where
        )
    if not meta.shape[0]:
        raise SourceError("there is no episode", where=where)
    if meta.shape[0] > _MAX_EPISODES:
        raise LimitError(
            f"{meta.shape[0]:,} episodes; up to {_MAX_EPISODES:,} of one buffer are converted",
            where=where,
            fix="Write them into several buffers.",
        )
    ends = Rows(meta, 0, meta.shape[0], store.chunks(meta)).read()
    if (ends > MAX_ROWS).any():
        raise SourceError("an end is no row", where=where)
    return ends.astype(np.int64)
