"""Adding noise to latents, and taking it out again: the cosine schedule, deterministic steps."""

import math
from collections.abc import Callable
from itertools import pairwise

import torch
from torch import Tensor

__all__ = ["add_noise", "denoise"]


def _schedule(time: Tensor) -> tuple[Tensor, Tensor]:
    """Return the shares of signal and noise at times in [0, 1]; their squares sum up to 1."""
    angle = time * (math.pi / 2)
    return angle.cos(), angle.sin()


def add_noise(clean: Tensor, noise: Tensor, time: Tensor) -> Tensor:
    """Mix clean latents with noise.

    Parameters
    ----------
    clean, noise : Tensor
        (B, ...).
    time : Tensor
        (B,) in [0, 1]: 0 is clean, 1 is noise.
    """
    signal, spread = (share.view(-1, *[1] * (clean.ndim - 1)) for share in _schedule(time))
    return signal * clean + spread * noise


def denoise(predict: Callable[[Tensor, Tensor], Tensor], noise: Tensor, steps: int) -> Tensor:
    """Draw latents, starting from noise (DDIM without added noise).

    Parameters
    ----------
    predict : callable
        From noisy latents (B, ...) and times (B,) to an estimate of the clean ones.
    noise : Tensor
        (B, ...), standard normal.
    steps : int
        Evaluations of `predict`.
    """
    noisy = noise
    clean = noise
    times = torch.linspace(1, 0, steps + 1, device=noise.device)
    for now, then in pairwise(times):
        clean = predict(noisy, now.expand(len(noise)))
        signal, spread = _schedule(now)
        rest = (noisy - signal * clean) / spread
        signal, spread = _schedule(then)
        noisy = signal * clean + spread * rest
    return clean
