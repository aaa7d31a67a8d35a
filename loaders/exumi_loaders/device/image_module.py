"""What the modules share: which tensors of a batch are images, and how they are changed."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from torch import Tensor, nn

from exumi_data.errors import UsageError
from exumi_loaders.device.jpeg_frames import JpegFrames

__all__ = ["Batch", "ImageModule", "image_streams", "per_window"]

Batch = dict[str, Any]
"""A batch as the loaders give it: tensors by name."""

_REFERENCE = "_reference"


def image_streams(batch: Batch, streams: Sequence[str] | None = None) -> list[str]:
    """Name the image streams of a batch: (B, K, C, H, W) with 1 or 3 channels.

    Parameters
    ----------
    batch : dict
    streams : sequence of str, optional
        Only these.

    Returns
    -------
    list of str

    Raises
    ------
    UsageError
        A named stream is not there, holds no images, or is not decoded yet.
    """
    for name, value in batch.items():
        if isinstance(value, JpegFrames):
            raise UsageError(f"{name!r} holds JPEG files", fix="Apply DecodeJpeg first.")
    if streams is None:
        return [name for name, value in batch.items() if _are_images(value)]
    for name in streams:
        if not _are_images(batch.get(name)):
            raise UsageError(
                f"the batch has no images {name!r} of shape (B, K, 1|3, H, W)",
                fix=f"It has {', '.join(map(repr, image_streams(batch))) or 'none'}.",
            )
    return list(streams)


def _are_images(value: object) -> bool:
    return isinstance(value, Tensor) and value.ndim == 5 and value.shape[2] in (1, 3)


def per_window(values: Tensor, images: Tensor) -> Tensor:
    """Bring one number a window, (B,), to the device and number of axes of its images."""
    shape = (-1, *[1] * (images.ndim - 1))
    return values.to(device=images.device, dtype=images.dtype, non_blocking=True).view(shape)


class ImageModule(nn.Module, ABC):
    """A module that changes the image streams of a batch, with their references.

    Parameters
    ----------
    streams : sequence of str, optional
        Which; default all.
    """

    def __init__(self, streams: Sequence[str] | None = None) -> None:
        super().__init__()
        self.streams = None if streams is None else tuple(streams)

    def forward(self, batch: Batch) -> Batch:
        """Change the images of a batch.

        Parameters
        ----------
        batch : dict
            As the loaders give it; it is not changed.

        Returns
        -------
        dict
            The same tensors, but for the images and their references.
        """
        changed = dict(batch)
        for name in image_streams(batch, self.streams):
            reference = batch.get(name + _REFERENCE)
            frames, still = self.transform(batch[name], reference)
            changed[name] = frames
            if still is not None:
                changed[name + _REFERENCE] = still
        return changed

    def transform(
        self, frames: Tensor, reference: Tensor | None = None
    ) -> tuple[Tensor, Tensor | None]:
        """Change the frames of one stream and their reference alike.

        Parameters
        ----------
        frames : Tensor
            (B, K, C, H, W).
        reference : Tensor, optional
            (B, C, H, W).

        Returns
        -------
        (Tensor, Tensor or None)
        """
        return self._change(frames, reference)

    @abstractmethod
    def _change(self, frames: Tensor, reference: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """Do what `transform` says."""
