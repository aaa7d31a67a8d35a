"""What a dataset or an episode is, at a glance: from the catalog or the metadata, no data read."""

from collections import Counter
from dataclasses import dataclass
from typing import Any

from exumi_data.dataset import Dataset
from exumi_data.episode import Episode
from exumi_data.model.documents import dump

__all__ = ["DatasetSummary", "EpisodeSummary", "StreamRow", "summarize"]


@dataclass(frozen=True, slots=True)
class StreamRow:
    """A stream over all episodes of a dataset that have it.

    Attributes
    ----------
    name, kind : str
    encodings : list of str
    episodes, n : int
        Episodes that have it, and samples in all of them.
    """

    name: str
    kind: str
    encodings: list[str]
    episodes: int
    n: int


@dataclass(frozen=True, slots=True, kw_only=True)
class DatasetSummary:
    """A dataset at a glance, from ``dataset.json`` and the catalog.

    Attributes
    ----------
    path : str
    metadata : dict
        ``dataset.json`` as it is.
    episodes, bytes : int
    duration_s : float
        Recorded time of all episodes.
    packed : int
        Episodes that are one ``.zarr.zip``.
    regimes, tasks, objects, parts, licences, quality : dict of str to int
        Values and numbers of episodes, most frequent first; those that do not say are left out.
    labels : dict of str to int
        Labelled properties, and how many episodes have each.
    streams : list of StreamRow
    fingerprint : str
        Digest of the content: two copies with the same fingerprint hold the same episodes.
    """

    path: str
    metadata: dict[str, Any]
    episodes: int
    bytes: int
    duration_s: float
    packed: int
    regimes: dict[str, int]
    tasks: dict[str, int]
    objects: dict[str, int]
    parts: dict[str, int]
    licences: dict[str, int]
    quality: dict[str, int]
    labels: dict[str, int]
    streams: list[StreamRow]
    fingerprint: str


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeSummary:
    """An episode at a glance, from its metadata.

    Attributes
    ----------
    path : str
    packed : bool
        Whether it is one ``.zarr.zip``.
    bytes : int
        Size on disk.
    samples : dict of str to int
        Samples of each stream.
    metadata : dict
        The episode's metadata as it is.
    derived : dict or None
        What is known of the derived arrays, by ``<stream>/<name>``.
    """

    path: str
    packed: bool
    bytes: int
    samples: dict[str, int]
    metadata: dict[str, Any]
    derived: dict[str, Any] | None


def summarize(source: Dataset | Episode) -> DatasetSummary | EpisodeSummary:
    """Summarize a dataset or an episode.

    Parameters
    ----------
    source : Dataset or Episode

    Returns
    -------
    DatasetSummary or EpisodeSummary

    Raises
    ------
    DamagedDataError
        A stream of the episode has no readable ``time``.
    """
    return _episode(source) if isinstance(source, Episode) else _dataset(source)


def _episode(episode: Episode) -> EpisodeSummary:
    store = episode.store
    derived = episode.derived
    return EpisodeSummary(
        path=episode.path,
        packed=store.is_packed,
        bytes=sum(store.size(path) for path in store.paths()),
        samples={name: len(stream) for name, stream in episode.streams.items()},
        metadata=dump(episode.metadata),
        derived=dump(derived)["items"] if derived else None,
    )


def _count(values: list[str | None]) -> dict[str, int]:
    counter = Counter(value for value in values if value is not None)
    return dict(sorted(counter.items(), key=lambda item: (-item[1], item[0])))


def _dataset(dataset: Dataset) -> DatasetSummary:
    table = dataset.catalog

    def column(name: str) -> list[Any]:
        return list(table.column(name).to_pylist())

    properties = [{label["property"] for label in row} for row in column("labels")]
    return DatasetSummary(
        path=dataset.path,
        metadata=dump(dataset.metadata),
        episodes=len(dataset),
        bytes=sum(column("bytes")),
        duration_s=sum(column("duration_s")),
        packed=sum(path.endswith(".zip") for path in column("path")),
        regimes=_count(column("regime")),
        tasks=_count(column("task")),
        objects=_count(column("object_id")),
        parts=_count(column("part_id")),
        licences=_count(column("licence")),
        quality=_count([code for row in column("quality") for code in sorted(set(row))]),
        labels=_count([name for row in properties for name in sorted(row)]),
        streams=_streams(column("streams")),
        fingerprint=dataset.fingerprint,
    )


def _streams(rows: list[list[dict[str, Any]]]) -> list[StreamRow]:
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in rows:
        for stream in row:
            groups.setdefault((stream["kind"], stream["name"]), []).append(stream)
    order = sorted(groups, key=lambda key: (key[0] != "tactile", key[0] != "rgb", *key))
    return [
        StreamRow(
            name,
            kind,
            sorted({s["encoding"] for s in groups[kind, name] if s["encoding"]}),
            len(groups[kind, name]),
            sum(s["n"] for s in groups[kind, name]),
        )
        for kind, name in order
    ]
