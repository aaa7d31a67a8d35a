"""Parquet files of strangers: what is read of them is bounded before it is read."""

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from exumi_data.errors import SourceError
from exumi_data.store.parquet_limits import footer_mistake, pages_mistake

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

__all__ = [
    "column_rows",
    "numbers_of",
    "open_parquet",
    "read_columns",
    "rows_of_episode",
    "texts_of",
]

_BATCH = 1024


@contextmanager
def open_parquet(path: Path) -> "Iterator[pq.ParquetFile]":
    """Open a file; what is wrong with it while it is read becomes one message.

    Raises
    ------
    SourceError
        It is no Parquet file, damaged or missing.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        mistake = footer_mistake(path)
        if mistake is None:
            with pq.ParquetFile(path, page_checksum_verification=True) as file:
                yield file
    except OSError as error:
        if isinstance(error, pa.ArrowException) or error.strerror is None:
            mistake = str(error)
        else:
            mistake = f"cannot be read ({error.strerror})"
    except (pa.ArrowException, ValueError, OverflowError) as error:
        mistake = str(error)
    if mistake is not None:
        short = mistake.split("\n")[0]
        raise SourceError(f"cannot be read as Parquet ({short})", where=path) from None


def _check(
    path: Path,
    file: "pq.ParquetFile",
    columns: Collection[str],
    groups: Collection[int] | None = None,
) -> None:
    missing = [name for name in columns if name not in file.schema_arrow.names]
    if missing:
        raise SourceError(f"has no column {missing[0]!r}", where=path)
    mistake = pages_mistake(path, file.metadata, columns=columns, groups=groups)
    if mistake:
        raise SourceError(f"is not read: {mistake}", where=path)


def read_columns(path: Path, columns: Sequence[str]) -> "pa.Table":
    """Read whole columns.

    Raises
    ------
    SourceError
        One is missing, or the file is damaged or asks for too much memory.
    """
    with open_parquet(path) as file:
        _check(path, file, columns)
        return file.read(columns=list(columns)).select(list(columns))


def _groups(file: "pq.ParquetFile", episode: int) -> list[int]:
    """Return the row groups that may hold rows of an episode, by what their summaries say."""
    found = []
    for group in range(file.metadata.num_row_groups):
        summary = file.metadata.row_group(group)
        numbers = [
            summary.column(i).statistics
            for i in range(summary.num_columns)
            if summary.column(i).path_in_schema == "episode_index"
        ]
        known = numbers[0] if numbers else None
        ends = (known.min, known.max) if known is not None and known.has_min_max else ()
        if not (ends and all(isinstance(end, int) for end in ends)) or (
            ends[0] <= episode <= ends[1]
        ):
            found.append(group)
    return found


def rows_of_episode(path: Path, episode: int, columns: Sequence[str]) -> "pa.Table":
    """Read the rows of one episode.

    Parameters
    ----------
    path : pathlib.Path
    episode : int
        Its ``episode_index``.
    columns : sequence of str

    Raises
    ------
    SourceError
    """
    import pyarrow as pa

    batches = list(_batches(path, episode, columns, _BATCH))
    if not batches:
        raise SourceError(f"holds no row of episode {episode}", where=path)
    return pa.Table.from_batches(batches)


def column_rows(path: Path, episode: int, column: str) -> Iterator[Any]:
    """Yield one column of an episode row by row, few rows in memory.

    Raises
    ------
    SourceError
    """
    for batch in _batches(path, episode, [column], 16):
        for value in batch.column(0):
            yield value.as_py()


def _batches(
    path: Path, episode: int, columns: Sequence[str], size: int
) -> "Iterator[pa.RecordBatch]":
    import pyarrow.compute as pc

    needed = list(dict.fromkeys((*columns, "episode_index")))
    with open_parquet(path) as file:
        groups = _groups(file, episode)
        _check(path, file, needed, groups)
        for batch in file.iter_batches(size, row_groups=groups, columns=needed):
            mask = pc.equal(batch.column("episode_index"), episode)
            kept = batch.filter(mask)
            if kept.num_rows:
                yield kept.select(list(columns))


def texts_of(table: "pa.Table", column: str, where: Path) -> list[Any]:
    """Return a column of texts, or of lists of them, as Python's own values.

    Raises
    ------
    SourceError
        A text is no UTF-8.
    """
    try:
        values: list[Any] = table.column(column).to_pylist()
    except ValueError as error:
        raise SourceError(f"{column!r} holds what is no text ({error})", where=where) from None
    return values


def numbers_of(table: "pa.Table", column: str, where: Path) -> np.ndarray:
    """Return a column of numbers, (N,) or (N, C), in its own type.

    Raises
    ------
    SourceError
        It holds something else, or lists of different lengths.
    """
    import pyarrow as pa

    chunk = table.column(column).combine_chunks()
    width = None
    if pa.types.is_list(chunk.type) or pa.types.is_large_list(chunk.type):
        lengths = np.diff(np.asarray(chunk.offsets))
        if chunk.null_count or (len(lengths) and (lengths != lengths[0]).any()):
            raise SourceError(f"lists of {column!r} differ in length", where=where)
        width, chunk = int(lengths[0]) if len(lengths) else 0, chunk.flatten()
    elif pa.types.is_fixed_size_list(chunk.type):
        if chunk.null_count:
            raise SourceError(f"values of {column!r} are missing", where=where)
        width, chunk = chunk.type.list_size, chunk.flatten()
    is_number = pa.types.is_integer(chunk.type) or pa.types.is_floating(chunk.type)
    if not is_number or chunk.null_count:
        raise SourceError(f"{column!r} holds {chunk.type}, or nothing in places", where=where)
    values: np.ndarray = chunk.to_numpy(zero_copy_only=False)
    return values if width is None else values.reshape(-1, width)
