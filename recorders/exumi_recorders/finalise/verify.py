"""Reads back what was written, before the journal that it was made from is dropped."""

from collections.abc import Mapping
from pathlib import Path

from exumi_data.episode import Episode, StreamView
from exumi_data.errors import DamagedDataError
from exumi_data.store.access import open_store
from exumi_data.store.shards import open_array

__all__ = ["verify"]

_PIECE = 4 << 20


def verify(path: Path, counts: Mapping[str, int]) -> None:
    """Read every byte of an episode's streams, against its checksums and the number of samples.

    Parameters
    ----------
    path : pathlib.Path
        The episode, perhaps under its temporary name.
    counts : mapping of str to int
        Samples that each stream should have; one that should have none is not there.

    Raises
    ------
    ExumiError
        Something is not as it was written.
    """
    with Episode(open_store(path)) as episode:
        episode.check_complete()
        expected = {name: count for name, count in counts.items() if count}
        found = {name: len(stream) for name, stream in episode.streams.items()}
        if found != expected:
            raise DamagedDataError(f"has {found} samples, expected {expected}", where=path)
        for stream in episode.streams.values():
            _read(episode, stream)


def _read(episode: Episode, stream: StreamView) -> None:
    for name in stream.metadata.arrays:
        if stream.is_image and name == "data":
            for index in range(len(stream)):
                stream.encoded(index)
            continue
        array = open_array(episode.store, f"streams/{stream.name}/{name}")
        rows = max(1, _PIECE // max(1, array.document.row_bytes))
        for start in range(0, array.shape[0], rows):
            array.rows(start, min(start + rows, array.shape[0]))
