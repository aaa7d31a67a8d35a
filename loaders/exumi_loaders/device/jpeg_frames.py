"""JPEG files in place of images: what leaves the windows undecoded."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

__all__ = ["JpegFrames", "pack_files"]


@dataclass(frozen=True)
class JpegFrames:
    """The frames of one stream of a batch, as JPEG files.

    Attributes
    ----------
    data : Tensor
        (N,) uint8: files end to end. On the CPU: decoders read them there.
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


def pack_files(files: np.ndarray, size: tuple[int, ...]) -> JpegFrames:
    """Lay the files of one stream of a batch end to end.

    Parameters
    ----------
    files : (B, K) array of bytes or None
        None is no frame. The same object at several places is one file.
    size : (int, int, int)
        Height, width and channels of a decoded frame.

    Returns
    -------
    JpegFrames
    """
    spans: dict[int, tuple[int, int]] = {}
    distinct: list[bytes] = []
    span = np.zeros((files.size, 2), dtype=np.int64)
    end = 0
    for position, data in enumerate(files.flat):
        if data is None:
            continue
        if id(data) not in spans:
            spans[id(data)] = (end, end + len(data))
            distinct.append(data)
            end += len(data)
        span[position] = spans[id(data)]
    # A tensor of no bytes cannot be made of a buffer.
    joined = torch.frombuffer(bytearray(b"".join(distinct)) or bytearray(1), dtype=torch.uint8)
    height, width, channels = size
    return JpegFrames(
        joined[:end], torch.from_numpy(span.reshape(*files.shape, 2)), (height, width, channels)
    )
