"""A dataset: a folder of episodes with a catalog."""

import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, SupportsIndex, overload

from exumi_data.episode import Episode, open_episode
from exumi_data.errors import DamagedDataError, NotAnEpisodeError, UsageError
from exumi_data.lazy import unlocked
from exumi_data.model.dataset import DatasetMetadata, SplitDocument
from exumi_data.model.documents import MAX_DOCUMENT_BYTES, dump, parse_dataset, parse_split
from exumi_data.redaction import without_secrets
from exumi_data.store.plain_files import read_plain
from exumi_data.store.remote.address import is_url, join

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.compute as pc

__all__ = ["CatalogWarning", "Dataset", "create_dataset", "open_dataset"]

DATASET_DOCUMENT = "dataset.json"
UNFINISHED_DOCUMENT = ".unfinished-dataset.json"
"""Where ``dataset.json`` waits while episodes are copied into a dataset: one that was stopped is no
dataset to any reader. See `exumi_data.destination.begin` and `exumi_data.destination.finish`."""


class CatalogWarning(UserWarning):
    """The catalog is missing or stale and was built in memory."""


@unlocked
class Dataset:
    """A dataset, or a selection of its episodes, opened for reading.

    Parameters
    ----------
    path : str
        The dataset's folder, or its URL.
    metadata : DatasetMetadata
        What ``dataset.json`` says.
    catalog : pyarrow.Table
        One row an episode, in the order of this object.

    Attributes
    ----------
    path : str
        For people: of a URL without its secrets.
    """

    def __init__(self, path: str, metadata: DatasetMetadata, catalog: "pa.Table") -> None:
        self.path = without_secrets(path)
        self._source = path
        self.metadata = metadata
        self.catalog = catalog

    def __repr__(self) -> str:
        return f"<Dataset {self.metadata.name!r}, {len(self)} episodes>"

    def __len__(self) -> int:
        return int(self.catalog.num_rows)

    @cached_property
    def ids(self) -> list[str]:
        """Episode ids, in order."""
        return list(self.catalog.column("id").to_pylist())

    @cached_property
    def _position(self) -> dict[str, int]:
        return {episode_id: index for index, episode_id in enumerate(self.ids)}

    def __contains__(self, episode_id: object) -> bool:
        return episode_id in self._position

    @overload
    def __getitem__(self, key: SupportsIndex | str) -> Episode: ...
    @overload
    def __getitem__(self, key: slice) -> "Dataset": ...
    def __getitem__(self, key: SupportsIndex | str | slice) -> "Episode | Dataset":
        """Open an episode by position or id; a slice selects."""
        if isinstance(key, slice):
            return self._view(list(range(len(self)))[key])
        if isinstance(key, str):
            if key not in self._position:
                raise UsageError(f"no episode {key!r}", where=self.path)
            return self._open(self._position[key])
        index = key.__index__()
        if not -len(self) <= index < len(self):
            msg = f"episode {index} of {len(self)}"
            raise IndexError(msg)
        return self._open(index % len(self))

    def __iter__(self) -> Iterator[Episode]:
        for index in range(len(self)):
            yield self._open(index)

    def episode_location(self, index: int) -> str:
        """Return the full path of an episode, or its URL with what it takes to open it.

        Parameters
        ----------
        index : int
            Position in this object.

        Returns
        -------
        str

        Raises
        ------
        DamagedDataError
            The catalog names a path outside the dataset.
        """
        from exumi_data.store.paths import check_member_path

        relative = self.catalog.column("path")[index].as_py()
        check_member_path(relative, self.path)
        return join(self._source, relative) if is_url(self._source) else f"{self.path}/{relative}"

    def _open(self, index: int) -> Episode:
        episode = open_episode(self.episode_location(index))
        if episode.id != self.ids[index]:
            raise DamagedDataError(
                f"the catalog says {self.ids[index]}, the episode says {episode.id}",
                where=episode.path,
                fix=f"Write the catalog again with: exumi index {self.path}",
            )
        if episode.root_sha256 != self.catalog.column("root_sha256")[index].as_py():
            warnings.warn(
                f"{episode.path}: the episode changed after the catalog was written. Write it "
                f"again with: exumi index {self.path}",
                CatalogWarning,
                stacklevel=3,
            )
        return episode

    def _view(self, indices: Sequence[int]) -> "Dataset":
        import pyarrow as pa

        chosen = pa.array(indices, pa.int64())  # an empty list alone would have no type
        return Dataset(self._source, self.metadata, self.catalog.take(chosen))

    def select(
        self,
        ids: Sequence[str] | None = None,
        *,
        where: "pc.Expression | None" = None,
        **equals: Any,
    ) -> "Dataset":
        """Select episodes.

        Parameters
        ----------
        ids : sequence of str, optional
            Episode ids, in the wanted order.
        where : pyarrow.compute.Expression, optional
            A filter over the catalog's columns.
        **equals
            Column = value, or column = collection of values; `stream="tactile_left"` and
            `kind="tactile"` ask for episodes that have such a stream.

        Returns
        -------
        Dataset

        Raises
        ------
        UsageError
            An unknown id or column.

        Examples
        --------
        >>> ds.select(part_id=["egg", "rice"], kind="tactile")  # doctest: +SKIP
        """
        view = self
        if ids is not None:
            unknown = [episode_id for episode_id in ids if episode_id not in self._position]
            if unknown:
                raise UsageError(f"no episode {unknown[0]!r}", where=self.path)
            view = view._view([self._position[episode_id] for episode_id in ids])
        for column, value in equals.items():
            wanted = (
                {value}
                if isinstance(value, str) or not isinstance(value, list | set | tuple)
                else set(value)
            )
            view = view._view(view._matching(column, wanted))
        if where is not None:
            view = Dataset(view._source, view.metadata, view.catalog.filter(where))
        return view

    def _matching(self, column: str, wanted: set[Any]) -> list[int]:
        if column in ("stream", "kind"):
            field = "name" if column == "stream" else "kind"
            streams = self.catalog.column("streams").to_pylist()
            return [i for i, row in enumerate(streams) if any(s[field] in wanted for s in row)]
        if column not in self.catalog.schema.names:
            raise UsageError(
                f"the catalog has no column {column!r}",
                where=self.path,
                fix=f"It has: {', '.join(self.catalog.schema.names)}.",
            )
        values = self.catalog.column(column).to_pylist()
        return [i for i, value in enumerate(values) if value in wanted]

    @cached_property
    def splits(self) -> Mapping[str, SplitDocument]:
        """The named splits stored with the dataset."""
        found = {}
        for name in self.metadata.splits:
            path = f"splits/{name}.json"
            where = f"{self.path}/{path}"
            try:
                found[name] = parse_split(_read_document(self._source, path), where)
            except FileNotFoundError:
                raise DamagedDataError(
                    f"dataset.json names a split {name!r} that is not there", where=where
                ) from None
        return found

    @cached_property
    def fingerprint(self) -> str:
        """Digest of the selection's content: changes whenever an episode does."""
        from exumi_data.catalog import fingerprint

        return fingerprint(self.catalog)


def open_dataset(path: str | os.PathLike[str]) -> Dataset:
    """Open a dataset folder, or the URL of one.

    A missing or stale catalog is built in memory, with one `CatalogWarning`; behind a URL it has to
    be there.

    Raises
    ------
    NotAnEpisodeError
        No ``dataset.json``.
    MetadataError, UnsupportedError
        It breaks the standard, or is newer.
    DamagedDataError
        Episodes cannot be read, or there is no usable catalog behind a URL.
    UnreachableError
        The server of a URL does not answer, or does not let us in.
    """
    remote = is_url(path)
    source = os.fsdecode(path)
    metadata = read_metadata(source)
    table = _remote_catalog(source) if remote else _local_catalog(Path(path))
    _check_ids(without_secrets(source), table)
    return Dataset(source.rstrip("/") or "/", metadata, table)


def read_metadata(source: str) -> DatasetMetadata:
    """Read ``dataset.json``.

    Parameters
    ----------
    source : str
        The dataset's folder, or its URL.

    Raises
    ------
    NotAnEpisodeError
        There is none, or the dataset is not finished.
    MetadataError, UnsupportedError
        It breaks the standard, or is newer.
    """
    try:
        raw = _read_document(source, DATASET_DOCUMENT)
    except FileNotFoundError:
        if not is_url(source) and is_unfinished(Path(source)):
            raise unfinished(source) from None
        raise NotAnEpisodeError(
            "no dataset.json: not an exUMI dataset",
            where=source,
            fix="Make one with: exumi convert SRC DST",
        ) from None
    return parse_dataset(raw, without_secrets(f"{source}/{DATASET_DOCUMENT}"))


def _read_document(source: str, path: str) -> bytes:
    """Read a JSON document of a dataset. Raises `FileNotFoundError`."""
    if not is_url(source):
        return read_plain(Path(source, path), MAX_DOCUMENT_BYTES)
    from exumi_data.store.remote.stores import read_document  # nobody else needs it

    return read_document(join(source, path), MAX_DOCUMENT_BYTES)


def _remote_catalog(url: str) -> "pa.Table":
    """Read the catalog of a remote dataset: without it, all episodes would have to be read."""
    import tempfile

    from exumi_data import catalog as catalogs  # pyarrow is slow to import
    from exumi_data.store.parquet_limits import MAX_TABLE_BYTES
    from exumi_data.store.remote.stores import read_document

    table = None
    with tempfile.TemporaryDirectory(prefix="exumi-") as folder, suppress(FileNotFoundError):
        raw = read_document(join(url, catalogs.CATALOG_NAME), MAX_TABLE_BYTES)
        Path(folder, catalogs.CATALOG_NAME).write_bytes(raw)
        table = catalogs.read_catalog(Path(folder))
    if table is None:
        raise DamagedDataError(
            f"{catalogs.CATALOG_NAME} is missing or cannot be read, and a remote dataset is known "
            "by it alone",
            where=url,
            fix="Write it where the dataset was made (exumi index), and upload it.",
        )
    return table


def _local_catalog(root: Path) -> "pa.Table":
    """Read the catalog of a dataset's folder; what it lacks is read from the episodes."""
    from exumi_data import catalog as catalogs  # pyarrow is slow to import

    table = catalogs.read_catalog(root)
    present = catalogs.list_episodes(root)
    known = [] if table is None else table.column("path").to_pylist()
    if table is None or sorted(known) != present:
        if known or present:
            warnings.warn(
                f"{root}: the catalog is {'missing' if table is None else 'stale'} and was built "
                f"in memory. Write it with: exumi index {root}",
                CatalogWarning,
                stacklevel=4,
            )
        new = [p for p in present if p not in set(known)]
        added, failed = catalogs.build_catalog(root, paths=new)
        if failed:
            first = failed[0]
            raise DamagedDataError(
                f"{len(failed)} episode(s) cannot be read; the first: {first.error}",
                where=root,
                fix=f"See all with: exumi validate {root} (what is damaged can be taken out: exumi "
                f"dataset remove {root} --unreadable --reason WHY)",
            )
        if table is not None:
            here = set(present)
            rows = {row["path"]: row for row in table.to_pylist() if row["path"] in here}
            table = catalogs.rows_to_table([*rows.values(), *added.to_pylist()])
        else:
            table = added
    return table


def _check_ids(root: str, table: "pa.Table") -> None:
    paths: dict[str, str] = {}
    for episode_id, path in zip(
        table.column("id").to_pylist(), table.column("path").to_pylist(), strict=True
    ):
        if episode_id in paths:
            raise DamagedDataError(
                f"{paths[episode_id]} and {path} are the same episode, {episode_id}",
                where=root,
                fix="Remove one of them.",
            )
        paths[episode_id] = path


def _is_foreign(entry: Path) -> bool:
    """Whether an entry is none that a dataset has before its document: another may be making it."""
    return entry.name != "episodes" and not entry.name.startswith(".partial-")


def is_unfinished(root: Path) -> bool:
    """Whether a folder is a dataset into which a run was, or is still, copying episodes.

    Parameters
    ----------
    root : pathlib.Path
    """
    return (root / UNFINISHED_DOCUMENT).is_file() and not (root / DATASET_DOCUMENT).exists()


def unfinished(path: str | os.PathLike[str]) -> NotAnEpisodeError:
    """Return the error for a dataset that is not finished.

    Parameters
    ----------
    path : path-like
    """
    return NotAnEpisodeError(
        "a dataset that is not finished: what was copying episodes into it was stopped, or goes on",
        where=path,
        fix="Run the same exumi dataset command again: it goes on where it was stopped.",
    )


def create_dataset(path: str | os.PathLike[str], metadata: DatasetMetadata) -> Path:
    """Make a dataset folder, or take up an existing one of the same name.

    Returns
    -------
    pathlib.Path
        The folder.

    Raises
    ------
    UsageError
        The folder holds something else.
    """
    root = Path(path)
    if not (root / DATASET_DOCUMENT).exists():
        make_dataset(root, metadata, DATASET_DOCUMENT)
    return root


def make_dataset(root: Path, metadata: DatasetMetadata, document: str) -> None:
    """Make a dataset in a new or empty folder.

    Parameters
    ----------
    root : pathlib.Path
    metadata : DatasetMetadata
    document : str
        The name under which `metadata` is written.

    Raises
    ------
    UsageError
        The folder holds something else.
    """
    import json

    from exumi_data.store.files import write_atomic

    if is_unfinished(root):
        raise UsageError(
            "holds a dataset that is not finished",
            where=root,
            fix="Run the exumi dataset command that began it again, or name another folder.",
        )
    if root.exists() and (not root.is_dir() or any(map(_is_foreign, root.iterdir()))):
        raise UsageError(
            "exists and is no exUMI dataset",
            where=root,
            fix="Name a new or empty folder.",
        )
    if root.is_symlink() and not root.exists():
        raise UsageError(
            "is a link that leads nowhere", where=root, fix="Make the folder that it leads to."
        )
    (root / "episodes").mkdir(parents=True, exist_ok=True)
    write_atomic(
        root / document,
        (json.dumps(dump(metadata), indent=1, ensure_ascii=False) + "\n").encode(),
    )
