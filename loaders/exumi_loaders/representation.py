"""The tactile representation of exUMI as a torch module."""

import torch
from torch import Tensor, nn

__all__ = ["TactileRepresentation"]


class TactileRepresentation(nn.Module):
    """Grey, convex and concave channels of a tactile image (exUMI, section on TPP).

    ``convex = gain·max(grey − reference, 0)`` and ``concave = gain·max(reference − grey, 0)``,
    each clamped to [0, 1]: never wrapped, as 8-bit arithmetic would.

    Parameters
    ----------
    gain : float
        7 in exUMI.

    Examples
    --------
    >>> import torch
    >>> frames = torch.full((2, 8, 1, 4, 4), 100, dtype=torch.uint8)
    >>> TactileRepresentation()(frames, frames[:, 0]).shape
    torch.Size([2, 8, 3, 4, 4])
    """

    weights: Tensor

    def __init__(self, gain: float = 7.0) -> None:
        super().__init__()
        self.gain = gain
        # BT.601 luma, as in the definition of the grey frame.
        self.register_buffer(
            "weights", torch.tensor([0.299, 0.587, 0.114]).view(3, 1, 1), persistent=False
        )

    def extra_repr(self) -> str:
        """Show the gain."""
        return f"gain={self.gain}"

    def grey(self, images: Tensor) -> Tensor:
        """Turn images into grey.

        Parameters
        ----------
        images : Tensor
            uint8 (..., 1|3, H, W).

        Returns
        -------
        Tensor
            float32 (..., H, W) in [0, 1].
        """
        if images.shape[-3] == 1:
            return images.squeeze(-3).float().div_(255)
        return (images.float() * self.weights).sum(-3).div_(255)

    def forward(self, frames: Tensor, reference: Tensor) -> Tensor:
        """Compute the representation on the tensors' device.

        Parameters
        ----------
        frames : Tensor
            uint8 (..., K, C, H, W): K frames a window, C = 1 or 3 (RGB).
        reference : Tensor
            uint8 (..., C, H, W): the image without contact, one a window.

        Returns
        -------
        Tensor
            float32 (..., K, 3, H, W): grey, convex, concave, each in [0, 1].
        """
        grey = self.grey(frames)
        difference = (grey - self.grey(reference).unsqueeze(-3)).mul_(self.gain)
        convex = difference.clamp(0, 1)
        concave = difference.neg_().clamp_(0, 1)
        return torch.stack((grey, convex, concave), dim=-3)
