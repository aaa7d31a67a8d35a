"""The catalog of a dataset: one row an episode; derived, never authoritative."""

import hashlib
import os
import re
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exumi_data.engine import Engine, Outcome, map_items
from exumi_data.episode import Episode, open_episode
from exumi_data.errors import DamagedDataError, ExumiError, MetadataError, UsageError
from exumi_data.model.episode import DerivedItem, EpisodeMetadata
from exumi_data.model.streams import images_of
from exumi_data.store.digest import digest_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    import pyarrow as pa
    import pyarrow.parquet as pq

__all__ = [
    "CATALOG_NAME",
    "EPISODES_FOLDER",
    "build_catalog",
    "catalog_row",
    "catalog_schema",
    "episode_path",
    "fingerprint",
    "list_episodes",
    "metadata_columns",
    "obstacle_to_catalog",
    "open_catalog",
    "read_catalog",
    "write_catalog",
]

CATALOG_NAME = "catalog.parquet"
EPISODES_FOLDER = "episodes"
_SUFFIXES = (".zarr", ".zarr.zip")
_DEFAULT_ACTIVE_ABOVE = 1e-3
_ID = re.compile(r"[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}")


def catalog_schema() -> "pa.Schema":
    """Return the catalog's Arrow schema (spec: Catalog)."""
    import pyarrow as pa  # slow to import

    stream = pa.struct(
        [
            ("name", pa.string()),
            ("kind", pa.string()),
            ("encoding", pa.string()),
            ("n", pa.int64()),
            ("t0_ns", pa.int64()),
            ("t1_ns", pa.int64()),
            ("active", pa.int64()),
        ]
    )
    label = pa.struct([("property", pa.string()), ("number", pa.float64()), ("text", pa.string())])
    return pa.schema(
        [
            pa.field("id", pa.string(), nullable=False),
            pa.field("path", pa.string(), nullable=False),
            pa.field("revision", pa.int64(), nullable=False),
            pa.field("root_sha256", pa.string(), nullable=False),
            pa.field("derived_digest", pa.string()),
            pa.field("digest", pa.string(), nullable=False),
            pa.field("bytes", pa.int64(), nullable=False),
            pa.field("start", pa.string()),
            pa.field("duration_s", pa.float64(), nullable=False),
            pa.field("regime", pa.string(), nullable=False),
            pa.field("task", pa.string(), nullable=False),
            pa.field("success", pa.bool_()),
            pa.field("licence", pa.string(), nullable=False),
            pa.field("object_id", pa.string()),
            pa.field("part_id", pa.string()),
            pa.field("instance_id", pa.string()),
            pa.field("trial", pa.int64()),
            pa.field("procedure", pa.string()),
            pa.field("pad_type", pa.string()),
            pa.field("labels", pa.list_(label), nullable=False),
            pa.field("quality", pa.list_(pa.string()), nullable=False),
            pa.field("streams", pa.list_(stream), nullable=False),
        ]
    )


def episode_path(episode_id: str, *, packed: bool = False) -> str:
    """Return an episode's path below the dataset: ``episodes/<xx>/<id>.zarr[.zip]``."""
    suffix = ".zarr.zip" if packed else ".zarr"
    return f"{EPISODES_FOLDER}/{episode_id[-2:]}/{episode_id}{suffix}"


def list_episodes(root: Path) -> list[str]:
    """List the finished episodes of a dataset, sorted by path.

    Names that begin with a dot are half-written or put aside, and are no episodes. Nor are links
    and special files: a dataset could lead anywhere by them.

    Raises
    ------
    DamagedDataError
        A folder cannot be read, or ``episodes`` is a link.
    """
    found = []
    base = root / EPISODES_FOLDER
    try:
        if base.is_symlink():
            raise DamagedDataError("is a link; links are not followed", where=base)
        if not base.is_dir():
            return []
        # Scandir is an order of magnitude faster than pathlib here.
        with os.scandir(base) as folders:
            for folder in folders:
                if folder.name.startswith(".") or not folder.is_dir(follow_symlinks=False):
                    continue
                with os.scandir(folder.path) as entries:
                    found += [
                        f"{EPISODES_FOLDER}/{folder.name}/{entry.name}"
                        for entry in entries
                        if entry.name.endswith(_SUFFIXES)
                        and not entry.name.startswith(".")
                        and (entry.is_dir(follow_symlinks=False) or _is_file(entry))
                    ]
    except OSError as error:
        raise DamagedDataError(f"cannot be read ({error.strerror})", where=base) from error
    return sorted(found)


def _is_file(entry: "os.DirEntry[str]") -> bool:
    return entry.is_file(follow_symlinks=False)


def _label(label: Any) -> dict[str, Any]:
    value = label.value
    if isinstance(value, list):
        value = "|".join(value)
    is_number = isinstance(value, int | float)
    return {
        "property": label.property,
        "number": float(value) if is_number else None,
        "text": value if isinstance(value, str) else None,
    }


def catalog_row(episode: Episode, path: str) -> dict[str, Any]:
    """Make an episode's row. Reads its times, activity and bytes (for the digest).

    Parameters
    ----------
    episode : Episode
    path : str
        Relative to the dataset.
    """
    streams = []
    for name, stream in episode.streams.items():
        time = stream.time
        activity = stream.activity if stream.kind == "tactile" else None
        above = 0.0
        if activity is not None and episode.derived is not None:
            above = _active_above(episode.derived.items[f"{name}/activity"], episode.path)
        images = images_of(stream.metadata)
        streams.append(
            {
                "name": name,
                "kind": stream.kind,
                "encoding": None if images is None else images.encoding,
                "n": len(time),
                "t0_ns": int(time[0]) if len(time) else None,
                "t1_ns": int(time[-1]) if len(time) else None,
                "active": None if activity is None else int((activity > above).sum()),
            }
        )
    meta, store = episode.metadata, episode.store
    return {
        "id": meta.id,
        "path": path,
        "revision": meta.revision,
        "root_sha256": hashlib.sha256(store.read("zarr.json")).hexdigest(),
        "derived_digest": None if episode.derived is None else digest_of(store, derived=True),
        "digest": episode.digest(),
        "bytes": sum(store.size(member) for member in store.paths()),
        "duration_s": episode.duration_s,
        **metadata_columns(meta),
        "streams": streams,
    }


def metadata_columns(meta: EpisodeMetadata) -> dict[str, Any]:
    """Make the columns of a row that are the metadata's own, but for `id` and `revision`.

    Parameters
    ----------
    meta : EpisodeMetadata

    Returns
    -------
    dict
        Column to value.
    """
    notes = meta.annotations
    return {
        "start": meta.start,
        "regime": meta.regime,
        "task": meta.task.name,
        "success": meta.success,
        "licence": meta.licence,
        "object_id": notes.object_id if notes else None,
        "part_id": notes.part_id if notes else None,
        "instance_id": notes.instance_id if notes else None,
        "trial": notes.trial if notes else None,
        "procedure": notes.procedure if notes else None,
        "pad_type": notes.pad_type if notes else None,
        "labels": [_label(label) for label in (notes.labels if notes else None) or []],
        "quality": [note.code for note in meta.quality],
    }


def _active_above(item: DerivedItem, where: str) -> float:
    value = item.parameters.get("active_above", _DEFAULT_ACTIVE_ABOVE)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise MetadataError(f"active_above is {value!r}, not a number", where=f"{where}/derived")
    return value


def _row_of(path: str, *, root: str) -> dict[str, Any]:
    with open_episode(f"{root}/{path}") as episode:
        return catalog_row(episode, path)


def build_catalog(
    root: Path,
    *,
    paths: "Sequence[str] | None" = None,
    workers: int | None = None,
    engine: Engine | None = None,
    on_done: "Callable[[Outcome[str, dict[str, Any]]], None] | None" = None,
) -> "tuple[pa.Table, list[Outcome[str, dict[str, Any]]]]":
    """Read episodes and make the catalog.

    Parameters
    ----------
    root : pathlib.Path
        The dataset.
    paths : sequence of str, optional
        Relative paths; default all episodes.
    workers : int, optional
        Processes; default one for a few episodes, else all cores.
    engine : Engine, optional
        Where the episodes are worked on; default processes of this machine.
    on_done : callable, optional
        Told of each outcome, for progress.

    Returns
    -------
    catalog : pyarrow.Table
        Sorted by path.
    failed : list of Outcome
        The episodes that could not be read.
    """
    rows, failed = [], []
    todo = list_episodes(root) if paths is None else list(paths)
    # A few episodes are read faster than processes start.
    if engine is None and len(todo) < 64:
        workers = 1
    function = partial(_row_of, root=str(root))
    for outcome in map_items(function, todo, workers=workers, engine=engine):
        if outcome.value is not None:
            rows.append(outcome.value)
        elif isinstance(outcome.error, ExumiError):
            failed.append(outcome)
        elif outcome.error is not None:
            raise outcome.error
        if on_done is not None:
            on_done(outcome)
    return rows_to_table(rows), failed


def rows_to_table(rows: "Iterable[dict[str, Any]]") -> "pa.Table":
    """Turn rows into a catalog table, sorted by path."""
    import pyarrow as pa

    return pa.Table.from_pylist(
        sorted(rows, key=lambda row: str(row["path"])), schema=catalog_schema()
    )


def obstacle_to_catalog(root: Path) -> str | None:
    """Return why ``catalog.parquet`` cannot be written anew; None where it can.

    Parameters
    ----------
    root : pathlib.Path
        The dataset.
    """
    path = root / CATALOG_NAME
    if path.is_symlink():
        return f"{CATALOG_NAME} is a link: it is neither followed nor replaced"
    if not path.exists():
        return None
    if not path.is_file():
        return f"{CATALOG_NAME} is no file"
    # What it knows would be lost unseen.
    return None if os.access(path, os.R_OK) else f"{CATALOG_NAME} may not be read"


def write_catalog(root: Path, table: "pa.Table") -> Path:
    """Write ``catalog.parquet``, whole or not at all.

    Raises
    ------
    UsageError
        A link stands there, or what is no file, or what may not be read.
    OSError
        It cannot be written.
    """
    import pyarrow.parquet as pq

    from exumi_data.store.files import atomic_file

    target = root / CATALOG_NAME
    obstacle = obstacle_to_catalog(root)
    if obstacle is not None:
        raise UsageError(obstacle, where=root, fix="Remove it first.")
    try:
        # An open file: of a name, pyarrow takes UTF-8 only.
        with atomic_file(target) as temporary, temporary.open("wb") as file:
            pq.write_table(table, file, compression="zstd", write_page_checksum=True)
    except OSError as error:  # Arrow's words name a temporary file
        if error.errno is None:
            raise
        raise OSError(error.errno, os.strerror(error.errno), str(target)) from error
    return target


@contextmanager
def open_catalog(root: Path) -> "Iterator[pq.ParquetFile]":
    """Open ``catalog.parquet`` for reading; columns can be read without fear for memory.

    Raises
    ------
    FileNotFoundError
        It is not there.
    DamagedDataError
        It cannot be read, or asks for more memory than a catalog needs.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    from exumi_data.store.parquet_limits import footer_mistake, pages_mistake
    from exumi_data.store.plain_files import is_plain_file

    path = root / CATALOG_NAME
    if not is_plain_file(path):
        raise FileNotFoundError(path)
    try:
        mistake = footer_mistake(path)
        if mistake is None:
            with pq.ParquetFile(path, page_checksum_verification=True) as file:
                mistake = pages_mistake(path, file.metadata)
                if mistake is None:
                    yield file
    except (pa.ArrowException, OSError, ValueError) as error:
        known = error.strerror if isinstance(error, OSError) else None
        first = known or str(error).partition("\n")[0]
        raise DamagedDataError(f"cannot be read: {first}", where=path) from None
    if mistake:
        raise DamagedDataError(f"cannot be read: {mistake}", where=path)


def read_catalog(root: Path) -> "pa.Table | None":
    """Read ``catalog.parquet``; None when it is missing, damaged or of another schema."""
    try:
        with open_catalog(root) as file:
            table = file.read()
            table.validate(full=True)
    except (FileNotFoundError, DamagedDataError):
        return None
    if not all(_has(table, field) for field in catalog_schema()):
        return None
    return table if all(_ID.fullmatch(one) for one in table.column("id").to_pylist()) else None


def _has(table: "pa.Table", field: "pa.Field") -> bool:
    """Whether a table has a column, once, of that type."""
    if table.schema.get_all_field_indices(field.name) != [table.schema.get_field_index(field.name)]:
        return False
    column = table.column(field.name)
    return bool(column.type == field.type and (field.nullable or not column.null_count))


def fingerprint(table: "pa.Table") -> str:
    """Return the digest of a catalog's content: what a cache of windows is keyed by."""
    state = hashlib.sha256()
    columns = ("id", "revision", "root_sha256", "derived_digest", "digest")
    for row in zip(*(table.column(name).to_pylist() for name in columns), strict=True):
        state.update(repr(row).encode())
    return state.hexdigest()
