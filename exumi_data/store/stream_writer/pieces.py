"""Streams whose samples are stored end to end."""

from pathlib import Path
from typing import Any

import numpy as np

from exumi_data.model.streams import StreamModel
from exumi_data.store.stream_writer.base import StreamWriter

__all__ = ["ByteStreamWriter", "PieceStreamWriter"]

_BYTE_CHUNK = 64 << 10


class PieceStreamWriter(StreamWriter):
    """A stream of pieces of any length: `data` end to end, and in `offset` where each ends.

    Parameters
    ----------
    folder : pathlib.Path
    name : str
    model : StreamModel
    dtype : numpy.dtype
        Of `data`.
    **layout
        Of `data`.
    """

    def __init__(
        self, folder: Path, name: str, model: StreamModel, dtype: Any, **layout: Any
    ) -> None:
        super().__init__(folder, name, model)
        self._data = self._array("data", dtype, **layout)
        self._offset = self._array("offset", np.uint64, axis="edge")
        self._end_piece()

    def _end_piece(self) -> None:
        """Note that a piece ends, and the next one begins, where `data` has come to."""
        self._offset.append(np.array([self._data.rows], np.uint64))


class ByteStreamWriter(PieceStreamWriter):
    """A stream whose pieces are files, stored byte for byte."""

    def __init__(self, folder: Path, name: str, model: StreamModel) -> None:
        super().__init__(folder, name, model, np.uint8, rows=_BYTE_CHUNK, zstd=False, axis="byte")
