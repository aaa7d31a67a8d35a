"""A small diffusion over vectors: a network that takes noise out, and the two ends of it."""

import math
from itertools import pairwise

import torch
from torch import Tensor, nn

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
    """Draws vectors, given a context. It estimates the clean vector; the schedule is a cosine.

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
        signal, spread = _shares(time[:, None])
        noisy = signal * clean + spread * torch.randn_like(clean)
        return torch.as_tensor((self(noisy, time, context) - clean).square())

    @torch.no_grad()
    def draw(self, context: Tensor, steps: int = 8) -> Tensor:
        """Draw vectors (B, size), from noise in a few deterministic steps (DDIM)."""
        noisy = clean = torch.randn(len(context), self.size, device=context.device)
        for now, then in pairwise(torch.linspace(1, 0, steps + 1, device=context.device)):
            clean = self(noisy, now.expand(len(noisy)), context)
            signal, spread = _shares(now)
            rest = (noisy - signal * clean) / spread
            signal, spread = _shares(then)
            noisy = signal * clean + spread * rest
        return clean


def _shares(time: Tensor) -> tuple[Tensor, Tensor]:
    """Return the shares of signal and noise; their squares sum up to 1."""
    angle = time * (math.pi / 2)
    return angle.cos(), angle.sin()


def _waves(time: Tensor) -> Tensor:
    rates = torch.exp(torch.linspace(0, math.log(100), _TIME // 2, device=time.device))
    angles = time[:, None] * rates
    return torch.cat((angles.sin(), angles.cos()), dim=-1)
