"""The network of a small diffusion over vectors; its schedule is that of `tpp.diffusion`."""

import math

import torch
from torch import Tensor, nn
from tpp.diffusion import add_noise, denoise

__all__ = ["Denoiser"]

_TIME = 32


class _Block(nn.Module):
    """A residual perceptron that is scaled and shifted by what is known."""

    def __init__(self, width: int, known: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.modulate = nn.Linear(known, 2 * width)
        self.layers = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))

    def forward(self, value: Tensor, known: Tensor) -> Tensor:
        scale, shift = self.modulate(known).chunk(2, dim=-1)
        return torch.as_tensor(value + self.layers(self.norm(value) * (1 + scale) + shift))


class Denoiser(nn.Module):
    """Draws vectors, given a context. It estimates the clean vector.

    Parameters
    ----------
    size : int
        Length of a vector.
    context : int
        Length of what it is given.
    width, depth : int
        Of the network.
    """

    def __init__(self, size: int, context: int, width: int = 256, depth: int = 3) -> None:
        super().__init__()
        self.size = size
        self.know = nn.Sequential(nn.Linear(_TIME + context, width), nn.SiLU())
        self.enter = nn.Linear(size, width)
        self.blocks = nn.ModuleList(_Block(width, width) for _ in range(depth))
        self.leave = nn.Linear(width, size)

    def forward(self, noisy: Tensor, time: Tensor, context: Tensor) -> Tensor:
        """Estimate clean vectors.

        Parameters
        ----------
        noisy : Tensor
            (B, size).
        time : Tensor
            (B,) in [0, 1]: 0 is clean, 1 is noise.
        context : Tensor
            (B, context).
        """
        known = self.know(torch.cat((_waves(time), context), dim=-1))
        value = self.enter(noisy)
        for block in self.blocks:
            value = block(value, known)
        return torch.as_tensor(self.leave(value))

    def error(self, clean: Tensor, context: Tensor) -> Tensor:
        """Return the squared errors (B, size) of estimates at random times."""
        time = torch.rand(len(clean), device=clean.device)
        noisy = add_noise(clean, torch.randn_like(clean), time)
        return torch.as_tensor((self(noisy, time, context) - clean).square())

    @torch.no_grad()
    def draw(self, context: Tensor, steps: int = 8) -> Tensor:
        """Draw vectors (B, size), from noise in a few steps."""
        noise = torch.randn(len(context), self.size, device=context.device)
        return denoise(lambda noisy, time: self(noisy, time, context), noise, steps)


def _waves(time: Tensor) -> Tensor:
    rates = torch.exp(torch.linspace(0, math.log(100), _TIME // 2, device=time.device))
    angles = time[:, None] * rates
    return torch.cat((angles.sin(), angles.cos()), dim=-1)
