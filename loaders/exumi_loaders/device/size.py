"""Other sizes: resizing, cropping, padding to a square."""

from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional

from exumi_data.errors import UsageError
from exumi_loaders.device.draws import Draws
from exumi_loaders.device.image_module import ImageModule

__all__ = ["CentreCrop", "PadToSquare", "RandomCrop", "Resize"]

Size = int | tuple[int, int]
Mode = Literal["area", "bilinear", "bicubic"]


def _pair(size: Size) -> tuple[int, int]:
    height, width = (size, size) if isinstance(size, int) else size
    if height < 1 or width < 1:
        raise UsageError(f"invalid size ({size}). It must be at least 1 pixel each way")
    return height, width


def _over_frames(images: Tensor, size: tuple[int, int], mode: Mode) -> Tensor:
    """Resize images (..., C, H, W); bytes come back as bytes."""
    flat = images.reshape(-1, *images.shape[-3:])
    floats = flat if flat.is_floating_point() else flat.float()
    smooth = {} if mode == "area" else {"antialias": True, "align_corners": False}
    done = functional.interpolate(floats, size=size, mode=mode, **smooth)
    if not flat.is_floating_point():
        done = done.round_().clamp_(0, 255).to(flat.dtype)
    return done.view(*images.shape[:-2], *size)


class Resize(ImageModule):
    """Resize images.

    Parameters
    ----------
    size : int or (int, int)
        Height and width, pixels.
    mode : {"area", "bilinear", "bicubic"}
        The last two average where an image becomes smaller (antialias). Bicubic overshoots at
        edges: floats may leave [0, 1] a little.
    streams : sequence of str, optional
        Which; default all.
    """

    def __init__(
        self, size: Size, *, mode: Mode = "bilinear", streams: Sequence[str] | None = None
    ) -> None:
        super().__init__(streams)
        self.size = _pair(size)
        if mode not in ("area", "bilinear", "bicubic"):
            raise UsageError(
                f"invalid mode ({mode!r}). Supported values are 'area', 'bilinear', 'bicubic'"
            )
        self.mode: Mode = mode

    def extra_repr(self) -> str:
        """Show the settings."""
        return f"size={self.size}, mode={self.mode!r}"

    def _change(self, frames: Tensor, reference: Tensor | None) -> tuple[Tensor, Tensor | None]:
        still = None if reference is None else _over_frames(reference, self.size, self.mode)
        return _over_frames(frames, self.size, self.mode), still


class PadToSquare(ImageModule):
    """Put images in the middle of a square.

    Parameters
    ----------
    value : float
        What the margin is filled with.
    streams : sequence of str, optional
        Which; default all.
    """

    def __init__(self, value: float = 0.0, *, streams: Sequence[str] | None = None) -> None:
        super().__init__(streams)
        self.value = value

    def _change(self, frames: Tensor, reference: Tensor | None) -> tuple[Tensor, Tensor | None]:
        return self._pad(frames), None if reference is None else self._pad(reference)

    def _pad(self, images: Tensor) -> Tensor:
        height, width = images.shape[-2:]
        side = max(height, width)
        top, left = (side - height) // 2, (side - width) // 2
        margins = (left, side - width - left, top, side - height - top)
        return functional.pad(images, margins, value=self.value)


def _check_fits(size: tuple[int, int], images: Tensor) -> tuple[int, int]:
    """Return by how much images are larger than a crop."""
    spare = images.shape[-2] - size[0], images.shape[-1] - size[1]
    if min(spare) < 0:
        raise UsageError(f"a crop of {size} of images of {tuple(images.shape[-2:])}")
    return spare


class CentreCrop(ImageModule):
    """Cut the middle out.

    Parameters
    ----------
    size : int or (int, int)
        Height and width, pixels.
    streams : sequence of str, optional
        Which; default all.
    """

    def __init__(self, size: Size, *, streams: Sequence[str] | None = None) -> None:
        super().__init__(streams)
        self.size = _pair(size)

    def extra_repr(self) -> str:
        """Show the settings."""
        return f"size={self.size}"

    def _change(self, frames: Tensor, reference: Tensor | None) -> tuple[Tensor, Tensor | None]:
        spare = _check_fits(self.size, frames)
        top, left = spare[0] // 2, spare[1] // 2
        box = (..., slice(top, top + self.size[0]), slice(left, left + self.size[1]))
        return frames[box], None if reference is None else reference[box]


class RandomCrop(ImageModule):
    """Cut a rectangle out at a random place, the same in all frames of a window and stream.

    Parameters
    ----------
    size : int or (int, int)
        Height and width, pixels.
    seed : int
    streams : sequence of str, optional
        Which; default all.
    """

    def __init__(self, size: Size, *, seed: int = 0, streams: Sequence[str] | None = None) -> None:
        super().__init__(streams)
        self.draws = Draws(seed)
        self.size = _pair(size)

    def extra_repr(self) -> str:
        """Show the settings."""
        return f"size={self.size}"

    def _change(self, frames: Tensor, reference: Tensor | None) -> tuple[Tensor, Tensor | None]:
        height, width = self.size
        spare = _check_fits(self.size, frames)
        tops = self.draws.integers(len(frames), spare[0] + 1)
        lefts = self.draws.integers(len(frames), spare[1] + 1)

        def cut(images: Tensor) -> Tensor:
            return torch.stack(
                [
                    image[..., top : top + height, left : left + width]
                    for image, top, left in zip(images, tops, lefts, strict=True)
                ]
            )

        return cut(frames), None if reference is None else cut(reference)
