"""Tactile Prediction Pretraining: predict the touch to come, in the latents of a tactile VAE."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor, nn

from tpp.data import Sample, Scales
from tpp.denoiser import Denoiser
from tpp.diffusion import add_noise, denoise
from tpp.vae import TactileVAE

__all__ = ["Losses", "Sizes", "TactilePredictor"]

Estimate = Callable[[Tensor, Tensor], Tensor]

_PATCH = 4  # steps of action in one token
_LATE = 2.5  # power of a uniform number that is taken from 1, the time of pure noise
_FINE = 10.0  # how much finer than a usual change from step to step actions are resolved


@dataclass(frozen=True)
class Sizes:
    """How large the model is, and how its losses are weighed.

    Attributes
    ----------
    side : int
        Height and width of tactile images and of camera images, pixels; a multiple of 16.
    latent, vae_width : int
        Of the VAE: length of a latent vector, channels of its first convolution.
    width, depth, heads : int
        Of the diffusion transformer.
    divergence : float
        Weight of the divergence of the VAE's latents from the standard normal.
    hidden_history : float
        Probability that a frame of the history is hidden while training.
    """

    side: int = 64
    latent: int = 128
    vae_width: int = 32
    width: int = 384
    depth: int = 8
    heads: int = 6
    divergence: float = 1e-3
    hidden_history: float = 0.25

    @staticmethod
    def small() -> "Sizes":
        """Return sizes for a CPU: a step takes about a tenth of a second."""
        return Sizes(side=32, latent=24, vae_width=32, width=96, depth=3, heads=4)


@dataclass(frozen=True)
class Losses:
    """What is minimised: the sum of both."""

    diffusion: Tensor
    """In the latents."""
    reconstruction: Tensor
    """Of images by the VAE, and of predicted ones, relative to the spread of images."""

    @property
    def total(self) -> Tensor:
        """Their sum."""
        return self.diffusion + self.reconstruction


class TactilePredictor(nn.Module):
    """Draws future tactile images, given history, actions and an image.

    What is not seen (masked, or not there) is replaced by a learnt token, so that all masks have
    the same weights.

    Parameters
    ----------
    sizes : Sizes
    history_frames : int
        Tactile frames that are history; the others are to be predicted.
    images : int
        Camera images of a window.
    first_step, last_step : int
        Of the windows.
    scales : Scales
    """

    mean: Tensor
    spread: Tensor
    change: Tensor

    def __init__(
        self,
        sizes: Sizes,
        *,
        history_frames: int,
        images: int,
        first_step: int,
        last_step: int,
        scales: Scales,
    ) -> None:
        super().__init__()
        self.sizes = sizes
        self._history, self._first = history_frames, first_step
        width = sizes.width
        self.vae = TactileVAE(scales.touch, scales.touch_spread, sizes.latent, sizes.vae_width)
        self.denoiser = Denoiser(sizes.latent, history_frames, width, sizes.depth, sizes.heads)
        self.step_place = nn.Embedding(last_step - first_step + 1, width)
        self.enter_history = nn.Linear(sizes.latent, width)
        self.unseen_touch = nn.Parameter(torch.zeros(width))
        self.unseen_image = nn.Parameter(torch.zeros(width))
        self.image_place = nn.Parameter(0.02 * torch.randn(images, width))
        self.register_buffer("mean", scales.action)
        self.register_buffer("spread", scales.action_spread)
        self.register_buffer("change", scales.change)
        columns = 3 * len(scales.action) + 1  # see _action_tokens
        count = -(-(last_step - first_step + 1) // _PATCH)
        self.enter_action = nn.Linear(_PATCH * columns, width)
        self.action_place = nn.Parameter(0.02 * torch.randn(count, width))
        channels = sizes.vae_width
        self.see = nn.Sequential(
            nn.Conv2d(3, channels, 4, stride=4),
            nn.SiLU(),
            nn.Conv2d(channels, 2 * channels, 4, stride=4),
            nn.SiLU(),
            nn.Flatten(),
            nn.Linear(2 * channels * (sizes.side // 16) ** 2, width),
        )

    def losses(self, sample: Sample, *, predict: bool = True) -> Losses:
        """Compute the losses of a batch; noise and hidden frames come from torch's generator.

        Parameters
        ----------
        sample : Sample
        predict : bool
            False trains the VAE alone.
        """
        # Of the future alone, which no mask leaves out: the VAE learns from the same images then.
        seen = sample.touch_seen[:, self._history :]
        images = sample.touch[:, self._history :][seen]
        noise = torch.randn(len(images), self.sizes.latent, device=images.device)
        reconstruction = self.vae.loss(images, noise, self.sizes.divergence)
        if not predict:
            return Losses(torch.zeros_like(reconstruction), reconstruction)
        history, future = self._latents(sample)
        keep = torch.rand(history.shape[:2], device=images.device) > self.sizes.hidden_history
        # Most of what is to be learnt lies where there is much noise, so most times are late.
        time = 1 - torch.rand(len(future), device=images.device) ** _LATE
        noisy = add_noise(future, torch.randn_like(future), time)
        clean = self._estimate(sample, history, keep)(noisy, time)
        error = (clean - future).square().mean(-1)
        diffusion = (error * seen).sum() / seen.sum().clamp_min(1)
        predicted = self.vae.decode(self.vae.restore(clean[seen]))
        reconstruction = reconstruction + self.vae.error(predicted, images)
        return Losses(diffusion, reconstruction)

    @torch.no_grad()
    def predict(self, sample: Sample, noise: Tensor, steps: int = 8) -> tuple[Tensor, Tensor]:
        """Draw the future once.

        Parameters
        ----------
        sample : Sample
        noise : Tensor
            (B, future frames, D), standard normal.
        steps : int
            Of the diffusion.

        Returns
        -------
        images : Tensor
            (B, future frames, 3F, side, side).
        latents : Tensor
            (B, future frames, D), normalised.
        """
        history, future = self._latents(sample)
        everything = torch.ones_like(history[..., 0], dtype=torch.bool)
        latents = denoise(self._estimate(sample, history, everything), noise, steps)
        images = self.vae.decode(self.vae.restore(latents).flatten(0, 1))
        return images.view(*future.shape[:2], *images.shape[1:]), latents

    @torch.no_grad()
    def reconstruct(self, sample: Sample) -> tuple[Tensor, Tensor]:
        """Encode and decode the true future: what no prediction can be better than.

        Returns
        -------
        images, latents : Tensor
            As of `predict`.
        """
        _, future = self._latents(sample)
        images = self.vae.decode(self.vae.restore(future).flatten(0, 1))
        return images.view(*future.shape[:2], *images.shape[1:]), future

    def _latents(self, sample: Sample) -> tuple[Tensor, Tensor]:
        """Return normalised latents of history and future, (B, frames, D)."""
        past, later = sample.touch.split(
            [self._history, sample.touch.shape[1] - self._history], dim=1
        )
        history, _ = self.vae.encode(past.flatten(0, 1))
        with torch.no_grad():  # the encoder is not to make easy what is to be predicted
            future, _ = self.vae.encode(later.flatten(0, 1))
        if self.training:
            self.vae.follow(future)
        normalise = self.vae.normalise
        return (
            normalise(history).view(*past.shape[:2], -1),
            normalise(future).view(*later.shape[:2], -1),
        )

    def _estimate(self, sample: Sample, history: Tensor, keep: Tensor) -> Estimate:
        """Return the estimate of clean latents, given what is seen of a sample.

        Parameters
        ----------
        sample : Sample
        history : Tensor
            (B, H, D): normalised latents.
        keep : Tensor
            (B, H) bool: frames of the history that are not hidden on purpose.
        """
        seen = (sample.touch_seen[:, : self._history] & keep)[..., None]
        context = self._context(sample, history, seen)
        places = self._places(sample, slice(self._history, None))
        # The frames to mix are fixed: latents are not to be flattened so that mixing is easy.
        frames = (history * seen).detach()
        return partial(self.denoiser, places=places, context=context, history=frames)

    def _context(self, sample: Sample, history: Tensor, seen: Tensor) -> Tensor:
        """Return the tokens of history, actions and images, (B, M, width)."""
        touch = torch.where(seen, self.enter_history(history), self.unseen_touch)
        touch = touch + self._places(sample, slice(None, self._history))
        tokens = [touch]
        if sample.action.shape[-1]:
            tokens.append(self._action_tokens(sample))
        if sample.image.shape[1]:
            features = self.see(sample.image.flatten(0, 1)).view(*sample.image.shape[:2], -1)
            seen_image = torch.where(sample.image_seen[..., None], features, self.unseen_image)
            tokens.append(seen_image + self.image_place)
        return torch.cat(tokens, dim=1)

    def _action_tokens(self, sample: Sample) -> Tensor:
        seen = sample.action_seen[..., None]
        action, now = sample.action, sample.action[:, -self._first : 1 - self._first]
        # Half a millimetre decides what is felt, centimetres whether: a scale that shows both.
        since = torch.asinh((action - now) / self.change * _FINE)
        change = torch.asinh(action.diff(dim=1, prepend=action[:, :1]) / self.change * _FINE)
        plain = (action - self.mean) / self.spread
        columns = torch.cat((plain * seen, since * seen, change * seen, seen), dim=-1)
        steps = columns.shape[1]
        columns = nn.functional.pad(columns, (0, 0, 0, -steps % _PATCH))
        patches = columns.unflatten(1, (-1, _PATCH)).flatten(2)
        return torch.as_tensor(self.enter_action(patches) + self.action_place)

    def _places(self, sample: Sample, frames: slice) -> Tensor:
        """Return what says of which step some tactile frames are, (B, k, width)."""
        return torch.as_tensor(self.step_place(sample.steps[:, frames] - self._first))
