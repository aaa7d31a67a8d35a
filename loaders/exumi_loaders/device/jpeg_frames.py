"""JPEG files in place of images: what leaves the windows undecoded."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from exumi_data.store import jpeg
from exumi_data.store.images import Frames

__all__ = ["JpegFrames", "JpegPacker"]


@dataclass(frozen=True)
class JpegFrames:
    """The frames of one stream of a batch, as JPEG files.

    Attributes
    ----------
    data : Tensor
        (N,) uint8: files end to end, each once. On the CPU: decoders read them there.
    span : Tensor
        (B, K, 2) int64: where the file of each frame begins and ends. Equal: there is no frame.
    size : (int, int, int)
        Height, width and channels of a decoded frame; one channel asks for luma.
    """

    data: Tensor
    span: Tensor
    size: tuple[int, int, int]

    def __len__(self) -> int:
        return len(self.span)

    def __getitem__(self, window: int) -> "JpegFrames":
        """Return the frames of one window; ``span`` is (K, 2) then."""
        return JpegFrames(self.data, self.span[window], self.size)

    def files(self) -> tuple[list[Tensor], np.ndarray]:
        """Return the distinct files, and for each frame its file's number or -1.

        Returns
        -------
        files : list of Tensor
            Each (n,) uint8, a view of `data`.
        number : (B, K) int64
        """
        span = self.span.numpy()
        there = span[..., 0] < span[..., 1]
        distinct, number = np.unique(span[there], axis=0, return_inverse=True)
        numbers = np.full(there.shape, -1, dtype=np.int64)
        numbers[there] = number.reshape(-1)
        return [self.data[start:stop] for start, stop in distinct.tolist()], numbers


class JpegPacker:
    """Collect the files of one stream of a batch.

    Parameters
    ----------
    shape : (int, int)
        Windows of the batch, frames of a window.
    size : (int, int, int)
        Height, width and channels of a decoded frame.
    """

    def __init__(self, shape: tuple[int, ...], size: tuple[int, int, int]) -> None:
        self._size = size
        self._files: list[bytes] = []
        self._spans: dict[tuple[int, int], tuple[int, int]] = {}
        self._end = 0
        self._span = np.zeros((*shape, 2), dtype=np.int64)

    def add(self, window: int, episode: int, source: Frames, wanted: Sequence[int]) -> None:
        """Add the frames of a window; an index below 0 is no frame.

        Raises
        ------
        DamagedDataError
            A file is not what the metadata says, or its checksum is wrong.
        """
        for position, index in enumerate(wanted):
            if index < 0:
                continue
            key = (episode, index)
            if key not in self._spans:
                data = source.file(index)
                # Here and not later: a decoder takes as much memory as a file claims to need.
                jpeg.check(data, self._size[:2])
                self._spans[key] = (self._end, self._end + len(data))
                self._files.append(data)
                self._end += len(data)
            self._span[window, position] = self._spans[key]

    def packed(self) -> JpegFrames:
        """Return what was added."""
        data = torch.frombuffer(bytearray(b"".join(self._files)) or bytearray(1), dtype=torch.uint8)
        return JpegFrames(data[: self._end], torch.from_numpy(self._span), self._size)
