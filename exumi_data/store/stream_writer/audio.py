"""Streams of sound."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from exumi_data.errors import UsageError
from exumi_data.model.streams import AudioStream
from exumi_data.store.stream_writer.pieces import PieceStreamWriter

__all__ = ["AudioStreamWriter"]


class AudioStreamWriter(PieceStreamWriter):
    """Sound: blocks end to end, each with the time of its first sample."""

    def __init__(self, folder: Path, name: str, model: AudioStream) -> None:
        self._channels = model.channels
        row_shape, names = (model.channels,), ("channel",)
        super().__init__(
            folder, name, model, np.int16, row_shape=row_shape, names=names, axis="sample"
        )

    def append(
        self,
        time: Any,
        blocks: np.ndarray | Sequence[np.ndarray],
        *,
        time_host: Any = None,
        time_device: Any = None,
        sequence: Any = None,
        flags: Any = None,
    ) -> None:
        """Append one block, or several.

        Parameters
        ----------
        time : int or (n,) int64
            Nanoseconds since the episode's start of each block's first sample, strictly increasing.
        blocks : (S, channels) int16 or sequence of such
            None of them empty.
        time_host, time_device, sequence, flags : int or (n,), optional
            Of each block; see the standard, section Time.

        Raises
        ------
        UsageError
            A block is no sound of the declared channels, or times do not increase.
            Nothing was appended.
        """
        given = [blocks] if np.ndim(time) == 0 else list(blocks)
        sound = [self._checked_block(block, self.count + i) for i, block in enumerate(given)]
        columns = self._checked(
            time,
            {
                "time_host": time_host,
                "time_device": time_device,
                "sequence": sequence,
                "flags": flags,
            },
            count=len(sound),
            what="blocks",
        )
        with self._appending(columns):
            for block in sound:
                self._data.append(block)
                self._end_piece()

    def _checked_block(self, block: Any, index: int) -> np.ndarray:
        values = np.asarray(block)
        fits = values.ndim == 2 and values.shape[1] == self._channels and len(values)
        if values.dtype != np.int16 or not fits:
            raise UsageError(
                f"block {index} is {values.shape} {values.dtype}, expected "
                f"(samples, {self._channels}) int16",
                where=self.name,
            )
        return values
