"""Image streams of JPEG files."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from exumi_data.errors import DamagedDataError, UsageError
from exumi_data.model.images import EncodedImages
from exumi_data.model.streams import RgbStream, TactileStream
from exumi_data.store import jpeg
from exumi_data.store.shards import Bytes, crc32c
from exumi_data.store.stream_writer.pieces import ByteStreamWriter

__all__ = ["EncodedStreamWriter"]


class EncodedStreamWriter(ByteStreamWriter):
    """An image stream stored as ``encoded``: JPEG files verbatim, end to end."""

    def __init__(self, folder: Path, name: str, model: RgbStream | TactileStream) -> None:
        super().__init__(folder, name, model)
        self._images: EncodedImages = model.images  # type: ignore[assignment]  # the factory saw to it
        self._crc = self._array("crc32c", np.uint32)

    def append(
        self,
        time: Any,
        encoded: bytes | Sequence[bytes],
        *,
        time_host: Any = None,
        time_device: Any = None,
        sequence: Any = None,
        flags: Any = None,
    ) -> None:
        """Append the file of one frame, or of several.

        Parameters
        ----------
        time : int or (n,) int64
            Nanoseconds since the episode's start, strictly increasing.
        encoded : bytes or sequence of bytes
            JPEG files, stored as they are.
        time_host, time_device, sequence, flags : int or (n,), optional

        Raises
        ------
        UsageError
            A file is no JPEG of the declared size, or times do not increase.
            Nothing was appended.
        """
        files = [encoded] if isinstance(encoded, Bytes) else list(encoded)
        expected = (self._images.height, self._images.width, self._images.channels)
        for index, file in enumerate(files):
            self._check_file(file, self.count + index, expected)
        columns = self._checked(
            time,
            {
                "time_host": time_host,
                "time_device": time_device,
                "sequence": sequence,
                "flags": flags,
            },
            count=len(files),
            what="frames",
        )
        with self._appending(columns):
            for file in files:
                self._data.append_bytes(file)
                self._end_piece()
            self._crc.append(np.array([crc32c(file) for file in files], dtype=np.uint32))

    def _check_file(self, file: bytes, index: int, expected: tuple[int, int, int]) -> None:
        try:
            size = jpeg.size_of(file)
        except DamagedDataError as error:
            raise UsageError(f"frame {index}: {error.what}", where=self.name) from None
        if size != expected:
            raise UsageError(
                f"frame {index} is {size} (height, width, channels), expected {expected}",
                where=self.name,
            )
