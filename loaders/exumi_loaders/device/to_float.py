"""From uint8 to floats in [0, 1]."""

from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor

from exumi_data.errors import UsageError
from exumi_loaders.buffers import BatchBuffers
from exumi_loaders.device.image_module import ImageModule

__all__ = ["ToFloat", "need_floats"]

_AT_ONCE = 1 << 20  # numbers: 4 MB of floats, which processors have as cache for each core
_NUMPY = {torch.float32: "float32", torch.float16: "float16", torch.float64: "float64"}


def need_floats(images: Tensor, module: str) -> None:
    """Refuse images that are not floats.

    Raises
    ------
    UsageError
    """
    if not images.is_floating_point():
        raise UsageError(
            f"{module} works on floats, not {images.dtype}", fix="Apply ToFloat first."
        )


class ToFloat(ImageModule):
    """uint8 images to floats in [0, 1]: each value divided by 255.

    On the CPU the cost is memory, not arithmetic. So a few windows at a time are converted while
    they lie in the cache, into memory that is used again once a batch has been dropped: fresh
    memory of this size costs more than decoding the frames.

    Parameters
    ----------
    dtype : torch.dtype
        A floating one.
    memory : {"kept", "contiguous"}
        In which order the numbers lie in memory. The shape is (B, K, C, H, W) in both. Decoders
        write channels last, and convolutions like it so; ``contiguous`` makes it C, H, W.
    streams : sequence of str, optional
        Which; default all.

    Examples
    --------
    >>> import torch
    >>> batch = {"tactile": torch.full((2, 8, 1, 4, 4), 51, dtype=torch.uint8)}
    >>> float(ToFloat()(batch)["tactile"].max())
    0.20000000298023224
    """

    def __init__(
        self,
        *,
        dtype: torch.dtype = torch.float32,
        memory: Literal["kept", "contiguous"] = "kept",
        streams: Sequence[str] | None = None,
    ) -> None:
        super().__init__(streams)
        if not dtype.is_floating_point:
            raise UsageError(f"{dtype} is not a floating type")
        if memory not in ("kept", "contiguous"):
            raise UsageError(
                f"invalid memory ({memory!r}). Supported values are 'kept', 'contiguous'"
            )
        self.dtype = dtype
        self.memory = memory
        self._pool = BatchBuffers()

    def extra_repr(self) -> str:
        """Show the settings."""
        return f"dtype={self.dtype}, memory={self.memory!r}"

    def _change(self, frames: Tensor, reference: Tensor | None) -> tuple[Tensor, Tensor | None]:
        return self.convert(frames), None if reference is None else self.convert(reference)

    def convert(self, images: Tensor) -> Tensor:
        """Convert images.

        Parameters
        ----------
        images : Tensor
            (B, ..., C, H, W) uint8; floats are only cast.

        Returns
        -------
        Tensor
            Of the same shape.
        """
        if images.is_floating_point():
            images = images.to(self.dtype)
        elif images.device.type == "cpu" and self.dtype in _NUMPY:
            return self._in_cache(images)
        else:
            images = images.to(self.dtype).div_(255)
        return images.contiguous() if self.memory == "contiguous" else images

    def _in_cache(self, images: Tensor) -> Tensor:
        # Memory is written in the order that it has: that of decoders is (..., H, W, C).
        channels_last = images.stride(-3) <= images.stride(-1)
        keep = self.memory == "kept" and channels_last
        source = images.movedim(-3, -1) if keep else images
        kind = _NUMPY[self.dtype]
        out, _ = self._pool.take(tuple(source.shape), kind)
        count, step = len(source), max(1, _AT_ONCE * len(source) // max(1, source.numel()))
        work, _ = self._pool.take((min(step, count), *source.shape[1:]), kind)
        for start in range(0, count, step):
            few, target = source[start : start + step], out[start : start + step]
            # A strided copy of bytes is cheaper than one of floats.
            floats = work[: len(few)].copy_(_in_order(few))
            torch.div(floats, 255, out=target)
        return out.movedim(-1, -3) if keep else out


def _in_order(images: Tensor) -> Tensor:
    """Return uint8 images in the order of their axes in memory."""
    pixels = images.movedim(-3, -1)
    if images.is_contiguous() or not pixels.is_contiguous():
        return images.contiguous()
    import cv2  # several times as fast as torch at taking channels apart

    out = torch.empty(images.shape, dtype=torch.uint8)
    frames = pixels.reshape(-1, *pixels.shape[-3:]).numpy()
    planes = out.view(-1, *out.shape[-3:]).numpy()
    for frame, channels in zip(frames, planes, strict=True):
        cv2.split(frame, list(channels))
    return out
