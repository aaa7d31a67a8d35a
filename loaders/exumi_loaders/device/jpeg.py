"""JPEG files are decoded on the device."""

from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from exumi_data.errors import DamagedDataError, MissingExtraError, UsageError
from exumi_data.store import jpeg
from exumi_loaders.buffers import BatchBuffers
from exumi_loaders.device.image_module import Batch
from exumi_loaders.device.jpeg_frames import JpegFrames

__all__ = ["DecodeJpeg"]


class DecodeJpeg(nn.Module):
    """Decode what ``decode="device"`` left as JPEG files.

    On the CPU the decoder is that of the windows, and the frames are the same, bit by bit. On CUDA
    it is nvJPEG, through torchvision; pixels differ by rounding, and at edges of colour by another
    way to enlarge chroma.

    Parameters
    ----------
    device : torch.device or str
        Where the frames are wanted.

    Raises
    ------
    MissingExtraError
        The device is a GPU, and torchvision is not installed.
    UsageError
        The device is neither a CPU nor CUDA.
    """

    def __init__(self, device: torch.device | str = "cpu") -> None:
        super().__init__()
        self.device = torch.device(device)
        self._pool = BatchBuffers()
        if self.device.type == "cuda":
            _torchvision()
        elif self.device.type != "cpu":
            raise UsageError(
                f"JPEG files cannot be decoded on {self.device.type!r}",
                fix='Decode on the CPU (decode="cpu" of the windows) and copy the frames.',
            )

    def forward(self, batch: Batch) -> Batch:
        """Decode a batch.

        Parameters
        ----------
        batch : dict
            Streams of `JpegFrames` are decoded, anything else stays.

        Returns
        -------
        dict
            With (B, K, C, H, W) uint8 in place of files, channels last in memory; frames that are
            not there are black.

        Raises
        ------
        DamagedDataError
            A file cannot be decoded.
        """
        return {
            name: self.decode(value, name) if isinstance(value, JpegFrames) else value
            for name, value in batch.items()
        }

    def decode(self, frames: JpegFrames, stream: str = "frames") -> Tensor:
        """Decode one stream.

        Parameters
        ----------
        frames : JpegFrames
        stream : str
            Its name, for errors.

        Returns
        -------
        Tensor
            (B, K, C, H, W) uint8.
        """
        files, number = frames.files()
        try:
            if self.device.type == "cpu":
                return self._on_cpu(files, number, frames.size)
            return self._on_cuda(files, number, frames.size)
        except DamagedDataError as error:
            raise DamagedDataError(error.what, where=stream) from None

    def _on_cpu(
        self, files: list[Tensor], number: np.ndarray, size: tuple[int, int, int]
    ) -> Tensor:
        buffer, out = self._pool.take((*number.shape, *size))
        flat = out.reshape(-1, *size)
        first: dict[int, int] = {}
        for position, file in enumerate(number.reshape(-1).tolist()):
            if file < 0:
                flat[position] = 0
            elif file in first:
                flat[position] = flat[first[file]]
            else:
                jpeg.decode_into(files[file].numpy().tobytes(), flat[position])
                first[file] = position
        return buffer.movedim(-1, -3)

    def _on_cuda(
        self, files: list[Tensor], number: np.ndarray, size: tuple[int, int, int]
    ) -> Tensor:
        height, width, channels = size
        out = torch.empty(
            (number.size, channels, height, width),
            dtype=torch.uint8,
            device=self.device,
            memory_format=torch.channels_last,
        ).zero_()
        if files:
            decoded = torch.stack(self._decoded(files, channels))
            if decoded.shape[1:] != out.shape[1:]:
                raise DamagedDataError(
                    f"the JPEGs are {tuple(decoded.shape[1:])}, the metadata says {size}"
                )
            there = torch.from_numpy(np.flatnonzero(number >= 0)).to(self.device)
            chosen = torch.from_numpy(number[number >= 0]).to(self.device)
            out[there] = decoded[chosen]
        return out.view(*number.shape, channels, height, width)

    def _decoded(self, files: list[Tensor], channels: int) -> list[Tensor]:
        io = _torchvision()
        mode = io.ImageReadMode.GRAY if channels == 1 else io.ImageReadMode.RGB
        try:
            decoded: list[Tensor] = io.decode_jpeg(files, mode=mode, device=self.device)
        except RuntimeError as error:
            raise DamagedDataError(f"a JPEG cannot be decoded ({error})") from None
        return decoded


def _torchvision() -> Any:
    """Return ``torchvision.io``."""
    try:
        from torchvision import io
    except ModuleNotFoundError:
        raise MissingExtraError(
            "decoding JPEG on the GPU needs torchvision",
            fix='Install it: pip install "exumi-data[gpu]"',
        ) from None
    return io
