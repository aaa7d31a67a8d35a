"""Changes of an index: entries added, entries forgotten. Call these while holding it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from exumi_loaders.retrieval.document import IndexDocument, SegmentStatement
from exumi_loaders.retrieval.entries import Entry
from exumi_loaders.retrieval.folder import write_document
from exumi_loaders.retrieval.segments import open_segment, write_segment

__all__ = ["add", "forget"]

_SMALL_ROWS = 256
_MOST_SMALL = 64


def add(
    root: Path, document: IndexDocument, vectors: np.ndarray, entries: Sequence[Entry]
) -> IndexDocument:
    """Add entries.

    Parameters
    ----------
    root : pathlib.Path
    document : IndexDocument
        What the index is now.
    vectors : (N, d) float32
    entries : sequence of Entry

    Returns
    -------
    IndexDocument
        What it is then.
    """
    # The first segment is that of the build.
    small = [s for s in document.segments[1:] if s.rows <= _SMALL_ROWS]
    kept = document.segments
    described = list(entries)
    if len(small) >= _MOST_SMALL:
        # Each lesson is a segment of one row; many of them are put together.
        kept = [s for s in document.segments if s not in small]
        old = [_living(root, statement, document.dimension) for statement in small]
        vectors = np.concatenate([*(rows for rows, _ in old), vectors])
        described = [*(entry for _, some in old for entry in some), *entries]
    statement = write_segment(root, vectors, described)
    return _write(root, document, [*kept, statement])


def forget(
    root: Path, document: IndexDocument, column: str, value: str, *, built: bool
) -> list[Entry]:
    """Mark entries as forgotten.

    Parameters
    ----------
    root : pathlib.Path
    document : IndexDocument
        What the index is now.
    column : {"name", "id"}
    value : str
        What the column says of those that go.
    built : bool
        Whether entries that were built from a dataset go, too.

    Returns
    -------
    list of Entry
        Those that counted until now.
    """
    import pyarrow.compute as pc

    gone: list[Entry] = []
    segments = []
    for statement in document.segments:
        segment = open_segment(root, statement, document.dimension)
        taught = segment.table.column("taught").to_numpy()
        goes = pc.equal(segment.table.column(column), value).to_numpy()
        goes &= segment.alive & (taught | built)
        gone += segment.entries(goes)
        dead = ~segment.alive | goes
        # A segment is dropped when nothing of it counts. One of the build is kept: a query that
        # is in it can still be told.
        if not dead.all() or not taught.all():
            marked = np.flatnonzero(dead).tolist()
            segments.append(statement.model_copy(update={"forgotten": marked}))
    if gone:
        _write(root, document, segments)
    return gone


def _living(
    root: Path, statement: SegmentStatement, dimension: int
) -> tuple[np.ndarray, list[Entry]]:
    segment = open_segment(root, statement, dimension)
    for block in segment.blocks:
        block.check()  # or the copy would get a checksum that is right
    alive = segment.alive
    return np.concatenate([block.rows for block in segment.blocks])[alive], segment.entries(alive)


def _write(root: Path, document: IndexDocument, segments: list[SegmentStatement]) -> IndexDocument:
    changed = document.model_copy(
        update={"segments": segments, "generation": document.generation + 1}
    )
    write_document(root, changed)
    return changed
