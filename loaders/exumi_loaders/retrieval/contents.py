"""What an index holds, opened at one moment: it stays as it is while others change the index."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from exumi_data.errors import DamagedDataError, LimitError
from exumi_loaders.retrieval.blocks import merge_small
from exumi_loaders.retrieval.document import IndexDocument
from exumi_loaders.retrieval.entries import Entry, entry_of, group_codes
from exumi_loaders.retrieval.faiss_search import FaissSearch
from exumi_loaders.retrieval.folder import read_document
from exumi_loaders.retrieval.matches import Unique
from exumi_loaders.retrieval.search import ExactSearch, Search
from exumi_loaders.retrieval.segments import Segment, open_segment
from exumi_loaders.retrieval.space import Space, unit
from exumi_loaders.retrieval.writing import read_space

__all__ = ["Backend", "Contents", "IndexInfo", "open_contents"]

Backend = Literal["exact", "faiss"]

_MOST_ENTRIES_BYTES = 8 << 30
_TRIES = 5


@dataclass(frozen=True)
class IndexInfo:
    """What an index holds, and what it was made from.

    Attributes
    ----------
    path : str
    generation : int
        Changes since it was built.
    encoder, encoder_digest : str
    dimension : int
        Of the vectors that are compared.
    space : str or None
        How the encoder's vectors were made comparable, fitted on the clips of the build.
    frames : int
        Salient frames a clip.
    dataset, dataset_digest, split : str or None
        Where the clips of the build come from.
    damaged : int
        Clips of it that could not be decoded, and were left out.
    entries, taught, forgotten : int
        Those that count; those of them that were taught; those that no longer count.
    objects, parts : int
        Of those that count. What has no part id is a part by its name.
    """

    path: str
    generation: int
    encoder: str
    encoder_digest: str
    dimension: int
    space: str | None
    frames: int
    dataset: str | None
    dataset_digest: str | None
    split: str | None
    damaged: int
    entries: int
    taught: int
    forgotten: int
    objects: int
    parts: int

    def as_dict(self) -> dict[str, Any]:
        """Return what JSON can write."""
        return asdict(self)


class Contents:
    """Documents, space and segments of an index.

    Parameters
    ----------
    root : pathlib.Path
    document : IndexDocument
    backend : {"exact", "faiss"}
    known : mapping of str to Segment
        Segments that are open already: they never change.

    Raises
    ------
    DamagedDataError
        Files are missing or damaged. (Vectors are checked when they are first searched.)
    LimitError
        They ask for more memory than they may.
    """

    def __init__(
        self,
        root: Path,
        document: IndexDocument,
        backend: Backend,
        known: Mapping[str, Segment],
    ) -> None:
        self.root = root
        self.document = document
        self._space: Space | None = read_space(root, document)
        self._segments: list[Segment] = []
        taken = 0
        for statement in document.segments:
            found = known.get(statement.name)
            if found is None:
                found = open_segment(root, statement, document.dimension)
            self._segments.append(Segment(statement, found.blocks, found.table))
            taken += self._segments[-1].table.nbytes
            if taken > _MOST_ENTRIES_BYTES:
                raise LimitError("the tables of entries take too much memory", where=root)
        self._starts = np.cumsum([0, *(segment.statement.rows for segment in self._segments)])
        self._groups: dict[str, np.ndarray] = {}
        self.search: Search = self._searcher(backend)

    def _searcher(self, backend: Backend) -> Search:
        blocks = merge_small([block for segment in self._segments for block in segment.blocks])
        forgotten = any(segment.statement.forgotten for segment in self._segments)
        alive = np.concatenate([s.alive for s in self._segments]) if forgotten else None
        rows = [block.rows for block in blocks]
        if backend == "exact":
            return ExactSearch(rows, alive, before=lambda number: blocks[number].check())
        for block in blocks:
            block.check()
        return FaissSearch(rows, alive)

    @property
    def segments(self) -> dict[str, Segment]:
        """The open segments by name."""
        return {segment.statement.name: segment for segment in self._segments}

    def __len__(self) -> int:
        return sum(s.statement.rows - len(s.statement.forgotten) for s in self._segments)

    def place(self, vectors: np.ndarray) -> np.ndarray:
        """Map vectors (B, D) of the encoder into the space, (B, d) float32 of length 1."""
        return unit(vectors) if self._space is None else self._space.place(vectors)

    def entries(self) -> list[Entry]:
        """Return all entries that count, in the order of their rows."""
        return [entry for segment in self._segments for entry in segment.entries(segment.alive)]

    def entry(self, row: int) -> Entry:
        """Return the entry of a row."""
        number = int(np.searchsorted(self._starts, row, side="right")) - 1
        table = self._segments[number].table
        return entry_of(table.slice(int(row - self._starts[number]), 1).to_pylist()[0])

    def codes(self, unique: Unique) -> np.ndarray:
        """Return the object, part or clip of each row as a number, (N,) int."""
        if unique == "clip":
            return np.arange(int(self._starts[-1]))
        if unique not in self._groups:
            self._groups[unique] = group_codes([s.table for s in self._segments], unique)
        return self._groups[unique]

    def holds(self, origins: Sequence[str]) -> bool:
        """Whether a clip of these origins was built in, or was taught and is not forgotten."""
        import pyarrow as pa
        import pyarrow.compute as pc

        wanted = pa.array(list(origins), pa.string())
        for segment in self._segments:
            counts = segment.alive | ~segment.table.column("taught").to_numpy()
            for chunk in segment.table.column("origins").filter(counts).chunks:
                if pc.any(pc.is_in(chunk.flatten(), value_set=wanted)).as_py():
                    return True
        return False

    def info(self) -> IndexInfo:
        """Return what the index holds, and what it was made from."""
        document = self.document
        source = document.source
        living = [s.table.filter(s.alive) for s in self._segments]
        return IndexInfo(
            path=str(self.root),
            generation=document.generation,
            encoder=document.encoder.name,
            encoder_digest=document.encoder.digest,
            dimension=document.dimension,
            space=document.space,
            frames=document.frames,
            dataset=source.name if source else None,
            dataset_digest=source.digest if source else None,
            split=source.split if source else None,
            damaged=source.damaged if source else 0,
            entries=len(self),
            taught=sum(int(table.column("taught").to_numpy().sum()) for table in living),
            forgotten=int(self._starts[-1]) - len(self),
            objects=len(np.unique(group_codes(living, "object"))),
            parts=len(np.unique(group_codes(living, "part"))),
        )


def open_contents(
    root: Path, backend: Backend, known: Mapping[str, Segment] | None = None
) -> Contents:
    """Open an index as it is now.

    Parameters
    ----------
    root : pathlib.Path
    backend : {"exact", "faiss"}
    known : mapping of str to Segment, optional
        Segments that are open already.

    Raises
    ------
    NotAnEpisodeError, MetadataError, UnsupportedError, DamagedDataError, LimitError
        No index is there, or it cannot be read.
    """
    for _ in range(_TRIES):
        document = read_document(root)
        try:
            return Contents(root, document, backend, known or {})
        except DamagedDataError:
            # Another process may have changed the index between two files.
            if read_document(root).generation == document.generation:
                raise
    raise DamagedDataError("it changes faster than it can be read", where=root)
