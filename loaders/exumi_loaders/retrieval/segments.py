"""Segments of an index: vectors as a Zarr array, entries as a Parquet table; never changed."""

import mmap
import uuid
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from exumi_data.errors import DamagedDataError, UsageError
from exumi_data.model.documents import group_document
from exumi_data.store.access import FolderStore
from exumi_data.store.files import sync_folder, sync_tree
from exumi_data.store.plain_files import open_plain
from exumi_data.store.shards import ArrayWriter, crc32c, open_array
from exumi_loaders.retrieval.blocks import Block
from exumi_loaders.retrieval.document import SegmentStatement
from exumi_loaders.retrieval.entries import Entry, entry_of, read_entries, write_entries

if TYPE_CHECKING:
    import pyarrow as pa

__all__ = ["SEGMENTS", "Segment", "open_segment", "write_segment", "write_vectors"]

SEGMENTS = "segments"
VECTORS = "embeddings"
ENTRIES = "entries.parquet"
_CHUNK_BYTES = 1 << 20


class Segment:
    """A segment, opened.

    Parameters
    ----------
    statement : SegmentStatement
    blocks : sequence of Block
        Its vectors, mapped from the files: nothing is read before it is used.
    table : pyarrow.Table
        Its entries.
    """

    def __init__(
        self, statement: SegmentStatement, blocks: Sequence[Block], table: "pa.Table"
    ) -> None:
        self.statement = statement
        self.blocks = blocks
        self.table = table

    @property
    def alive(self) -> np.ndarray:
        """(rows,) bool: which entries are not forgotten."""
        alive = np.ones(self.statement.rows, dtype=bool)
        alive[self.statement.forgotten] = False
        return alive

    def entries(self, rows: np.ndarray) -> list[Entry]:
        """Return the entries of some rows.

        Parameters
        ----------
        rows : (rows,) bool
        """
        return [entry_of(row) for row in self.table.filter(rows).to_pylist()]


def write_segment(
    root: Path, vectors: np.ndarray | Iterable[np.ndarray], entries: Sequence[Entry]
) -> SegmentStatement:
    """Write a segment; it belongs to the index once ``index.json`` names it.

    Parameters
    ----------
    root : pathlib.Path
        The index.
    vectors : (N, d) float32, or blocks of them
    entries : sequence of Entry

    Returns
    -------
    SegmentStatement
    """
    name = uuid.uuid4().hex
    folder = root / SEGMENTS / name
    folder.mkdir(parents=True)
    (folder / "zarr.json").write_bytes(group_document())
    rows = write_vectors(folder / VECTORS, vectors)
    if rows != len(entries):
        raise UsageError(f"{rows} vectors for {len(entries)} entries", where=root)
    checksums = [crc32c(rows) for rows, _ in _map_vectors(root, f"{SEGMENTS}/{name}/{VECTORS}")]
    write_entries(folder / ENTRIES, entries)
    sync_tree(folder)
    sync_folder(folder.parent)
    return SegmentStatement(name=name, rows=rows, crc32c=checksums)


def write_vectors(
    folder: Path, vectors: np.ndarray | Iterable[np.ndarray], *, mapped: bool = True
) -> int:
    """Write an array (N, d) float32; return N.

    Parameters
    ----------
    folder : pathlib.Path
    vectors : (N, d) float32, or blocks of them
    mapped : bool
        As it is, to be mapped into memory; or compressed, with checksums, to be read whole.

    Raises
    ------
    UsageError
        Some numbers are not finite.
    """
    writer: ArrayWriter | None = None
    try:
        for block in [vectors] if isinstance(vectors, np.ndarray) else vectors:
            if not np.isfinite(block).all():
                raise UsageError("a vector has numbers that are not finite", where=folder)
            if writer is None:
                chunk = max(1, _CHUNK_BYTES // (4 * block.shape[1]))
                names = ("entry", "dimension")
                writer = ArrayWriter(
                    folder,
                    np.float32,
                    block.shape[1:],
                    chunk_rows=chunk,
                    zstd=not mapped,
                    dimension_names=names,
                )
            writer.append(block)
        if writer is None:
            raise UsageError("there is nothing to write", where=folder)
        writer.finish()
    except BaseException:
        if writer is not None:
            writer.abort()
        raise
    return writer.rows


def open_segment(root: Path, statement: SegmentStatement, dimension: int) -> Segment:
    """Open a segment. Memory does not depend on what its files claim; no vector is read.

    Raises
    ------
    DamagedDataError
        Files are missing, cut short, or do not fit together.
    """
    path = f"{SEGMENTS}/{statement.name}"
    mapped = _map_vectors(root, f"{path}/{VECTORS}", (statement.rows, dimension))
    if len(mapped) != len(statement.crc32c):
        raise DamagedDataError(
            f"{len(mapped)} files of vectors, and {len(statement.crc32c)} checksums",
            where=root / path,
        )
    blocks = [
        Block(rows, file, checksum)
        for (rows, file), checksum in zip(mapped, statement.crc32c, strict=True)
    ]
    return Segment(statement, blocks, read_entries(root / path / ENTRIES, statement.rows))


def _map_vectors(
    root: Path, path: str, shape: tuple[int, int] | None = None
) -> list[tuple[np.ndarray, Path]]:
    """Map an array (N, d) float32 into memory: read-only rows of each of its files."""
    where = root / path
    store = FolderStore(root)
    try:
        array = open_array(store, path)
        shape = shape or (array.shape[0], array.shape[1])
        if array.shape != shape or array.dtype != np.float32:
            raise DamagedDataError(
                f"vectors of {array.shape} {array.dtype}, expected {shape} float32", where=where
            )
        document = array.document
        blocks = []
        for shard in range(document.shards):
            rows = min(document.shard_rows, shape[0] - shard * document.shard_rows)
            if not array.is_contiguous(shard):  # checks the file's size and index, too
                raise DamagedDataError("vectors do not lie in order", where=where)
            path_of_shard = where / document.shard_path(shard)
            with open_plain(path_of_shard) as file:
                mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
            flat = np.frombuffer(mapped, dtype="<f4", count=rows * shape[1])
            blocks.append((flat.reshape(rows, shape[1]), path_of_shard))
        return blocks
    finally:
        store.close()
