"""Brightness, contrast, saturation and hue."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from exumi_data.errors import UsageError
from exumi_loaders.device.draws import Draws
from exumi_loaders.device.image_module import ImageModule, per_window
from exumi_loaders.device.to_float import need_floats

__all__ = ["ColourJitter"]

_LUMA = (0.299, 0.587, 0.114)
# YIQ: hue is an angle in the plane of the last two, so that turning it is linear.
_TO_YIQ = (_LUMA, (0.595716, -0.274453, -0.321263), (0.211456, -0.522591, 0.311135))


class ColourJitter(ImageModule):
    """Change brightness, contrast, saturation and hue, alike in all frames of a window and stream.

    The whole change is one affine map of colours for each window, so that differences between a
    frame and its reference stay what they are but for a factor; it is clamped to [0, 1] once, at
    its end. Contrast is changed about the mean luma of the window's frames. Hue is turned in YIQ.
    Grey images only change in brightness and contrast.

    Parameters
    ----------
    brightness, contrast, saturation : float
        Factors are drawn from [1 − value, 1 + value). The defaults are Octopi-1.5's.
    hue : float
        The turn is drawn from [−hue, hue) of the whole circle; at most 0.5.
    seed : int
    streams : sequence of str, optional
        Which; default all.
    """

    def __init__(  # keyword-only options, each with a default
        self,
        *,
        brightness: float = 0.2,
        contrast: float = 0.2,
        saturation: float = 0.1,
        hue: float = 0.02,
        seed: int = 0,
        streams: Sequence[str] | None = None,
    ) -> None:
        super().__init__(streams)
        self.draws = Draws(seed)
        strengths = {"brightness": brightness, "contrast": contrast, "saturation": saturation}
        for name, value in strengths.items():
            if not 0 <= value <= 1:
                raise UsageError(f"invalid {name} ({value}). It must lie between 0 and 1")
        if not 0 <= hue <= 0.5:
            raise UsageError(f"invalid hue ({hue}). It must lie between 0 and 0.5")
        self.brightness, self.contrast, self.saturation = brightness, contrast, saturation
        self.hue = hue

    def extra_repr(self) -> str:
        """Show the settings."""
        return (
            f"brightness={self.brightness}, contrast={self.contrast}, "
            f"saturation={self.saturation}, hue={self.hue}"
        )

    def _change(self, frames: Tensor, reference: Tensor | None) -> tuple[Tensor, Tensor | None]:
        need_floats(frames, "ColourJitter")
        count = len(frames)
        brightness = self.draws.uniform(count, 1 - self.brightness, 1 + self.brightness)
        contrast = self.draws.uniform(count, 1 - self.contrast, 1 + self.contrast)
        colours = _colour_maps(
            self.draws.uniform(count, 1 - self.saturation, 1 + self.saturation),
            self.draws.uniform(count, -self.hue, self.hue) * (2 * math.pi),
        )
        factor = brightness * contrast
        # c·b·x + (1 − c)·mean(b·x)
        mean = _mean_luma(frames)
        shift = per_window(brightness * (1 - contrast), mean) * mean

        def changed(images: Tensor) -> Tensor:
            if images.shape[-3] == 3:
                maps = (colours * factor.view(-1, 1, 1)).to(images)
                images = torch.einsum("bij,b...jhw->b...ihw", maps, images)
            else:
                images = images * per_window(factor, images)
            return images.add_(per_window(shift, images)).clamp_(0, 1)

        return changed(frames), None if reference is None else changed(reference)


def _mean_luma(frames: Tensor) -> Tensor:
    """Mean luma of each window, (B,)."""
    means = frames.mean(dim=(1, 3, 4))
    if frames.shape[2] == 1:
        return means[:, 0]
    return (means * torch.tensor(_LUMA).to(means)).sum(dim=1)


def _colour_maps(saturation: Tensor, angle: Tensor) -> Tensor:
    """Matrices (B, 3, 3) that scale and turn colour and leave luma."""
    to_yiq = torch.tensor(_TO_YIQ)
    turn = torch.zeros(len(angle), 3, 3)
    turn[:, 0, 0] = 1
    turn[:, 1, 1] = turn[:, 2, 2] = saturation * angle.cos()
    turn[:, 2, 1] = saturation * angle.sin()
    turn[:, 1, 2] = -turn[:, 2, 1]
    back: Tensor = torch.linalg.inv(to_yiq)
    return back @ turn @ to_yiq
