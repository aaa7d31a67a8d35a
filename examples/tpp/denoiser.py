"""A small diffusion transformer over tactile, action and image tokens."""

import math

import torch
from torch import Tensor, nn

__all__ = ["Denoiser"]


class _Block(nn.Module):
    """Attention and a perceptron, both modulated by the time of the diffusion (DiT)."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm_1 = nn.LayerNorm(width, elementwise_affine=False)
        self.norm_2 = nn.LayerNorm(width, elementwise_affine=False)
        self.mix = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.perceptron = nn.Sequential(
            nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width)
        )
        self.modulate = nn.Linear(width, 6 * width)
        # Blocks begin as the identity: training starts gently.
        nn.init.zeros_(self.modulate.weight)
        nn.init.zeros_(self.modulate.bias)

    def forward(self, tokens: Tensor, time: Tensor) -> Tensor:
        batch, count, width = tokens.shape
        shift_1, scale_1, gate_1, shift_2, scale_2, gate_2 = (
            self.modulate(time).unsqueeze(1).chunk(6, dim=-1)
        )
        inner = self.norm_1(tokens) * (1 + scale_1) + shift_1
        split = self.mix(inner).view(batch, count, 3, self.heads, -1).permute(2, 0, 3, 1, 4)
        seen = nn.functional.scaled_dot_product_attention(split[0], split[1], split[2])
        tokens = tokens + gate_1 * self.out(seen.transpose(1, 2).reshape(batch, count, width))
        inner = self.norm_2(tokens) * (1 + scale_2) + shift_2
        return torch.as_tensor(tokens + gate_2 * self.perceptron(inner))


class Denoiser(nn.Module):
    """Estimates clean latents of the future from noisy ones and what they are conditioned on.

    Parameters
    ----------
    latent : int
        Length D of a latent vector.
    frames : int
        Frames H of the history.
    width, depth, heads : int
        Of the transformer.
    """

    def __init__(self, latent: int, frames: int, width: int, depth: int, heads: int) -> None:
        super().__init__()
        self.latent, self.width = latent, width
        self.enter = nn.Linear(latent, width)
        self.time = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.blocks = nn.ModuleList(_Block(width, heads) for _ in range(depth))
        self.norm = nn.LayerNorm(width)
        self.leave = nn.Linear(width, latent + frames)

    def forward(
        self, noisy: Tensor, time: Tensor, *, places: Tensor, context: Tensor, history: Tensor
    ) -> Tensor:
        """Estimate the clean latents: a mixture of those of the history, and what is new.

        Parameters
        ----------
        noisy : Tensor
            (B, N, D).
        time : Tensor
            (B,) in [0, 1].
        places : Tensor
            (B, N, width): of which step each of them is.
        context : Tensor
            (B, M, width): tokens of history, actions and images.
        history : Tensor
            (B, H, D): latents of the history, zero where it is not seen.

        Returns
        -------
        Tensor
            (B, N, D).
        """
        tokens = torch.cat((self.enter(noisy) + places, context), dim=1)
        when = nn.functional.silu(self.time(_waves(time, self.width)))
        for block in self.blocks:
            tokens = block(tokens, when)
        left = self.leave(self.norm(tokens[:, : noisy.shape[1]]))
        new, shares = left.split([self.latent, history.shape[1]], dim=-1)
        return torch.as_tensor(new + shares @ history)


def _waves(time: Tensor, width: int) -> Tensor:
    """Return sines and cosines of times in [0, 1], (B, width)."""
    half = torch.arange(width // 2, device=time.device)
    rates = torch.exp(half * (math.log(1000) / (width // 2)))
    angles = time[:, None] * rates
    return torch.cat((angles.sin(), angles.cos()), dim=-1)
