"""Rows of an array, read and decoded when they are asked for, some at a time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from exumi_converters.zarr2_files.chunk_codecs import decode_chunk
from exumi_converters.zarr2_files.chunks import Chunks, Piece
from exumi_converters.zarr2_files.metadata import MAX_CHUNK, ArrayMeta
from exumi_data.errors import ExumiError, LimitError, SourceError

__all__ = ["Block", "Rows"]


class Block(NamedTuple):
    """Rows that lie in the same chunks.

    Attributes
    ----------
    first : int
        The first of them, counted from the episode's first.
    values : (n, ...) ndarray or None
        None: a chunk is missing or damaged.
    reason : str
        What is the matter then.
    rows : int
        How many they are.
    """

    first: int
    values: np.ndarray | None
    reason: str
    rows: int


@dataclass(frozen=True, slots=True)
class Rows:
    """The rows of an array that belong to one episode.

    Attributes
    ----------
    meta : ArrayMeta
    start, stop : int
    chunks : Chunks
    """

    meta: ArrayMeta
    start: int
    stop: int
    chunks: Chunks = field(repr=False)

    def __len__(self) -> int:
        return self.stop - self.start

    @property
    def name(self) -> str:
        """Of the array."""
        return self.meta.name

    def __iter__(self) -> Iterator[tuple[str, bytes]]:
        """Yield what makes the episode's id.

        A chunk as it is stored, where it is of this episode alone: nothing is decoded for it. Of
        chunks that hold more than one row, as those of small numbers, the rows: what episodes
        come after must not matter.
        """
        if self.meta.chunks[0] > 1:
            for block in self.blocks():
                if block.values is not None:
                    yield f"{block.first}", np.ascontiguousarray(block.values).tobytes()
            return
        for row in range(self.start, self.stop):
            for piece in self.meta.pieces():
                content = self._stored(row, piece)
                if content is not None:
                    yield ".".join(map(str, (row - self.start, *piece))), content

    def _stored(self, row: int, piece: Piece) -> bytes | None:
        try:
            return self.chunks.read(row, piece)
        except ExumiError:
            return None  # decoding says what is the matter with it

    def slice(self, first: int, stop: int) -> "Rows":
        """Return some of these rows, counted from the first of them."""
        return replace(self, start=self.start + first, stop=self.start + stop)

    def stored(self, index: int) -> bytes | None:
        """Return the chunk of a row that is one chunk, as stored; None if it cannot be read."""
        return self._stored(self.start + index, (0,) * (len(self.meta.shape) - 1))

    @property
    def is_chunk_a_row(self) -> bool:
        """Whether each row is one chunk."""
        meta = self.meta
        return meta.chunks[0] == 1 and all(
            c >= s for c, s in zip(meta.chunks[1:], meta.shape[1:], strict=True)
        )

    def blocks(self, *, channel: int | None = None, fill: bool = False) -> Iterator[Block]:
        """Yield all rows, some at a time.

        Parameters
        ----------
        channel : int, optional
            Decode this entry of the last axis alone, where it has chunks of its own; the others
            are then undefined.
        fill : bool
            Whether chunks that are not stored hold the fill value, as Zarr has it, and are not
            missing.
        """
        meta = self.meta
        rows = meta.chunks[0]
        pieces = meta.pieces()
        if channel is not None:
            pieces = [p for p in pieces if p[-1] == channel // meta.chunks[-1]]
        for number in range(self.start // rows, -(-self.stop // rows)):
            first = max(self.start, number * rows)
            count = min(self.stop, (number + 1) * rows) - first
            values, reason = self._decode(number, pieces, fill=fill)
            if values is not None:
                values = values[first - number * rows :][:count]
            yield Block(first - self.start, values, reason, count)

    def _decode(
        self, number: int, pieces: Sequence[tuple[int, ...]], *, fill: bool
    ) -> tuple[np.ndarray | None, str]:
        meta = self.meta
        whole = np.empty((meta.chunks[0], *meta.shape[1:]), meta.dtype)
        try:
            for piece in pieces:
                data = self.chunks.read(number, piece)
                if data is not None:
                    self._put(data, number, piece, whole)
                elif fill and isinstance(meta.fill_value, bool | int | float | str):
                    self._place(piece, whole)[...] = meta.fill_value
                else:
                    return None, "it is not there"
        except (ValueError, OverflowError):
            return None, f"its fill value {meta.fill_value!r} is none of {meta.dtype}"
        except LimitError:
            raise
        except ExumiError as error:
            return None, error.what
        return whole, ""

    def _put(self, data: bytes, number: int, piece: tuple[int, ...], whole: np.ndarray) -> None:
        meta = self.meta
        where = f"{meta.path} {meta.chunk_name(number, piece)}"
        if whole.shape == meta.chunks and meta.order == "C":
            decode_chunk(data, whole, meta.compressor, meta.filters, where)
            return
        shape = meta.chunks if meta.order == "C" else meta.chunks[::-1]
        chunk = np.empty(shape, meta.dtype)
        decode_chunk(data, chunk, meta.compressor, meta.filters, where)
        if meta.order == "F":
            chunk = chunk.T
        target = self._place(piece, whole)
        target[...] = chunk[tuple(slice(0, n) for n in target.shape)]

    def _place(self, piece: tuple[int, ...], whole: np.ndarray) -> np.ndarray:
        """Return the part of some rows that a chunk holds."""
        corner = [(p * c, c) for p, c in zip(piece, self.meta.chunks[1:], strict=True)]
        return whole[(slice(None), *(slice(a, a + c) for a, c in corner))]

    def read(self, *, fill: bool = False) -> np.ndarray:
        """Return all rows of an array of small numbers.

        Parameters
        ----------
        fill : bool
            See `blocks`.

        Raises
        ------
        SourceError
            A chunk is missing or damaged.
        LimitError
            They are too many.
        """
        size = len(self) * self.meta.row_bytes
        if size > MAX_CHUNK:
            raise LimitError(f"an episode of {size:,} bytes of numbers", where=self.meta.path)
        parts = []
        for block in self.blocks(fill=fill):
            if block.values is None:
                raise SourceError(
                    f"rows from {block.first} cannot be read: {block.reason}",
                    where=self.meta.path,
                    fix="Get the file again from its source.",
                )
            parts.append(block.values)
        nothing = np.empty((0, *self.meta.shape[1:]), self.meta.dtype)
        return np.concatenate([nothing, *parts])
