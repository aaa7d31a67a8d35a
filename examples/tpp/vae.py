"""A variational autoencoder of tactile images: what the diffusion works on."""

import torch
from torch import Tensor, nn

__all__ = ["TactileVAE"]

_PATCH = 16  # pixels that both convolutions reduce to one
_QUIET = -5.0  # log variance to begin with: the noise must not drown what is not yet learnt


class TactileVAE(nn.Module):
    """Tactile images to latent vectors and back.

    Parameters
    ----------
    average : Tensor
        (C, side, side): the mean image, with the channels grey, convex and concave of each finger;
        side is a multiple of 16.
    contrast : Tensor
        () or (C, 1, 1): the spread of images about it.
    latent : int
        Length D of a latent vector.
    width : int
        Channels of the first convolution.
    """

    average: Tensor
    contrast: Tensor
    followed: Tensor
    shift: Tensor
    scale: Tensor

    def __init__(self, average: Tensor, contrast: Tensor, latent: int, width: int) -> None:
        super().__init__()
        channels, side, _ = average.shape
        rows, deep = side // _PATCH, 4 * width
        self.register_buffer("average", average)
        self.register_buffer("contrast", contrast)
        last = nn.Linear(deep * rows * rows, 2 * latent)
        with torch.no_grad():
            last.bias[latent:] = _QUIET
        self.encoder = nn.Sequential(
            nn.Conv2d(channels, width, 4, stride=4),
            nn.SiLU(),
            nn.Conv2d(width, deep, 4, stride=4),
            nn.SiLU(),
            nn.Flatten(),
            last,
        )
        self.decoder = nn.Sequential(
            nn.Linear(latent, deep * rows * rows),
            nn.Unflatten(1, (deep, rows, rows)),
            nn.SiLU(),
            nn.ConvTranspose2d(deep, width, 4, stride=4),
            nn.SiLU(),
            nn.ConvTranspose2d(width, channels, 4, stride=4),
        )
        # Mean and spread of the latents, followed while training: diffusion wants about (0, 1).
        self.register_buffer("followed", torch.zeros(()))
        self.register_buffer("shift", torch.zeros(latent))
        self.register_buffer("scale", torch.ones(()))

    def encode(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Encode images (N, C, side, side) into mean and log variance, (N, D) both."""
        seen = self.encoder((images - self.average) / self.contrast)
        mean, log_variance = seen.chunk(2, dim=-1)
        return mean, log_variance.clamp(-12, 4)

    def decode(self, latents: Tensor) -> Tensor:
        """Decode latents (N, D) into images (N, C, side, side)."""
        return torch.as_tensor(self.average + self.contrast * self.decoder(latents))

    def normalise(self, latents: Tensor) -> Tensor:
        """Shift and scale latents (..., D) to about zero mean and unit spread."""
        return (latents - self.shift) / self.scale

    def restore(self, latents: Tensor) -> Tensor:
        """Undo `normalise`."""
        return latents * self.scale + self.shift

    @torch.no_grad()
    def follow(self, latents: Tensor, slowest: float = 0.05) -> None:
        """Let shift and scale follow the latents (N, D) of a batch: a mean that forgets slowly."""
        self.followed += 1
        rate = max(slowest, 1 / float(self.followed))
        self.shift.lerp_(latents.mean(0), rate)
        self.scale.lerp_((latents - self.shift).square().mean().sqrt().clamp_min(1e-3), rate)

    def loss(self, images: Tensor, noise: Tensor, divergence: float) -> Tensor:
        """Compute the error of reconstruction plus the divergence from the standard normal.

        Parameters
        ----------
        images : Tensor
            (N, C, side, side).
        noise : Tensor
            (N, D), standard normal.
        divergence : float
            Weight of the Kullback-Leibler divergence.
        """
        mean, log_variance = self.encode(images)
        drawn = mean + noise * (0.5 * log_variance).exp()
        divergences = 0.5 * (mean.square() + log_variance.exp() - 1 - log_variance)
        return self.error(self.decode(drawn), images) + divergence * divergences.mean()

    def error(self, images: Tensor, true: Tensor) -> Tensor:
        """Return the mean squared error relative to that of the mean image, which is 1."""
        return ((images - true) / self.contrast).square().mean()
