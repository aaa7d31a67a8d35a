"""Gaussian blur."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from exumi_data.errors import UsageError
from exumi_loaders.device.draws import Draws
from exumi_loaders.device.image_module import ImageModule
from exumi_loaders.device.to_float import need_floats

__all__ = ["Blur"]


class Blur(ImageModule):
    """Blur images with a Gaussian, alike in all frames of a window and stream.

    Parameters
    ----------
    sigma_px : (float, float)
        The standard deviation is drawn between these, pixels; the kernel ends at three of the
        largest. Edges are reflected.
    p : float
        Probability that a window is blurred at all.
    seed : int
    streams : sequence of str, optional
        Which; default all.
    """

    def __init__(
        self,
        sigma_px: tuple[float, float] = (0.1, 2.0),
        *,
        p: float = 0.5,
        seed: int = 0,
        streams: Sequence[str] | None = None,
    ) -> None:
        super().__init__(streams)
        self.draws = Draws(seed)
        if not 0 < sigma_px[0] <= sigma_px[1]:
            raise UsageError(f"invalid sigma_px {sigma_px}. Both are positive, the larger last")
        if not 0 <= p <= 1:
            raise UsageError(f"invalid p ({p}). It must lie between 0 and 1")
        self.sigma_px = sigma_px
        self.p = p

    def extra_repr(self) -> str:
        """Show the settings."""
        return f"sigma_px={self.sigma_px}, p={self.p}"

    def _change(self, frames: Tensor, reference: Tensor | None) -> tuple[Tensor, Tensor | None]:
        need_floats(frames, "Blur")
        blurred = self.draws.uniform(len(frames), 0, 1) < self.p
        sigma = self.draws.uniform(len(frames), *self.sigma_px)
        kernels = _kernels(sigma, math.ceil(3 * self.sigma_px[1])).to(frames)
        which = blurred.tolist()

        def changed(images: Tensor) -> Tensor:
            # Window by window: one kernel for all of its frames, and nothing for the others.
            out = torch.empty_like(images)
            for window, target, kernel, chosen in zip(images, out, kernels, which, strict=True):
                target.copy_(_blurred(window, kernel) if chosen else window)
            return out

        return changed(frames), None if reference is None else changed(reference)


def _kernels(sigma: Tensor, radius: int) -> Tensor:
    """Gaussians (B, 2·radius + 1) whose sum is 1."""
    away = torch.arange(-radius, radius + 1) / sigma[:, None]
    return torch.softmax(-0.5 * away.square(), dim=1)


def _blurred(images: Tensor, kernel: Tensor) -> Tensor:
    """Blur (..., C, H, W) across and down."""
    height, width = images.shape[-2:]
    radius = len(kernel) // 2
    if radius >= min(height, width):
        raise UsageError(f"a blur that reaches {radius} px in images of {(height, width)}")
    flat = images.reshape(-1, 1, height, width)
    across = functional.pad(flat, (radius, radius, 0, 0), mode="reflect")
    flat = functional.conv2d(across, kernel.view(1, 1, 1, -1))
    down = functional.pad(flat, (0, 0, radius, radius), mode="reflect")
    return functional.conv2d(down, kernel.view(1, 1, -1, 1)).view(images.shape)
